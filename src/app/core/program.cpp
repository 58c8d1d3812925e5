#include "rtdata/app/program.hpp"

#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cerrno>
#include <iostream>
#include <new>
#include <streambuf>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/core/arguments.hpp"
#include "app/core/configuration_commands.hpp"
#include "app/core/no_memory.hpp"
#include "data/listed.hpp"

namespace rtdata {
namespace {

using app::Action;
using app::ForPeople;

constexpr const char* examples = R"(examples:
  rtdata init bench.json                  write a starter file for this machine
  rtdata check bench.json                 find every mistake in it
  rtdata run bench.json --for 10s         run it for ten seconds
  rtdata top                              look at it while it runs, from another terminal
  rtdata bench                            what this machine can do, in a minute
  rtdata verify bench.db                  prove that its recording is complete
  rtdata plot bench.db host/cpu.busy
  rtdata report bench.db                  a page about it for somebody else
  rtdata export bench.db --topic host/cpu --format csv
  rtdata types analog                     what can be configured
  rtdata explain not-permitted            what an error means, and what to do
exit status:
  0  good
  1  an error; verify: the recording is not balanced, or not sealed
  2  run, check: mistakes in the configuration; verify, info, export: the recording
     is unreadable or damaged; top: several instances are running, name one
  3  run --fail-on-loss: something was missed, failed, unreadable, lost or dropped,
     or a device without a schedule was away)";

struct Command {
  std::string_view name;
  const char* doc;
  Action (*prepare)(CLI::App&);
};

constexpr Command commands[] = {
    {"init", "Write a starter file for this machine, ready to run", app::prepare_init},
    {"run", "Run a configuration; Ctrl-C ends it and stores the queued events", app::prepare_run},
    {"top", "Look at a running instance: rates, lateness, losses, sinks", app::prepare_top},
    {"tail", "Print events of a running instance as they come", app::prepare_tail},
    {"ctl", "Command a running instance: rates, alarms, notes, reload", app::prepare_ctl},
    {"scan", "List the devices of this machine, with lines to paste", app::prepare_scan},
    {"doctor", "Say what on this machine costs timing or data, and what to do", app::prepare_doctor},
    {"bench", "Measure what this machine can do: jitter, and the disk", app::prepare_bench},
    {"check", "Find every mistake in a configuration; exit 2 if there is any", app::prepare_check},
    {"calibrate", "Make the calibration of a sensor from known values", app::prepare_calibrate},
    {"graph", "Draw the machines of a configuration", app::prepare_graph},
    {"types", "List the types of sensors, sinks and formats with their parameters", app::prepare_types},
    {"explain", "Explain an error, by the id in brackets behind it", app::prepare_explain},
#ifdef RTDATA_WITH_SQLITE
    {"verify", "Check a recording: exit 0 balanced or sealed, 1 not, 2 unreadable", app::prepare_verify},
    {"info", "Sum up a recording", app::prepare_info},
    {"plot", "Draw fields of a recording in the terminal, gaps and losses too", app::prepare_plot},
    {"report", "Write a page about a run, for people without this program", app::prepare_report},
    {"runs", "List the runs of a recording, a line each", app::prepare_runs},
    {"seal", "Write down what killed runs lost, without recording again", app::prepare_seal},
    {"rm", "Delete a run of a recording; the sums of its account stay", app::prepare_rm},
    {"merge", "Make one recording of the runs of several", app::prepare_merge},
    {"compare", "Put the figures of two runs side by side", app::prepare_compare},
#ifdef RTDATA_WITH_PAGE
    {"view", "Show a recording in a browser, on the live page", app::prepare_view},
#endif
    {"export", "Write out what was recorded", app::prepare_export},
    {"replay", "Give recorded events to sinks again, as they came or faster", app::prepare_replay},
    {"import", "Make a recording of a table in CSV", app::prepare_import},
    {"forward", "Send the backlog of a recording that was moved elsewhere", app::prepare_forward},
#endif
};

struct Part {
  const char* name;
  const char* library;
  const char* package;
  const char* version = nullptr;  // version of the library; null: built without it
};

// clang-format off
constexpr Part parts[] = {
    {"SQLite", "SQLite", "libsqlite3-dev",
#ifdef RTDATA_WITH_SQLITE
     RTDATA_WITH_SQLITE
#endif
    },
    {"GPIO", "libgpiod", "libgpiod-dev",
#ifdef RTDATA_WITH_GPIO
     RTDATA_WITH_GPIO
#endif
    },
    {"Modbus", "libmodbus", "libmodbus-dev",
#ifdef RTDATA_WITH_MODBUS
     RTDATA_WITH_MODBUS
#endif
    },
    {"PostgreSQL", "libpq", "libpq-dev",
#ifdef RTDATA_WITH_POSTGRESQL
     RTDATA_WITH_POSTGRESQL
#endif
    },
    {"HTTP", "libcurl", "libcurl4-openssl-dev",
#ifdef RTDATA_WITH_HTTP
     RTDATA_WITH_HTTP
#endif
    },
    {"MQTT", "libmosquitto", "libmosquitto-dev",
#ifdef RTDATA_WITH_MQTT
     RTDATA_WITH_MQTT
#endif
    },
    {"TLS", "OpenSSL", "libssl-dev",
#ifdef RTDATA_WITH_OPENSSL
     RTDATA_WITH_OPENSSL
#endif
    },
    {"page", "libmicrohttpd", "libmicrohttpd-dev, libjs-dygraphs",
#ifdef RTDATA_WITH_PAGE
     RTDATA_WITH_PAGE
#endif
    },
    {"pattern", "PCRE2", "libpcre2-dev",
#ifdef RTDATA_WITH_PATTERN
     RTDATA_WITH_PATTERN
#endif
    },
};
// clang-format on

/// The version, with the included and missing libraries.
std::string version_text() {
  std::string text = "rtdata " RTDATA_VERSION;
  for (const Part& part : parts) {
    text.append("\n  ").append(part.name).append(": ");
    if (part.version != nullptr) {
      text.append(part.library).append(" ").append(part.version);
    } else {
      text.append("left out, built without ").append(part.library).append(" (").append(part.package).append(")");
    }
  }
  return text;
}

/// The message for an unknown command.
std::string wrong_command(const std::string& word) {
  std::vector<std::string> names;
  for (const Command& command : commands) names.emplace_back(command.name);
  std::string text = "there is no command \"" + word + "\"";
  if (word.ends_with(".json")) return text + "; to run that configuration: rtdata run " + word;
  if (word.ends_with(".db")) return text + "; to sum up that recording: rtdata info " + word;
  const std::string nearest = nearest_name(word, names);
  return text + (nearest.empty() ? "; available: " + detail::listed(names) : " (did you mean \"" + nearest + "\"?)") +
         "; `rtdata --help` explains them";
}

/// The message for unknown arguments of a command.
std::string wrong_argument(const CLI::App& command) {
  const std::vector<std::string> left = command.remaining();
  const auto option = std::find_if(left.begin(), left.end(),
                                   [](const std::string& word) { return word.starts_with("-"); });
  if (option == left.end()) return "there is one argument too many: " + (left.empty() ? "" : left.front());
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
  program.set_version_flag("--version", version_text);
  program.footer(examples);
  program.require_subcommand(1);
  program.failure_message([](const CLI::App* app, const CLI::Error& error) {
    return detail::with_id(error.what(), "bad-argument") + "\nRun with " + app->get_help_ptr()->get_name() +
           " for more information.\n";
  });

  // If the first argument is a subcommand, only that one is made, so that `run` starts quickly.
  const std::string_view first = argc > 1 ? argv[1] : "";
  const bool is_named = std::any_of(std::begin(commands), std::end(commands),
                                    [&](const Command& command) { return command.name == first; });
  if (!is_named && !first.empty() && !first.starts_with("-")) {
    const ForPeople wrapped;
    app::print_error(std::cerr, wrong_command(std::string(first)), "bad-argument");
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
    app::print_error(std::cerr,
                     wrong_argument(*prepared.front().first) + "; `rtdata " + name + " --help` lists what there is",
                     "bad-argument");
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

/// While it lives, it stores the error of a failed write to std::cout. It buffers no text, so any thread may print.
class StandardOutput final : public std::streambuf {
 public:
  StandardOutput() : to_(std::cout.rdbuf(this)) {}
  StandardOutput(const StandardOutput&) = delete;
  StandardOutput& operator=(const StandardOutput&) = delete;
  ~StandardOutput() override { std::cout.rdbuf(to_); }
  /// False: printed text was lost, and an error was shown. A closed pipe does not count.
  bool is_written() {
    std::cout.flush();
    const int failed = errno_.load();
    if (failed != 0 && failed != EPIPE)
      app::print_error(std::cerr, system_error(failed, "cannot write the output", ""));
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
  std::set_new_handler(app::end_without_memory);
  try {
    StandardOutput output;
    const int status = parse_and_run(registry, argc, argv);
    return output.is_written() || status != app::exit_good ? status : app::exit_other;
  } catch (const SetupError& error) {
    const ForPeople wrapped;
    app::print_error(std::cerr, error.error());
    return app::exit_other;
  } catch (const std::exception& error) {
    const ForPeople wrapped;
    app::print_error(std::cerr, error.what(), "system");
    return app::exit_other;
  }
}

}  // namespace rtdata
