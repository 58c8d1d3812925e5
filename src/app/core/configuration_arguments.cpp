// The options of the subcommands of configurations, of running instances, and of this machine.
#include <algorithm>
#include <atomic>
#include <iostream>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "app/core/arguments.hpp"
#include "app/core/configuration_commands.hpp"

namespace rtdata::app {
namespace {

/// Parses a positive duration. Empty: invalid, and an error was printed.
std::optional<Duration> span_of(const std::string& option, const std::string& text) {
  const Result<Duration> parsed = parse_duration(text);
  if (parsed && *parsed > Duration{0}) return *parsed;
  print_error(std::cerr, option + " " + text + ": " + (parsed ? "it must be longer than 0" : parsed.error().text()),
              "bad-argument");
  return std::nullopt;
}

}  // namespace

Action prepare_init(CLI::App& command) {
  const auto file = std::make_shared<std::string>("rtdata.json");
  command.footer(
      "example:\n  rtdata init bench.json\nIts rates and limits are moderate. For other types: rtdata types");
  command.add_option("FILE", *file, "The file; one that exists is not overwritten")->capture_default_str();
  return [file](const Registry& registry) {
    const ForPeople wrapped;
    return init(registry, *file);
  };
}

Action prepare_run(CLI::App& command) {
  struct Given {
    RunOptions options;
    std::string duration;
  };
  const auto given = std::make_shared<Given>();
  command.add_option("FILE", given->options.file, "The configuration")->required();
  command.add_option("--for", given->duration, "End after this time, such as 10s or 5min")->type_name("DURATION");
  add_flag(command, "--fail-on-loss", given->options.on_loss, OnLoss::fail,
           "Exit 3 when anything was lost: ticks, events, or a time without a device");
  add_flag(command, "--quiet,-q", given->options.talk, Talk::quiet, "Print warnings and errors only");
  command
      .add_option("--log", given->options.log_file,
                  "The log file; default: as the configuration says, or its name with .log, in the working directory")
      ->type_name("FILE");
#ifdef RTDATA_WITH_PAGE
  command
      .add_option_function<std::vector<std::string>>(
          "--page",
          [given](const std::vector<std::string>& words) { given->options.page = words.empty() ? "" : words.front(); },
          "Serve the live page, too: at this address, or the next port from 127.0.0.1:8080 on that is free")
      ->expected(0, 1)
      ->type_name("[ADDRESS]");
#endif
  command.footer(
      "example:\n  rtdata run bench.json --for 10s --fail-on-loss\nexit status:\n"
      "  0  every tick and event is accounted for, and all is stored\n  1  something is not, or another error\n"
      "  2  mistakes in the configuration: nothing was started\n"
      "  3  with --fail-on-loss: something was missed, failed, unreadable, lost or\n     dropped");
  return [given](const Registry& registry) {
    if (!given->duration.empty()) {
      given->options.duration = span_of("--for", given->duration);
      if (!given->options.duration) return exit_other;
    }
    return run(registry, given->options);
  };
}

Action prepare_check(CLI::App& command) {
  const auto options = std::make_shared<CheckOptions>();
  command.footer(
      "examples:\n  rtdata check bench.json\n  rtdata check new.json --against bench.json\nexit status:\n"
      "  0  no mistake, perhaps warnings\n"
      "  1  with --against: a running system cannot change to it\n  2  mistakes");
  command.add_option("FILE", options->file, "The configuration")->required();
  command
      .add_option("--against", options->against,
                  "Also say what happens to each part when it replaces this one in a running system")
      ->type_name("FILE");
  return [options](const Registry& registry) {
    const ForPeople wrapped;
    return check(registry, *options);
  };
}

Action prepare_calibrate(CLI::App& command) {
  const auto options = std::make_shared<CalibrateOptions>();
  command.footer(
      "It takes values of the running instance of FILE, or runs the sensor alone, without\n"
      "recording. Apply a known value, wait until it is steady, enter it; then the next.\n"
      "Each is the mean of 2 s. An empty line, done or Ctrl-D ends it, undo removes one.\n"
      "With two or more, their line is written as `points` of the calibration; comments\n"
      "stay.\nexamples:\n  rtdata calibrate tank.json tank\n  rtdata calibrate bench.json scale.weight\n"
      "exit status:\n  0  written\n  1  not written\n  2  mistakes in the configuration");
  command.add_option("FILE", options->file, "The configuration")->required();
  command
      .add_option("SENSOR[.FIELD]", options->sensor,
                  "The sensor, and which of its numbers if it has several and none is called value")
      ->required();
  return [options](const Registry& registry) {
    const WrappedOutput errors(std::cerr, STDERR_FILENO);
    return calibrate(registry, *options);
  };
}

Action prepare_graph(CLI::App& command) {
  const auto options = std::make_shared<GraphOptions>();
  command.footer(
      "examples:\n  rtdata graph rocket.json                     for a ```mermaid block of Markdown\n"
      "  rtdata graph rocket.json --dot | dot -Tsvg   by Graphviz\nexit status:\n"
      "  0  drawn\n  1  there is no such machine\n  2  mistakes in the configuration");
  command.add_option("FILE", options->file, "The configuration")->required();
  command.add_option("--machine", options->machine, "Only this one")->type_name("NAME");
  add_flag(command, "--dot", options->draw_as, DrawAs::dot, "In the language of Graphviz, instead of Mermaid");
  return [options](const Registry& registry) { return graph(registry, *options); };
}

Action prepare_types(CLI::App& command) {
  struct Given {
    std::string type;
    TypesAs format = TypesAs::text;
  };
  const auto given = std::make_shared<Given>();
  command.add_option("NAME", given->type, "Only this type, or a chip or a word, such as bme280, pt100, button, csv");
  add_flag(command, "--all", given->format, TypesAs::all, "All types with their parameters");
  add_flag(command, "--schema", given->format, TypesAs::schema, "Print the JSON Schema, for editors");
  add_flag(command, "--markdown", given->format, TypesAs::markdown, "Print pages of documentation, in Markdown");
  command.footer(
      "examples:\n  rtdata types\n  rtdata types analog\n  rtdata types bme280\n  rtdata types --schema > "
      "rtdata.schema.json");
  return [given](const Registry& registry) {
    const ForPeople wrapped(given->format == TypesAs::text || given->format == TypesAs::all);
    return types(registry, given->type, given->format);
  };
}

Action prepare_explain(CLI::App& command) {
  const auto id = std::make_shared<std::string>();
  command.add_option("ID", *id, "The id in brackets behind an error; without ID, all errors are listed");
  command.footer("example:\n  rtdata explain not-permitted");
  return [id](const Registry&) {
    const ForPeople wrapped;
    return explain(*id);
  };
}

Action prepare_top(CLI::App& command) {
  const auto options = std::make_shared<TopOptions>();
  command.add_option("NAME|PID", options->instance, "Which instance; needed when several are running");
  add_flag(command, "--once", options->how_often, HowOften::once, "Print once and end");
  add_json(command, options->show_as, "Print the status as JSON, a line each time");
  command.add_option("--topic", options->topic, "Only this topic, with each of its fields and numbers on a line")
      ->excludes("--json");
  command.footer(
      "examples:\n  rtdata top                        the only instance, until q or Ctrl-C\n"
      "  rtdata top bench --once           one look at the instance called bench\n"
      "  rtdata top 4711 --once --json     for programs\n"
      "  rtdata top --topic host/cpu       its fields, large");
  return [options](const Registry&) {
    const WrappedOutput errors(std::cerr, STDERR_FILENO);  // all other output is data or wrapped separately
    return options->topic.empty() ? top(*options) : top_topic(*options);
  };
}

Action prepare_tail(CLI::App& command) {
  const auto options = std::make_shared<TailOptions>();
  command
      .add_option(
          "WORDS", options->words,
          "[NAME|PID|DB] [TOPIC ...]: an instance when several run, or a recording, and topics or patterns such as "
          "room/#")
      ->expected(0, 65);
  command.add_option("--step", options->step, "One line for each step of this length, such as 1s: least, most, mean")
      ->type_name("DURATION");
  command
      .add_option("--from", options->from,
                  "Begin with events recorded since this time: -10min, or an instant such as 2026-03-01T12:00:00Z")
      ->type_name("INSTANT");
  add_json(command, options->show_as, "Print the lines of JSON as they come: docs/subscribe.md");
  command.footer(
      "examples:\n  rtdata tail                        all events of the only instance, until Ctrl-C\n"
      "  rtdata tail bench pressure/#       of these topics of the instance called bench\n"
      "  rtdata tail --step 1s --json       for programs\n"
      "  rtdata tail bench.db --last 1min   its last minute, times in UTC");
#ifdef RTDATA_WITH_SQLITE
  const auto of_recording = add_recorded_tail(command);
#endif
  return [=](const Registry&) {
    const WrappedOutput errors(std::cerr, STDERR_FILENO);
#ifdef RTDATA_WITH_SQLITE
    if (const std::optional<int> status = of_recording(*options)) return *status;
#endif
    return tail(*options);
  };
}

Action prepare_ctl(CLI::App& command) {
  const auto words = std::make_shared<std::vector<std::string>>();
  command.add_option("WORDS", *words, "[NAME|PID] COMMAND ...: an instance when several run, and a command")
      ->expected(0, 1002);
  command.prefix_command();
  command.footer(ctl_help() +
                 "Each is recorded on the topic rtdata/commands, with its sender and its result.\n"
                 "examples:\n  rtdata ctl rate imu \"200 Hz\"\n  rtdata ctl bench note valve replaced");
  return [words, &command](const Registry&) {
    const ForPeople wrapped;
    const std::vector<std::string> rest = command.remaining();  // from the first that looks like an option on
    words->insert(words->end(), rest.begin(), rest.end());
    return ctl(*words);
  };
}

Action prepare_bench(CLI::App& command) {
  struct Given {
    BenchOptions options;
    std::string duration = "60s";
  };
  const auto given = std::make_shared<Given>();
  command.add_option("--for", given->duration, "How long the whole measurement takes, about")
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
    if (!duration) return exit_other;
    given->options.duration = *duration;
    const ForPeople wrapped(given->options.json_file != "-");
    return bench(given->options);
  };
}

Action prepare_scan(CLI::App& command) {
  const auto options = std::make_shared<ScanOptions>();
  command.add_flag("--probe", options->probe,
                   "Also read a byte from each free I2C address; a chip may react wrongly to that");
  command.add_option("--root", options->root, "Look at a copy of another machine's /sys and /dev in this folder")
      ->type_name("DIR");
  add_json(command, options->show_as);
  command.footer("examples:\n  rtdata scan\n  rtdata scan --probe");
  return [options](const Registry& registry) {
    const ForPeople wrapped(options->show_as == ShowAs::text);
    return scan(registry, *options);
  };
}

Action prepare_doctor(CLI::App& command) {
  const auto options = std::make_shared<DoctorOptions>();
  command.add_option("FILE", options->file, "The configuration that is to run here: its devices, disks and tiers too");
  command
      .add_option("--root", options->root, "Look at a copy of another machine's /proc, /sys and /etc in this folder")
      ->type_name("DIR");
  add_json(command, options->show_as);
  command.footer(
      "examples:\n  rtdata doctor\n  rtdata doctor bench.json\nexit status:\n"
      "  0  notes at most\n  1  an error\n"
      "  2  something that the configuration needs cannot work, or it has mistakes\n"
      "  3  something costs timing or data");
  return [options](const Registry& registry) {
    const ForPeople wrapped(options->show_as == ShowAs::text);
    return doctor(registry, *options);
  };
}

}  // namespace rtdata::app
