#include "rtdata/app/program.hpp"

#include <CLI/CLI.hpp>
#include <iostream>

#include "app/subcommands.hpp"

namespace rtdata {
namespace {

constexpr const char* examples = R"(examples:
  rtdata init bench.json                  write a starter file for this machine
  rtdata check bench.json                 find every mistake in it
  rtdata run bench.json --for 10s         run it for ten seconds
  rtdata types analog                     what can be configured
exit status: 0 good, 2 mistakes in the configuration, 3 loss with --fail-on-loss, 1 anything else)";

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
