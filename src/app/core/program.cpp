#include "rtdata/app/program.hpp"

#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <functional>
#include <iostream>
#include <memory>
#include <optional>
#include <streambuf>
#include <string_view>
#include <utility>
#include <vector>

#ifdef RTDATA_WITH_SQLITE
#include "app/core/recording_commands.hpp"
#endif
#include "app/core/configuration_commands.hpp"
#include "app/core/terminal_text.hpp"

namespace rtdata {
namespace {

constexpr const char* examples = R"(examples:
  rtdata init bench.json                  write a starter file for this machine
  rtdata check bench.json                 find every mistake in it
  rtdata run bench.json --for 10s         run it for ten seconds
  rtdata top                              look at it while it runs, from another terminal
  rtdata bench                            what this machine can do, in a minute
  rtdata verify bench.db                  prove that its recording is complete
  rtdata export bench.db --topic host/cpu --format csv
  rtdata types analog                     what can be configured
exit status:
  0  good
  1  an error; verify: the recording is not balanced, or not sealed
  2  run, check: mistakes in the configuration; verify, info, export: the recording
     is unreadable or damaged; top: several instances are running, name one
  3  run --fail-on-loss: something was missed, failed, unreadable, lost or dropped,
     or a device without a schedule was away)";

/// For what people read: lines as wide as the terminal, while it lives. Not where a run goes on, whose handlers may
/// print from any thread, and not around data.
struct ForPeople {
  app::WrappedOutput out{std::cout, STDOUT_FILENO};
  app::WrappedOutput err{std::cerr, STDERR_FILENO};
};

/// What a subcommand does once the command line is read; returns the exit status.
using Action = std::function<int(const Registry&)>;

Action prepare_init(CLI::App& command) {
  const auto file = std::make_shared<std::string>("rtdata.json");
  command.footer(
      "example:\n  rtdata init bench.json\nIt has gentle rates and limits. What else there is: rtdata types");
  command.add_option("FILE", *file, "The file; one that exists is not overwritten")->capture_default_str();
  return [file](const Registry& registry) {
    const ForPeople wrapped;
    return app::init(registry, *file);
  };
}

/// A span above nothing. None: it is no such span, and that was said.
std::optional<Duration> span_of(const std::string& option, const std::string& text) {
  const Result<Duration> parsed = parse_duration(text);
  if (parsed && *parsed > Duration{0}) return *parsed;
  std::cerr << "rtdata: " << option << " " << text << ": "
            << (parsed ? "it must be longer than nothing" : parsed.error().text()) << std::endl;
  return std::nullopt;
}

Action prepare_run(CLI::App& command) {
  struct Given {
    app::RunOptions options;
    std::string duration;
  };
  const auto given = std::make_shared<Given>();
  command.add_option("FILE", given->options.file, "The configuration")->required();
  command.add_option("--for", given->duration, "End after so long, such as 10s or 5min")->type_name("DURATION");
  command.add_flag_callback(
      "--fail-on-loss", [given] { given->options.on_loss = app::OnLoss::fail; },
      "Exit 3 when anything was lost: ticks, events, or a time without a device");
  command.add_flag_callback(
      "--quiet,-q", [given] { given->options.talk = app::Talk::quiet; }, "Print warnings and errors only");
  command
      .add_option("--log", given->options.log_file,
                  "The log file; default: as the configuration says, or its name with .log, in the working directory")
      ->type_name("FILE");
  command.footer(
      "example:\n  rtdata run bench.json --for 10s --fail-on-loss\nexit status:\n"
      "  0  every tick and event is accounted for, and all is stored\n  1  it is not, or another error\n"
      "  2  mistakes in the configuration: nothing was started\n"
      "  3  with --fail-on-loss: something was missed, failed, unreadable, lost or\n     dropped");
  return [given](const Registry& registry) {
    if (!given->duration.empty()) {
      given->options.duration = span_of("--for", given->duration);
      if (!given->options.duration) return app::exit_other;
    }
    return app::run(registry, given->options);
  };
}

Action prepare_check(CLI::App& command) {
  const auto options = std::make_shared<app::CheckOptions>();
  command.footer(
      "examples:\n  rtdata check bench.json\n  rtdata check new.json --against bench.json\nexit status:\n"
      "  0  no mistake, perhaps warnings\n"
      "  1  with --against: a running system cannot change to it\n  2  mistakes");
  command.add_option("FILE", options->file, "The configuration")->required();
  command
      .add_option("--against", options->against,
                  "Also say what becomes of each part when it takes the place of this one in a running system")
      ->type_name("FILE");
  return [options](const Registry& registry) {
    const ForPeople wrapped;
    return app::check(registry, *options);
  };
}

Action prepare_graph(CLI::App& command) {
  const auto options = std::make_shared<app::GraphOptions>();
  command.footer(
      "examples:\n  rtdata graph rocket.json                     for a ```mermaid block of Markdown\n"
      "  rtdata graph rocket.json --dot | dot -Tsvg   by Graphviz\nexit status:\n"
      "  0  drawn\n  1  there is no such machine\n  2  mistakes in the configuration");
  command.add_option("FILE", options->file, "The configuration")->required();
  command.add_option("--machine", options->machine, "Only this one")->type_name("NAME");
  command.add_flag_callback(
      "--dot", [options] { options->draw_as = app::DrawAs::dot; }, "In the language of Graphviz, instead of Mermaid");
  return [options](const Registry& registry) { return app::graph(registry, *options); };
}

Action prepare_types(CLI::App& command) {
  struct Given {
    std::string type;
    app::TypesAs format = app::TypesAs::text;
  };
  const auto given = std::make_shared<Given>();
  command.add_option("NAME", given->type, "Only this type, or a chip or a word, such as bme280, pt100, button, csv");
  command.add_flag_callback(
      "--all", [given] { given->format = app::TypesAs::all; }, "All types with their parameters");
  command.add_flag_callback(
      "--schema", [given] { given->format = app::TypesAs::schema; }, "Print the JSON Schema, for editors");
  command.add_flag_callback(
      "--markdown", [given] { given->format = app::TypesAs::markdown; }, "Print pages of documentation, in Markdown");
  command.footer(
      "examples:\n  rtdata types\n  rtdata types analog\n  rtdata types bme280\n  rtdata types --schema > "
      "rtdata.schema.json");
  return [given](const Registry& registry) {
    std::optional<ForPeople> wrapped;
    if (given->format == app::TypesAs::text || given->format == app::TypesAs::all) wrapped.emplace();
    return app::types(registry, given->type, given->format);
  };
}

Action prepare_top(CLI::App& command) {
  const auto options = std::make_shared<app::TopOptions>();
  command.add_option("NAME|PID", options->instance, "Which instance; needed when several are running");
  command.add_flag_callback(
      "--once", [options] { options->how_often = app::HowOften::once; }, "Print once and end");
  command.add_flag_callback(
      "--json", [options] { options->show_as = app::ShowAs::json; }, "Print the status as JSON, a line each time");
  command.footer(
      "examples:\n  rtdata top                        the only instance, until q or Ctrl-C\n"
      "  rtdata top bench --once           one look at the instance called bench\n"
      "  rtdata top 4711 --once --json     for programs");
  return [options](const Registry&) {
    const app::WrappedOutput errors(std::cerr, STDERR_FILENO);  // the rest is laid out for the terminal, or data
    return app::top(*options);
  };
}

Action prepare_ctl(CLI::App& command) {
  const auto words = std::make_shared<std::vector<std::string>>();
  command.add_option("WORDS", *words, "[NAME|PID] COMMAND ...: an instance when several run, and a command")
      ->required()
      ->expected(1, 1002);
  command.prefix_command();
  command.footer(app::ctl_help() +
                 "Each is recorded on the topic rtdata/commands, with who gave it and what came of it.\n"
                 "examples:\n  rtdata ctl rate imu \"200 Hz\"\n  rtdata ctl bench note valve replaced");
  return [words](const Registry&) {
    const ForPeople wrapped;
    return app::ctl(*words);
  };
}

Action prepare_bench(CLI::App& command) {
  struct Given {
    app::BenchOptions options;
    std::string duration = "60s";
  };
  const auto given = std::make_shared<Given>();
  command.add_option("--for", given->duration, "How long all of it takes, about")
      ->type_name("DURATION")
      ->capture_default_str();
  command
      .add_option("--json", given->options.json_file,
                  "Write the figures to this file as JSON; - is standard output, instead of the text")
      ->type_name("FILE");
  command.add_option("--cpu", given->options.cpu, "Sample on this processor; default: any")->type_name("N");
  command.footer(
      "examples:\n  rtdata bench                      a minute, in the folder where you are going to record\n"
      "  rtdata bench --cpu 3              sample on processor 3, as with isolcpus=3\n"
      "  rtdata bench --for 10s --json board.json");
  return [given](const Registry&) {
    const std::optional<Duration> duration = span_of("--for", given->duration);
    if (!duration) return app::exit_other;
    given->options.duration = *duration;
    std::optional<ForPeople> wrapped;
    if (given->options.json_file != "-") wrapped.emplace();
    return app::bench(given->options);
  };
}

Action prepare_scan(CLI::App& command) {
  const auto options = std::make_shared<app::ScanOptions>();
  command.add_flag("--probe", options->probe,
                   "Also read a byte from each free I2C address; a chip may take that amiss");
  command.add_option("--root", options->root, "Look at a copy of another machine's /sys and /dev in this folder")
      ->type_name("DIR");
  command.add_flag_callback(
      "--json", [options] { options->show_as = app::ShowAs::json; }, "Print JSON");
  command.footer("examples:\n  rtdata scan\n  rtdata scan --probe");
  return [options](const Registry& registry) {
    std::optional<ForPeople> wrapped;
    if (options->show_as == app::ShowAs::text) wrapped.emplace();
    return app::scan(registry, *options);
  };
}

Action prepare_doctor(CLI::App& command) {
  const auto options = std::make_shared<app::DoctorOptions>();
  command.add_option("FILE", options->file, "The configuration that is to run here: its devices, disks and tiers too");
  command
      .add_option("--root", options->root, "Look at a copy of another machine's /proc, /sys and /etc in this folder")
      ->type_name("DIR");
  command.add_flag_callback(
      "--json", [options] { options->show_as = app::ShowAs::json; }, "Print JSON");
  command.footer(
      "examples:\n  rtdata doctor\n  rtdata doctor bench.json\nexit status:\n"
      "  0  notes at most\n  1  an error\n"
      "  2  something that the configuration needs cannot work, or it has mistakes\n"
      "  3  something costs timing or data");
  return [options](const Registry& registry) {
    std::optional<ForPeople> wrapped;
    if (options->show_as == app::ShowAs::text) wrapped.emplace();
    return app::doctor(registry, *options);
  };
}

#ifdef RTDATA_WITH_SQLITE
/// A whole number from there on. Without it, CLI11 takes -1 as the largest unsigned number.
CLI::Validator at_least(std::int64_t least) {
  const auto check = [least](const std::string& text) {
    std::int64_t number = 0;
    const char* const end = text.data() + text.size();
    const auto [stopped, failed] = std::from_chars(text.data(), end, number);
    const bool is_good = failed == std::errc{} && stopped == end && number >= least;
    return is_good ? std::string() : text + " must be a whole number from " + std::to_string(least) + " on";
  };
  return CLI::Validator(check, "");
}

Action prepare_verify(CLI::App& command) {
  const auto options = std::make_shared<app::VerifyOptions>();
  command.footer(
      "examples:\n  rtdata verify bench.db\n  rtdata verify postgresql://rt@db.example/plant\nexit status:\n"
      "  0  balanced: every tick and event is accounted for, losses too; or sealed:\n"
      "     so up to the kill or power cut that ended it; or being recorded\n"
      "  1  not balanced, or not sealed yet: record into it again\n"
      "  2  unreadable or damaged");
  command.add_option("DB", options->database, "The recording, or a server: postgresql://...")->required();
  command.add_flag_callback(
      "--json", [options] { options->output = app::Output::json; }, "Print JSON");
  return [options](const Registry&) {
    std::optional<ForPeople> wrapped;
    if (options->output == app::Output::text) wrapped.emplace();
    return app::verify(*options, std::cout, std::cerr);
  };
}

Action prepare_info(CLI::App& command) {
  const auto options = std::make_shared<app::InfoOptions>();
  command.footer(
      "examples:\n  rtdata info bench.db\n  rtdata info bench.db --run 1 --gaps\n"
      "Of each origin, the sensor that events come from: its rate, and how much later\n"
      "than due it was read; p50: half of the readings at most, p99: 99 of 100.");
  command.add_option("DB", options->database, "The recording")->required();
  command.add_option("--run", options->run, "Which run; default: the last")->type_name("NUMBER");
  command.add_flag_callback(
      "--gaps", [options] { options->gaps = app::InfoOptions::Gaps::listed; }, "List the gaps of the run, in UTC");
  command.add_flag_callback(
      "--json", [options] { options->output = app::Output::json; }, "Print JSON");
  return [options](const Registry&) {
    std::optional<ForPeople> wrapped;
    if (options->output == app::Output::text) wrapped.emplace();
    return app::info(*options, std::cout, std::cerr);
  };
}

Action prepare_export(CLI::App& command) {
  using Export = app::ExportOptions;
  const auto options = std::make_shared<Export>();
  command.add_option("DB", options->database, "The recording")->required();
  command.add_option("--topic", options->topic, "Topic or pattern")->capture_default_str();
  command.add_option("--format", options->format, "csv, jsonl, cbor, influx or raw")->capture_default_str();
  command.add_option("--folder", options->folder, "Write a file a topic into this folder; default: standard output");
  command.add_flag_callback(
      "--overwrite", [options] { options->existing = Export::Existing::replace; }, "Replace files in the folder");
  command.add_option("--run", options->run, "Only this run")->type_name("NUMBER");
  command.add_option("--origin", options->origin, "Only events of this sensor")->type_name("NAME");
  command.add_option("--from", options->from, "First time, as 2026-03-01T12:00:00Z or in ns")->type_name("TIME");
  command.add_option("--until", options->until, "First time that is left out")->type_name("TIME");
  command.add_option("--limit", options->limit, "At most so many rows; 0: all")->check(at_least(0));
  command.add_option("--every", options->every, "Only each n-th row")->check(at_least(1));
  command
      .add_option("--step", options->step,
                  "Reduced: for each step of this length how many values, the least, the largest and the mean of each "
                  "number")
      ->type_name("DURATION");
  command.add_flag_callback(
      "--utc", [options] { options->times = Export::Times::utc; },
      "Times as UTC, by the clock when it was right; --from and --until are UTC, too");
  command.add_flag_callback(
      "--units", [options] { options->header = Export::Header::names_and_units; }, "Units in the heading of CSV");
  command.footer(
      "examples:\n  rtdata export bench.db --topic host/cpu --format csv --utc > cpu.csv\n"
      "  rtdata export bench.db --topic host/cpu --step 1min");
  return [options](const Registry&) {
    // Rows on the same terminal say themselves how far it is.
    if (::isatty(STDERR_FILENO) == 1 && (::isatty(STDOUT_FILENO) != 1 || !options->folder.empty()))
      options->progress = Export::Progress::shown;
    const app::WrappedOutput errors(std::cerr, STDERR_FILENO);
    return app::export_recording(*options, std::cout, std::cerr);
  };
}

Action prepare_import(CLI::App& command) {
  const auto options = std::make_shared<app::ImportOptions>();
  command.add_option("FILE", options->file, "CSV; its first row names the columns, units as in: speed [m/s]")
      ->required();
  command.add_option("--time", options->time_column, "Heading of the column of time")->type_name("COLUMN")->required();
  command.add_option("--scale", options->scale, "What 1 in that column is")
      ->capture_default_str()
      ->type_name("DURATION");
  command.add_option("--start", options->start, "What 0 in that column is, as 2026-03-01T12:00:00Z; default: 1970")
      ->type_name("TIME");
  command.add_option("--separator", options->separator, "Between the cells: a character, such as \";\", or tab")
      ->capture_default_str()
      ->type_name("CHARACTER");
  command.add_option("--decimal", options->decimal, "The decimal mark of its numbers; default: \".\"")
      ->type_name("CHARACTER")
      ->check(CLI::IsMember({".", ","}));
  command.add_option("--zone", options->zone, "Of times that say none: Z (UTC), or such as +01:00")->type_name("ZONE");
  command.add_option("--topic", options->topic, "Topic; default: the file's name");
  command.add_option("--origin", options->origin, "Who made it; default: the file's name")->type_name("NAME");
  command.add_option("--into", options->database, "The recording; default: FILE with .db")->type_name("DB");
  command.footer(
      "examples:\n  rtdata import flight.csv --time ticks --scale 10us --into flight.db\n"
      "  rtdata import lab.csv --time Zeit --separator \";\" --decimal , --zone +01:00");
  return [options](const Registry&) {
    std::optional<ForPeople> wrapped;
    wrapped.emplace();
    return app::import_table(*options, std::cout, std::cerr);
  };
}

Action prepare_replay(CLI::App& command) {
  struct Given {
    app::ReplayOptions options;
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
  command.add_option("--run", config.run, "Only this run; default: all, one after the other")
      ->check(at_least(1))
      ->type_name("NUMBER");
  command.add_option("--topic", config.topics, "Topics or patterns; default: all")->expected(1, -1);
  command.add_option("--rename", config.rename, "OLD=NEW: the topic OLD, and those below it, become NEW")
      ->expected(1, -1);
  command.add_option("--prefix", config.prefix, "Put before the names of the origins");
  command.add_option("--from", config.from, "First time, in UTC as 2026-03-01T12:00:00Z, or as recorded in ns")
      ->type_name("TIME");
  command.add_option("--until", config.until, "First time that is left out")->type_name("TIME");
  command.add_flag_callback(
      "--quiet,-q", [given] { given->options.is_quiet = true; }, "Of messages print warnings and errors only");
  command.footer(
      "examples:\n  rtdata replay bench.db                      as it came, on the terminal\n"
      "  rtdata replay bench.db again.json --speed max\nexit status:\n"
      "  0  all was replayed, and stored\n  1  it was not, or another error\n"
      "  2  the recording is unreadable, or the configuration has mistakes");
  return [given](const Registry& registry) {
    app::ReplayOptions& options = given->options;
    if (options.config.topics.empty()) options.config.topics = {"#"};
    options.is_virtual = given->speed == "max";
    if (!options.is_virtual) {
      double factor = 0;
      const char* const end = given->speed.data() + given->speed.size();
      const auto [stopped, failed] = std::from_chars(given->speed.data(), end, factor);
      if (failed != std::errc{} || stopped != end || !(factor > 0)) {
        std::cerr << "rtdata: --speed " << given->speed << ": it is neither a number above 0 nor max" << std::endl;
        return app::exit_other;
      }
      options.config.speed = factor;
    }
    return app::replay(registry, options);
  };
}
#endif

#ifdef RTDATA_WITH_SQLITE
Action prepare_forward(CLI::App& command) {
  const auto options = std::make_shared<app::ForwardOptions>();
  command.add_option("DB", options->database, "The recording, wherever it was moved to")->required();
  command.add_option("FILE", options->file, "The configuration whose sinks send")->required();
  command.footer(
      "example:\n  rtdata forward /media/card/run.db node.json\n"
      "Each sink of FILE with `through` goes on where it has got to in the recording.\nexit status:\n"
      "  0  all is sent\n  1  ended before\n  2  mistakes, or no recording");
  return [options](const Registry& registry) {
    std::optional<ForPeople> wrapped;
    wrapped.emplace();
    return app::forward(registry, *options);
  };
}
#endif

struct Command {
  std::string_view name;
  const char* doc;
  Action (*prepare)(CLI::App&);
};

constexpr Command commands[] = {
    {"init", "Write a starter file for this machine, ready to run", prepare_init},
    {"run", "Run a configuration; Ctrl-C ends it and stores what is queued", prepare_run},
    {"top", "Look at a running instance: rates, lateness, losses, sinks", prepare_top},
    {"ctl", "Command a running instance: rates, alarms, notes, reload", prepare_ctl},
    {"scan", "List the devices of this machine, with lines to paste", prepare_scan},
    {"doctor", "Say what of this machine costs timing or data, and what to do", prepare_doctor},
    {"bench", "Measure what this machine can do: jitter, events, recording", prepare_bench},
    {"check", "Find every mistake in a configuration; exit 2 if there is any", prepare_check},
    {"graph", "Draw the machines of a configuration", prepare_graph},
    {"types", "List the types of sensors, sinks and formats with their parameters", prepare_types},
#ifdef RTDATA_WITH_SQLITE
    {"verify", "Check a recording: exit 0 balanced or sealed, 1 not, 2 unreadable", prepare_verify},
    {"info", "Sum up a recording", prepare_info},
    {"export", "Write out what was recorded", prepare_export},
    {"replay", "Give recorded events to sinks again, as they came or faster", prepare_replay},
    {"import", "Make a recording of a table in CSV", prepare_import},
    {"forward", "Send what waits in a recording that was moved elsewhere", prepare_forward},
#endif
};

/// What is wrong with a first argument that is no command.
std::string wrong_command(const std::string& word) {
  std::vector<std::string> names;
  std::string list;
  for (const Command& command : commands) {
    names.emplace_back(command.name);
    list.append(list.empty() ? "" : ", ").append(command.name);
  }
  std::string text = "there is no command \"" + word + "\"";
  if (word.ends_with(".json")) return text + "; that configuration is run by: rtdata run " + word;
  if (word.ends_with(".db")) return text + "; that recording is summed up by: rtdata info " + word;
  const std::string nearest = nearest_name(word, names);
  return text + (nearest.empty() ? "; there are " + list : " (did you mean \"" + nearest + "\"?)") +
         "; `rtdata --help` explains them";
}

/// What is wrong with arguments of a command that it does not know.
std::string wrong_argument(const CLI::App& command) {
  const std::vector<std::string> left = command.remaining();
  const auto option = std::find_if(left.begin(), left.end(),
                                   [](const std::string& word) { return word.starts_with("-"); });
  if (option == left.end()) return "it has one argument too many, " + (left.empty() ? "" : left.front());
  const std::string name = option->substr(0, option->find('='));
  std::vector<std::string> names;
  for (const CLI::Option* known : command.get_options()) {
    for (const std::string& one : known->get_lnames()) names.push_back("--" + one);
  }
  const std::string nearest = nearest_name(name, names);
  return "there is no option " + name + (nearest.empty() ? "" : " (did you mean " + nearest + "?)");
}

int parse_and_run(const Registry& registry, int argc, char** argv) {
  CLI::App program{"rtdata acquires data from sensors into recordings, and accounts for every sample.", "rtdata"};
  program.set_version_flag("--version", "rtdata " RTDATA_VERSION);
  program.footer(examples);
  program.require_subcommand(1);

  // A subcommand that comes first is the only one that matters: the others are not even made, so that `run` starts
  // soon.
  const std::string_view first = argc > 1 ? argv[1] : "";
  const bool is_named = std::any_of(std::begin(commands), std::end(commands),
                                    [&](const Command& command) { return command.name == first; });
  if (!is_named && !first.empty() && !first.starts_with("-")) {
    const ForPeople wrapped;
    std::cerr << "rtdata: " << wrong_command(std::string(first)) << std::endl;
    return app::exit_other;
  }
  std::vector<std::pair<const CLI::App*, Action>> prepared;
  for (const Command& command : commands) {
    if (is_named && command.name != first) continue;
    CLI::App* const made = program.add_subcommand(std::string(command.name), command.doc);
    prepared.emplace_back(made, command.prepare(*made));
  }
  try {
    program.parse(argc, argv);
  } catch (const CLI::ExtrasError& error) {
    const ForPeople wrapped;
    if (!is_named) return program.exit(error) == 0 ? app::exit_good : app::exit_other;
    const std::string name(first);
    std::cerr << "rtdata " << name << ": " << wrong_argument(*prepared.front().first) << "; `rtdata " << name
              << " --help` lists what there is" << std::endl;
    return app::exit_other;
  } catch (const CLI::ParseError& error) {
    const ForPeople wrapped;
    return program.exit(error) == 0 ? app::exit_good : app::exit_other;
  }
  for (const auto& [made, act] : prepared) {
    if (made->parsed()) return act(registry);
  }
  return app::exit_other;
}

/// While it lives, std::cout remembers why a write failed. It keeps no text, so any thread may print as before.
class StandardOutput final : public std::streambuf {
 public:
  StandardOutput() : to_(std::cout.rdbuf(this)) {}
  StandardOutput(const StandardOutput&) = delete;
  StandardOutput& operator=(const StandardOutput&) = delete;
  ~StandardOutput() override { std::cout.rdbuf(to_); }
  /// False: something that was printed is lost, and that was said; but not of a reader that went away.
  bool is_written() {
    std::cout.flush();
    const int failed = errno_.load();
    if (failed != 0 && failed != EPIPE)
      std::cerr << "rtdata: cannot write the output: " << std::strerror(failed) << std::endl;
    return failed == 0;
  }

 protected:
  int overflow(int character) override {
    if (character == traits_type::eof()) return traits_type::not_eof(character);
    errno = 0;
    const int put = to_->sputc(traits_type::to_char_type(character));
    note(put != traits_type::eof());
    return put;
  }
  std::streamsize xsputn(const char* text, std::streamsize size) override {
    errno = 0;
    const std::streamsize put = to_->sputn(text, size);
    note(put == size);
    return put;
  }
  int sync() override {
    errno = 0;
    const int synced = to_->pubsync();
    note(synced == 0);
    return synced;
  }

 private:
  void note(bool is_good) {
    int none = 0;
    if (!is_good) errno_.compare_exchange_strong(none, errno == 0 ? EIO : errno);
  }
  std::streambuf* to_;
  std::atomic<int> errno_{0};  // of the first write that failed
};

}  // namespace

int run_program(const Registry& registry, int argc, char** argv) {
  try {
    StandardOutput output;
    const int status = parse_and_run(registry, argc, argv);
    return output.is_written() || status != app::exit_good ? status : app::exit_other;
  } catch (const std::exception& error) {
    const ForPeople wrapped;
    std::cerr << "rtdata: error: " << error.what() << std::endl;
    return app::exit_other;
  }
}

}  // namespace rtdata
