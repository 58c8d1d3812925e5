#include "rtdata/app/program.hpp"

#include <CLI/CLI.hpp>
#include <iostream>
#include <optional>

#ifdef RTDATA_WITH_SQLITE
#include "app/commands.hpp"
#endif
#include "app/subcommands.hpp"

namespace rtdata {
namespace {

constexpr const char* examples = R"(examples:
  rtdata init bench.json                  write a starter file for this machine
  rtdata check bench.json                 find every mistake in it
  rtdata run bench.json --for 10s         run it for ten seconds
  rtdata verify bench.db                  prove that its recording is complete
  rtdata export bench.db --topic host/cpu --format csv
  rtdata types analog                     what can be configured
exit status: 0 good, 2 mistakes in the configuration, 3 loss with --fail-on-loss, 1 anything else)";

#ifdef RTDATA_WITH_SQLITE
/// The subcommands that read recordings.
class Reading {
 public:
  explicit Reading(CLI::App& program) {
    verify_ = program.add_subcommand("verify", "Check a recording: exit 0 balanced or sealed, 1 not, 2 unreadable");
    verify_->add_option("DB", verify_options_.database, "The recording")->required();
    verify_->add_flag_callback("--json", [this] { verify_options_.output = app::Output::json; }, "Print JSON");

    info_ = program.add_subcommand("info", "Sum up a recording");
    info_->add_option("DB", info_options_.database, "The recording")->required();
    info_->add_option("--run", info_options_.run, "Which run; default: the last")->type_name("NUMBER");
    info_->add_flag_callback("--json", [this] { info_options_.output = app::Output::json; }, "Print JSON");

    using Export = app::ExportOptions;
    export_ = program.add_subcommand("export", "Write out what was recorded");
    export_->add_option("DB", export_options_.database, "The recording")->required();
    export_->add_option("--topic", export_options_.topic, "Topic or pattern")->capture_default_str();
    export_->add_option("--format", export_options_.format, "csv, json, jsonl or raw")->capture_default_str();
    export_->add_option("--folder", export_options_.folder, "Write a file a topic into this folder; default: standard output");
    export_->add_option("--run", export_options_.run, "Only this run")->type_name("NUMBER");
    export_->add_option("--origin", export_options_.origin, "Only events of this sensor")->type_name("NAME");
    export_->add_option("--from", export_options_.from, "First time, as 2026-03-01T12:00:00Z or in ns")->type_name("TIME");
    export_->add_option("--until", export_options_.until, "First time that is left out")->type_name("TIME");
    export_->add_option("--limit", export_options_.limit, "At most so many rows; 0: all");
    export_->add_option("--every", export_options_.every, "Only each n-th row");
    export_->add_flag_callback("--utc", [this] { export_options_.times = Export::Times::utc; }, "Times as UTC, by the clock when it was right");
    export_->add_flag_callback("--units", [this] { export_options_.header = Export::Header::names_and_units; }, "Units in the heading of CSV");
    export_->footer("example:\n  rtdata export bench.db --topic host/cpu --format csv --utc > cpu.csv");
  }
  /// The exit status, when one of them was asked for.
  std::optional<int> run() const {
    if (verify_->parsed()) return app::verify(verify_options_, std::cout, std::cerr);
    if (info_->parsed()) return app::info(info_options_, std::cout, std::cerr);
    if (export_->parsed()) return app::export_recording(export_options_, std::cout, std::cerr);
    return std::nullopt;
  }

 private:
  CLI::App* verify_;
  CLI::App* info_;
  CLI::App* export_;
  app::VerifyOptions verify_options_;
  app::InfoOptions info_options_;
  app::ExportOptions export_options_;
};
#endif

int parse_and_run(const Registry& registry, int argc, char** argv) {
  CLI::App program{"rtdata acquires data from sensors into recordings, and accounts for every sample.", "rtdata"};
  program.set_version_flag("--version", "rtdata " RTDATA_VERSION);
  program.footer(examples);
  program.require_subcommand(1);

  std::string init_file = "rtdata.json";
  CLI::App* init = program.add_subcommand("init", "Write a starter file for this machine, ready to run");
  init->add_option("FILE", init_file, "The file; one that exists is not overwritten")->capture_default_str();

  app::RunOptions options;
  std::string duration;
  CLI::App* run = program.add_subcommand("run", "Run a configuration; Ctrl-C ends it and stores what is queued");
  run->add_option("FILE", options.file, "The configuration")->required();
  run->add_option("--for", duration, "End after so long, such as 10s or 5min")->type_name("DURATION");
  run->add_flag_callback("--fail-on-loss", [&] { options.on_loss = app::OnLoss::fail; }, "Exit 3 when anything was missed, failed or dropped");
  run->add_flag_callback("--quiet,-q", [&] { options.talk = app::Talk::quiet; }, "Print warnings and errors only");
  run->add_option("--log", options.log_file, "The log file; default: as the configuration says, or its name with .log, in the working directory")
      ->type_name("FILE");
  run->footer("example:\n  rtdata run bench.json --for 10s --fail-on-loss");

  std::string check_file;
  CLI::App* check = program.add_subcommand("check", "Find every mistake in a configuration; exit 2 if there is any");
  check->add_option("FILE", check_file, "The configuration")->required();

  std::string type;
  bool schema = false;
  CLI::App* types = program.add_subcommand("types", "List the types of sensors, sinks and formats with their parameters");
  types->add_option("NAME", type, "Only this type");
  types->add_flag("--schema", schema, "Print the JSON Schema, for editors");
  types->footer("examples:\n  rtdata types analog\n  rtdata types --schema > rtdata.schema.json");

#ifdef RTDATA_WITH_SQLITE
  Reading reading(program);
#endif
  try {
    program.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return program.exit(error) == 0 ? app::exit_good : app::exit_other;
  }
  if (!duration.empty()) {
    Result<Duration> parsed = parse_duration(duration);
    if (!parsed || *parsed <= Duration{0}) {
      std::cerr << "rtdata: --for " << duration << ": " << (parsed ? "it must be longer than nothing" : parsed.error().text()) << std::endl;
      return app::exit_other;
    }
    options.duration = *parsed;
  }
#ifdef RTDATA_WITH_SQLITE
  if (const std::optional<int> status = reading.run()) return *status;
#endif
  if (init->parsed()) return app::init(registry, init_file);
  if (run->parsed()) return app::run(registry, options);
  if (check->parsed()) return app::check(registry, check_file);
  return app::types(registry, type, schema ? app::TypesAs::schema : app::TypesAs::text);
}

}  // namespace

int run_program(const Registry& registry, int argc, char** argv) {
  try {
    return parse_and_run(registry, argc, argv);
  } catch (const std::exception& error) {
    std::cerr << "rtdata: error: " << error.what() << std::endl;
    return app::exit_other;
  }
}

}  // namespace rtdata
