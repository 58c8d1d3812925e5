// The options of the subcommands of recordings.
#include <unistd.h>

#include <filesystem>
#include <iostream>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "app/core/arguments.hpp"
#include "app/core/configuration_commands.hpp"
#include "app/core/recording_commands.hpp"
#include "data/number_text.hpp"

namespace rtdata::app {
namespace {

/// Accepts whole numbers from `least` on. Without it, CLI11 reads -1 as the largest unsigned number.
CLI::Validator at_least(std::int64_t least) {
  const auto check = [least](const std::string& text) {
    std::int64_t number = 0;
    const bool is_good = detail::read_number(text, number) == std::errc{} && number >= least;
    return is_good ? std::string() : text + " must be a whole number from " + std::to_string(least) + " on";
  };
  return CLI::Validator(check, "");
}

/// `which`: the use of the run, and the default.
CLI::Option* add_run(CLI::App& command, std::optional<std::string>& to, const std::string& which) {
  return command.add_option("--run", to, which + "; -1: the last, -2: the one before")->type_name("NUMBER|NAME");
}

/// True if a word names a recording. It may also be an instance or a topic: names of instances have neither.
bool is_recording(const std::string& word) {
  std::error_code ignored;
  return word.ends_with(".db") ||
         (word.find('/') != std::string::npos && std::filesystem::is_regular_file(word, ignored));
}

/// The options for a part of a run.
void add_part(CLI::App& command, PartOptions& part) {
  add_run(command, part.run, "Which run; default: the last");
  command.add_option("--from", part.from, "First time, in UTC as 2026-03-01T12:00:00Z; default: all of the run")
      ->type_name("TIME");
  command.add_option("--until,--to", part.until, "End time, not included")->type_name("TIME");
  command.add_option("--last", part.last, "Only this long before the end, such as 10s; instead of --from")
      ->type_name("DURATION");
}

}  // namespace

Action prepare_verify(CLI::App& command) {
  const auto options = std::make_shared<VerifyOptions>();
  command.footer(
      "examples:\n  rtdata verify bench.db\n  rtdata verify bench.db --run 3\n  rtdata verify "
      "postgresql://rt@db.example/plant\nexit status:\n"
      "  0  balanced: every tick and event is accounted for, losses too; or sealed:\n"
      "     the same up to the kill or power failure that ended it; or being recorded\n"
      "  1  a run is not balanced, or not sealed yet: see `rtdata seal`\n"
      "  2  unreadable or damaged");
  command.add_option("DB", options->database, "The recording, or a server: postgresql://...")->required();
  add_run(command, options->run, "Only this run; default: all, the newest last");
  add_json(command, options->show_as);
  return [options](const Registry&) {
    const ForPeople wrapped(options->show_as == ShowAs::text);
    return verify(*options, std::cout, std::cerr);
  };
}

Action prepare_info(CLI::App& command) {
  const auto options = std::make_shared<InfoOptions>();
  command.footer(
      "examples:\n  rtdata info bench.db\n  rtdata info bench.db --run 1 --gaps\n"
      "For each origin, the sensor that events come from: its rate, and how late its\n"
      "readings were; p50: half of them at most this late, p99: 99 of 100.");
  command.add_option("DB", options->database, "The recording")->required();
  add_run(command, options->run, "Which run; default: the last");
  add_flag(command, "--gaps", options->gaps, InfoOptions::Gaps::listed, "List the gaps of the run, in UTC");
  add_json(command, options->show_as);
  return [options](const Registry&) {
    const ForPeople wrapped(options->show_as == ShowAs::text);
    return info(*options, std::cout, std::cerr);
  };
}

Action prepare_runs(CLI::App& command) {
  const auto options = std::make_shared<RunsOptions>();
  command.footer(
      "example:\n  rtdata runs bench.db\n"
      "The verdict is that of `rtdata verify`, which reads every row. LOST: something was\n"
      "lost in the run; `rtdata verify DB --run N` says what.");
  command.add_option("DB", options->database, "The recording")->required();
  add_json(command, options->show_as, "Print JSON, with notes and hashes as a whole");
  return [options](const Registry&) {
    const ForPeople wrapped(options->show_as == ShowAs::text);
    return runs(*options, std::cout, std::cerr);
  };
}

Action prepare_seal(CLI::App& command) {
  const auto database = std::make_shared<std::string>();
  command.footer(
      "example:\n  rtdata seal bench.db\n"
      "Writes down what a killed run lost. The next start of a recording into the file\n"
      "does the same. Run it on the computer that recorded: some counts survive a kill\n"
      "only in its memory.");
  command.add_option("DB", *database, "The recording")->required();
  return [database](const Registry&) {
    const ForPeople wrapped;
    return seal(*database, std::cout, std::cerr);
  };
}

Action prepare_rm(CLI::App& command) {
  const auto options = std::make_shared<RemoveOptions>();
  command.add_option("DB", options->database, "The recording")->required();
  command.add_option("--run", options->run, "Which run; -1: the last, -2: the one before")
      ->type_name("NUMBER|NAME")
      ->required();
  add_flag(command, "--discard-backlog", options->unsent, Unsent::discarded,
           "Delete the run even if events of it wait for a peer; they are counted as lost");
  command.footer(
      "example:\n  rtdata rm bench.db --run 3\n"
      "The sums of its account stay: `rtdata verify` counts them among the file's.");
  return [options](const Registry&) {
    const ForPeople wrapped;
    return remove_run(*options, std::cout, std::cerr);
  };
}

Action prepare_merge(CLI::App& command) {
  const auto options = std::make_shared<MergeOptions>();
  command.add_option("DB", options->sources, "The recordings, which stay as they are")->required();
  command.add_option("-o,--output", options->database, "The new recording; the file must not exist")
      ->required()
      ->type_name("FILE");
  command.footer(
      "example:\n  rtdata merge rocket.db ground.db -o flight.db\nexit status:\n"
      "  0  merged\n  1  not merged; or rows that differ from another copy's were left out\n"
      "  2  a recording is unreadable or damaged");
  return [options](const Registry&) {
    const ForPeople wrapped;
    return merge(*options, std::cout, std::cerr);
  };
}

Action prepare_compare(CLI::App& command) {
  const auto options = std::make_shared<CompareOptions>();
  command.add_option("DB", options->database, "The recording")->required();
  command.add_option("RUN1", options->first, "A run by its number or name; -1: the last")->required();
  command.add_option("RUN2", options->second, "The other one")->required();
  command
      .add_option(
          "--from", options->from,
          "From the first event of this topic; MACHINE=STATE: from the first time it is in that state; default: "
          "from the start")
      ->type_name("TOPIC");
  command.add_option("--for", options->length, "Compare only this long; default: to the end")->type_name("DURATION");
  add_json(command, options->show_as);
  command.footer(
      "examples:\n  rtdata compare bench.db -2 -1\n"
      "  rtdata compare bench.db 3 4 --from sequence=burn --for 5s");
  return [options](const Registry&) {
    const ForPeople wrapped(options->show_as == ShowAs::text);
    return compare(*options, std::cout, std::cerr);
  };
}

Action prepare_export(CLI::App& command) {
  using Export = ExportOptions;
  const auto options = std::make_shared<Export>();
  command.add_option("DB", options->database, "The recording")->required();
  command.add_option("--topic", options->topic, "Topic or pattern")->capture_default_str();
  command.add_option("--format", options->format, "csv, jsonl, cbor, influx or raw")->capture_default_str();
  command.add_option("--folder", options->folder,
                     "Write one file per topic into this folder; default: standard output");
  add_flag(command, "--overwrite", options->existing, Export::Existing::replace, "Replace files in the folder");
  add_run(command, options->run, "Only this run; default: all");
  command.add_option("--origin", options->origin, "Only events of this sensor")->type_name("NAME");
  command.add_option("--from", options->from, "First time, as 2026-03-01T12:00:00Z or in ns")->type_name("TIME");
  command.add_option("--until", options->until, "End time, not included")->type_name("TIME");
  command.add_option("--limit", options->limit, "At most this many rows; 0: all")->check(at_least(0));
  command.add_option("--every", options->every, "Only each n-th row")->check(at_least(1));
  command
      .add_option("--step", options->step,
                  "For each step of this length: number of values, and least, largest and mean of each field")
      ->type_name("DURATION");
  add_flag(command, "--utc", options->times, Export::Times::utc,
           "Times in UTC, corrected where the clock was wrong; --from and --until are UTC, too");
  add_flag(command, "--units", options->header, Export::Header::names_and_units, "Units in the heading of CSV");
  command
      .add_option("--join", options->join,
                  "Columns of other topics beside those of --topic: their last event at or before each row")
      ->expected(1, -1)
      ->type_name("TOPIC");
  command.add_option("--within", options->within, "With --join: ignore events older than this, such as 1s")
      ->type_name("DURATION");
  command.add_option("--separator", options->separator, "CSV only: a character, such as \";\", or tab; default: \",\"")
      ->type_name("CHARACTER");
  command.add_option("--decimal", options->decimal, "CSV only: the decimal mark; default: \".\"")
      ->type_name("CHARACTER")
      ->check(CLI::IsMember({".", ","}));
  command.add_option("--digits", options->digits, "CSV only: digits after the decimal mark; default: all")
      ->check(CLI::Range(0, 17))
      ->type_name("NUMBER");
  command.add_option("--time", options->time, "CSV only: seconds, since the first row of each run or --start")
      ->check(CLI::IsMember({"seconds"}))
      ->type_name("seconds");
  command.add_option("--start", options->start, "The time of 0 s")->type_name("TIME");
  command.footer(
      "examples:\n  rtdata export bench.db --topic host/cpu --format csv --utc > cpu.csv\n"
      "  rtdata export bench.db --topic host/cpu --step 1min\n"
      "  rtdata export flight.db --topic baro --join gps --time seconds --separator tab");
  return [options](const Registry&) {
    // Rows on the same terminal already show the progress.
    if (::isatty(STDERR_FILENO) == 1 && (::isatty(STDOUT_FILENO) != 1 || !options->folder.empty()))
      options->progress = Export::Progress::shown;
    const WrappedOutput errors(std::cerr, STDERR_FILENO);
    return export_recording(*options, std::cout, std::cerr);
  };
}

Action prepare_plot(CLI::App& command) {
  const auto options = std::make_shared<PlotOptions>();
  const auto words = std::make_shared<std::vector<std::string>>();
  command.add_option("WORDS", *words,
                     "[NAME|PID|DB] FIELD ...: an instance when several run, or a recording; TOPIC.FIELD, or TOPIC for "
                     "all its numbers; each has a panel; without a FIELD it lists what there is");
  add_part(command, options->part);
  command.add_option("--origin", options->origin, "Only events of this sensor")->type_name("NAME");
  command.footer(
      "examples:\n  rtdata plot bench.db host/process.time_slices\n  rtdata plot bench.db host/cpu host/load.minutes_1 "
      "--last "
      "10s\n"
      "  rtdata plot bench host/cpu       the last minute of a running instance, until q\n"
      "Each dot or column shows the range from least to most of its time. A letter below\n"
      "a curve marks missing data; its line says when and why.");
  return [options, words, &command](const Registry&) {
    const WrappedOutput errors(std::cerr, STDERR_FILENO);
    if (!words->empty() && is_recording(words->front())) {
      options->database = words->front();
      options->fields.assign(words->begin() + 1, words->end());
      return plot(*options, std::cout, std::cerr);
    }
    for (const char* const name : {"--run", "--from", "--until", "--origin"}) {
      if (command.count(name) == 0) continue;
      print_error(std::cerr, std::string(name) + " works only with recordings: rtdata plot DB", "bad-argument");
      return exit_other;
    }
    LivePlotOptions live;
    live.words = *words;
    if (!options->part.last.empty()) {
      const Result<Duration> window = parse_duration(options->part.last);
      if (!window || *window < std::chrono::seconds{1} || *window > std::chrono::hours{1}) {
        print_error(std::cerr, "--last of a running instance is 1 s to 1 h; for more, plot a recording: rtdata plot DB",
                    "bad-argument");
        return exit_other;
      }
      live.window = *window;
    }
    return plot_instance(live);
  };
}

Action prepare_report(CLI::App& command) {
  const auto options = std::make_shared<ReportOptions>();
  command.add_option("DB", options->database, "The recording")->required();
  add_run(command, options->run, "Which run; default: the last");
  command
      .add_option("-o,--output", options->file,
                  "The page; -: standard output; default: the recording's name with .html, in this folder")
      ->type_name("FILE");
  add_flag(command, "--overwrite", options->existing, ReportOptions::Existing::replace, "Replace a file that exists");
  command.footer(
      "examples:\n  rtdata report bench.db\n  rtdata report bench.db --run 3 -o monday.html\n"
      "One file without network or scripts, to open in any browser and to print: the\n"
      "verdict of verify, what is missing and why, each field with its curve, what happened.");
  return [options](const Registry&) {
    const ForPeople wrapped(options->file != "-");
    return report(*options, std::cout, std::cerr);
  };
}

#ifdef RTDATA_WITH_PAGE
Action prepare_view(CLI::App& command) {
  const auto options = std::make_shared<ViewOptions>();
  command.add_option("DB", options->database, "The recording, also while it is recorded")->required();
  add_run(command, options->run, "Which run; default: the last");
  command.add_option("--listen", options->listen, "Where; default: the next free port from 127.0.0.1:8080 on")
      ->type_name("ADDRESS");
  command.footer("example:\n  rtdata view bench.db\nIt prints the address to open in a browser.");
  return [options](const Registry& registry) { return view(registry, *options, std::cerr); };
}
#endif

std::function<std::optional<int>(const TailOptions&)> add_recorded_tail(CLI::App& command) {
  const auto given = std::make_shared<RecordedTailOptions>();
  PartOptions& part = given->part;
  std::vector<const CLI::Option*> added{
      add_run(command, part.run, "Recordings only: which run; default: the last"),
      command.add_option("--until,--to", part.until, "Recordings only: end time, not included")->type_name("TIME"),
      command.add_option("--last", part.last, "Recordings only: only this long before the end, instead of --from")
          ->type_name("DURATION"),
      command
          .add_option("--lines", given->lines,
                      "Recordings only: this many of the newest events, without --from and --last")
          ->check(at_least(1))
          ->capture_default_str()};
  return [given, added](const TailOptions& options) -> std::optional<int> {
    const auto& words = options.words;
    if (words.empty() || !is_recording(words.front())) {
      for (const CLI::Option* option : added) {
        if (option->count() == 0) continue;
        print_error(std::cerr, option->get_name() + " works only with recordings: rtdata tail DB", "bad-argument");
        return exit_other;
      }
      return std::nullopt;
    }
    given->database = words.front();
    given->topics.assign(words.begin() + 1, words.end());
    given->part.from = options.from;
    given->step = options.step;
    given->show_as = options.show_as;
    given->columns = columns_of(STDOUT_FILENO);
    return tail_recording(*given, std::cout, std::cerr);
  };
}

Action prepare_import(CLI::App& command) {
  const auto options = std::make_shared<ImportOptions>();
  command.add_option("FILE", options->file, "CSV; its first row names the columns, units as in: speed [m/s]")
      ->required();
  command
      .add_option("--time", options->time_columns,
                  "Heading of the time column, or of the columns of its parts, such as date and time")
      ->expected(1, -1)
      ->type_name("COLUMN");
  command.add_option("--rate", options->rate, "Rows per second of a table without a time column, such as 32")
      ->check(CLI::Validator(
          [](std::string& text) {
            double rate = 0;
            const bool is_rate = CLI::detail::lexical_cast(text, rate) && rate > 0;
            return is_rate ? std::string() : "\"" + text + "\" is not a number above 0";
          },
          ""))
      ->type_name("HERTZ");
  command.add_option("--step", options->step, "Time between the rows of a table without a time column: 31.25ms")
      ->type_name("DURATION");
  command.add_option("--time-format", options->time_format, "How its times are written, such as \"%d.%m.%Y %H:%M:%S\"")
      ->type_name("FORMAT");
  command.add_option("--scale", options->scale, "Time that 1 in that column means; default: 1 s")
      ->type_name("DURATION");
  command
      .add_option("--start", options->start, "Time that 0 in that column means, as 2026-03-01T12:00:00Z; default: 1970")
      ->type_name("TIME");
  command.add_option("--zone", options->zone, "Time zone of times that name none: Z (UTC), +01:00, Europe/Berlin")
      ->type_name("ZONE");
  command.add_option("--skip", options->skip, "Number of lines before the heading")
      ->check(at_least(0))
      ->type_name("LINES");
  command.add_option("--head", options->head, "Number of rows of the heading, which are joined: 1 or 2")
      ->check(CLI::IsMember({1, 2}))
      ->type_name("ROWS");
  command.add_option("--units", options->units, "row: the row after the heading has the units")
      ->check(CLI::IsMember({"heading", "row"}))
      ->type_name("WHERE");
  command.add_option("--columns", options->columns, "The names of the columns of a table without heading: t,\"v [V]\"")
      ->type_name("NAMES");
  command.add_option("--comment", options->comments, "Skip lines that begin with this, such as \"#\"; may be repeated")
      ->expected(1, -1)
      ->allow_extra_args(false)
      ->type_name("TEXT");
  command
      .add_option("--only", options->only,
                  "Only rows whose first cell is this text, or with this text in a column: host=a")
      ->expected(1, -1)
      ->type_name("KIND|COLUMN=TEXT");
  command.add_option("--none", options->none, "Texts and numbers that stand for no value, such as N/A -9999")
      ->expected(1, -1)
      ->type_name("TEXT");
  command
      .add_option("--strip", options->strip,
                  "Texts to remove from the begin or end of cells with numbers, such as F \"V DC\" T=")
      ->expected(1, -1)
      ->type_name("TEXT");
  command.add_option("--text", options->texts, "Columns that are texts, such as ids whose zeros are kept: 00501")
      ->expected(1, -1)
      ->type_name("COLUMN");
  command
      .add_option("--separator", options->separator,
                  "Separator of the cells: a character, such as \";\", tab, or blanks; default: \",\"")
      ->type_name("CHARACTER");
  command.add_option("--decimal", options->decimal, "The decimal mark of its numbers; default: \".\"")
      ->type_name("CHARACTER")
      ->check(CLI::IsMember({".", ","}));
  command.add_option("--thousands", options->thousands, "Separator of thousands, such as \",\"; default: none")
      ->type_name("CHARACTER");
  add_flag(command, "--sort", options->order, ImportOptions::Order::sorted, "Sort rows that are not in order of time");
  add_flag(command, "--partial", options->partial, ImportOptions::Partial::taken,
           "Accept rows that end early; skip a last row that is cut off, and rows without a time");
  command.add_option("--topic", options->topic, "Topic; default: the file's name");
  command.add_option("--origin", options->origin, "The sensor that the events are from; default: the file's name")
      ->type_name("NAME");
  command.add_option("--into", options->database, "The recording; default: FILE with .db")->type_name("DB");
  command.footer(
      "examples:\n  rtdata import flight.csv --time ticks --scale 10us --into flight.db\n"
      "  rtdata import lab.csv --time Zeit --separator \";\" --decimal , --zone +01:00\n"
      "  rtdata import logger.txt --skip 11 --time Time --none -9999 ---\n"
      "  rtdata import buoy.txt --separator blanks --time \"#YY\" MM DD hh mm \\\n"
      "    --time-format \"%Y %m %d %H %M\" --zone Z --units row --none MM --sort\n"
      "  rtdata import flight.log --only IMU I=0 --time TimeUS --scale 1us");
  return [options](const Registry&) {
    const ForPeople wrapped;
    return import_table(*options, std::cout, std::cerr);
  };
}

Action prepare_replay(CLI::App& command) {
  struct Given {
    ReplayOptions options;
    std::string speed = "1";
  };
  const auto given = std::make_shared<Given>();
  ReplayConfig& config = given->options.config;
  config.topics.clear();
  command.add_option("DB", config.file, "The recording")->required();
  command.add_option("FILE", given->options.configuration,
                     "A configuration: its sinks get the events, its sensors are not made; default: the terminal");
  command.add_option("--speed", given->speed, "2: twice as fast as recorded; max: as fast as it goes, in virtual time")
      ->capture_default_str()
      ->type_name("FACTOR");
  add_run(command, given->options.run, "Only this run; default: all, one after the other");
  command.add_option("--topic", config.topics, "Topics or patterns; default: all")->expected(1, -1);
  command.add_option("--rename", config.rename, "OLD=NEW: the topic OLD, and those below it, become NEW")
      ->expected(1, -1);
  command.add_option("--prefix", config.prefix, "Prefix of the names of the origins");
  command.add_option("--from", config.from, "First time, in UTC as 2026-03-01T12:00:00Z, or as recorded in ns")
      ->type_name("TIME");
  command.add_option("--until", config.until, "End time, not included")->type_name("TIME");
  add_flag(command, "--quiet,-q", given->options.is_quiet, true, "Print no messages except warnings and errors");
  command.footer(
      "examples:\n  rtdata replay bench.db                      as it came, on the terminal\n"
      "  rtdata replay bench.db again.json --speed max\nexit status:\n"
      "  0  all was replayed, and stored\n  1  something was not, or another error\n"
      "  2  the recording is unreadable, or the configuration has mistakes");
  return [given](const Registry& registry) {
    ReplayOptions& options = given->options;
    if (options.config.topics.empty()) options.config.topics = {"#"};
    options.is_virtual = given->speed == "max";
    if (!options.is_virtual) {
      double& factor = options.config.speed;
      if (detail::read_number(given->speed, factor) != std::errc{} || !(factor > 0)) {
        print_error(std::cerr, "--speed " + given->speed + ": give a number above 0, or max", "bad-argument");
        return exit_other;
      }
    }
    return replay(registry, options);
  };
}

Action prepare_forward(CLI::App& command) {
  const auto options = std::make_shared<ForwardOptions>();
  command.add_option("DB", options->database, "The recording, wherever it was moved to")->required();
  command.add_option("FILE", options->file, "The configuration whose sinks send")->required();
  command.footer(
      "example:\n  rtdata forward /media/card/run.db node.json\n"
      "Each sink of FILE with `through` continues from its position in the recording.\nexit status:\n"
      "  0  all is sent\n  1  ended before\n  2  mistakes, or no recording");
  return [options](const Registry& registry) {
    const ForPeople wrapped;
    return forward(registry, *options);
  };
}

}  // namespace rtdata::app
