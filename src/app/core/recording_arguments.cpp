// The options of the subcommands of recordings.
#include <iostream>
#include <memory>
#include <string>

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

/// Which part of a run.
void add_part(CLI::App& command, PartOptions& part) {
  command.add_option("--run", part.run, "Which run; default: the last")->type_name("NUMBER");
  command.add_option("--from", part.from, "First time, in UTC as 2026-03-01T12:00:00Z; default: all of the run")
      ->type_name("TIME");
  command.add_option("--until,--to", part.until, "First time that is left out")->type_name("TIME");
  command.add_option("--last", part.last, "So long before the end, such as 10s, instead of --from")
      ->type_name("DURATION");
}

}  // namespace

Action prepare_verify(CLI::App& command) {
  const auto options = std::make_shared<VerifyOptions>();
  command.footer(
      "examples:\n  rtdata verify bench.db\n  rtdata verify bench.db --run 3\n  rtdata verify "
      "postgresql://rt@db.example/plant\nexit status:\n"
      "  0  balanced: every tick and event is accounted for, losses too; or sealed:\n"
      "     so up to the kill or power failure that ended it; or being recorded\n"
      "  1  a run is not balanced, or not sealed yet: record into it again\n"
      "  2  unreadable or damaged");
  command.add_option("DB", options->database, "The recording, or a server: postgresql://...")->required();
  command.add_option("--run", options->run, "Only this run; default: all, the newest last")->type_name("NUMBER");
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
      "Of each origin, the sensor that events come from: its rate, and how much later\n"
      "than due it was read; p50: half of the readings at most, p99: 99 of 100.");
  command.add_option("DB", options->database, "The recording")->required();
  command.add_option("--run", options->run, "Which run; default: the last")->type_name("NUMBER");
  add_flag(command, "--gaps", options->gaps, InfoOptions::Gaps::listed, "List the gaps of the run, in UTC");
  add_json(command, options->show_as);
  return [options](const Registry&) {
    const ForPeople wrapped(options->show_as == ShowAs::text);
    return info(*options, std::cout, std::cerr);
  };
}

Action prepare_export(CLI::App& command) {
  using Export = ExportOptions;
  const auto options = std::make_shared<Export>();
  command.add_option("DB", options->database, "The recording")->required();
  command.add_option("--topic", options->topic, "Topic or pattern")->capture_default_str();
  command.add_option("--format", options->format, "csv, jsonl, cbor, influx or raw")->capture_default_str();
  command.add_option("--folder", options->folder, "Write a file a topic into this folder; default: standard output");
  add_flag(command, "--overwrite", options->existing, Export::Existing::replace, "Replace files in the folder");
  command.add_option("--run", options->run, "Only this run")->type_name("NUMBER");
  command.add_option("--origin", options->origin, "Only events of this sensor")->type_name("NAME");
  command.add_option("--from", options->from, "First time, as 2026-03-01T12:00:00Z or in ns")->type_name("TIME");
  command.add_option("--until", options->until, "First time that is left out")->type_name("TIME");
  command.add_option("--limit", options->limit, "At most this many rows; 0: all")->check(at_least(0));
  command.add_option("--every", options->every, "Only each n-th row")->check(at_least(1));
  command
      .add_option(
          "--step", options->step,
          "Reduced: for each step of this length how many values, the least, the largest and the mean of each number")
      ->type_name("DURATION");
  add_flag(command, "--utc", options->times, Export::Times::utc,
           "Times as UTC, by the clock when it was right; --from and --until are UTC, too");
  add_flag(command, "--units", options->header, Export::Header::names_and_units, "Units in the heading of CSV");
  command.footer(
      "examples:\n  rtdata export bench.db --topic host/cpu --format csv --utc > cpu.csv\n"
      "  rtdata export bench.db --topic host/cpu --step 1min");
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
  command.add_option("DB", options->database, "The recording")->required();
  command.add_option("FIELD", options->fields, "TOPIC.FIELD, or TOPIC for all its numbers; each has a panel");
  add_part(command, options->part);
  command.add_option("--origin", options->origin, "Only events of this sensor")->type_name("NAME");
  command.footer(
      "examples:\n  rtdata plot bench.db host/process.time_slices\n  rtdata plot bench.db host/cpu host/load.minutes_1 "
      "--last "
      "10s\n"
      "Each dot or column has all from the least to the most of its time. A letter below\n"
      "a curve is something that is not there; its line says when and why.");
  return [options](const Registry&) {
    const WrappedOutput errors(std::cerr, STDERR_FILENO);
    return plot(*options, std::cout, std::cerr);
  };
}

Action prepare_import(CLI::App& command) {
  const auto options = std::make_shared<ImportOptions>();
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
  command.add_option("--zone", options->zone, "Time zone of times without one: Z (UTC), or such as +01:00")
      ->type_name("ZONE");
  command.add_option("--topic", options->topic, "Topic; default: the file's name");
  command.add_option("--origin", options->origin, "Who made it; default: the file's name")->type_name("NAME");
  command.add_option("--into", options->database, "The recording; default: FILE with .db")->type_name("DB");
  command.footer(
      "examples:\n  rtdata import flight.csv --time ticks --scale 10us --into flight.db\n"
      "  rtdata import lab.csv --time Zeit --separator \";\" --decimal , --zone +01:00");
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
  command.add_option("--run", config.run, "Only this run; default: all, one after the other")
      ->check(at_least(1))
      ->type_name("NUMBER");
  command.add_option("--topic", config.topics, "Topics or patterns; default: all")->expected(1, -1);
  command.add_option("--rename", config.rename, "OLD=NEW: the topic OLD, and those below it, become NEW")
      ->expected(1, -1);
  command.add_option("--prefix", config.prefix, "Prefix of the names of the origins");
  command.add_option("--from", config.from, "First time, in UTC as 2026-03-01T12:00:00Z, or as recorded in ns")
      ->type_name("TIME");
  command.add_option("--until", config.until, "First time that is left out")->type_name("TIME");
  add_flag(command, "--quiet,-q", given->options.is_quiet, true, "Of messages print warnings and errors only");
  command.footer(
      "examples:\n  rtdata replay bench.db                      as it came, on the terminal\n"
      "  rtdata replay bench.db again.json --speed max\nexit status:\n"
      "  0  all was replayed, and stored\n  1  it was not, or another error\n"
      "  2  the recording is unreadable, or the configuration has mistakes");
  return [given](const Registry& registry) {
    ReplayOptions& options = given->options;
    if (options.config.topics.empty()) options.config.topics = {"#"};
    options.is_virtual = given->speed == "max";
    if (!options.is_virtual) {
      double& factor = options.config.speed;
      if (detail::read_number(given->speed, factor) != std::errc{} || !(factor > 0)) {
        std::cerr << "rtdata: --speed " << given->speed << ": it is neither a number above 0 nor max" << std::endl;
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
      "Each sink of FILE with `through` goes on where it has got to in the recording.\nexit status:\n"
      "  0  all is sent\n  1  ended before\n  2  mistakes, or no recording");
  return [options](const Registry& registry) {
    const ForPeople wrapped;
    return forward(registry, *options);
  };
}

}  // namespace rtdata::app
