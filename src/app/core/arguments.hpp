// The options and arguments of each subcommand. Private to the program.
#pragma once

#include <unistd.h>

#include <CLI/CLI.hpp>
#include <functional>
#include <iostream>
#include <memory>
#include <optional>

#include "app/core/show_as.hpp"
#include "app/core/terminal_text.hpp"
#include "rtdata/config/registry.hpp"

namespace rtdata::app {

/// The action of a subcommand after the command line is parsed; returns the exit status.
using Action = std::function<int(const Registry&)>;

/// Wraps output lines of text at the width of the terminal while it lives. Not for data, and not during a
/// run, where handlers may print from any thread.
class ForPeople {
 public:
  explicit ForPeople(bool is_for_people = true) {
    if (!is_for_people) return;
    out_.emplace(std::cout, STDOUT_FILENO);
    err_.emplace(std::cerr, STDERR_FILENO);
  }

 private:
  std::optional<WrappedOutput> out_, err_;
};

/// Adds an option without a value, which sets `to`. `to` belongs to the state of the command's Action.
template <class Value>
void add_flag(CLI::App& command, const char* name, Value& to, Value is, const char* doc) {
  command.add_flag_callback(
      name, [&to, is] { to = is; }, doc);
}
/// Adds --json to a command that can print text or JSON.
inline void add_json(CLI::App& command, ShowAs& show_as, const char* doc = "Print JSON") {
  add_flag(command, "--json", show_as, ShowAs::json, doc);
}

/// Each adds the options of a command and returns its action.
Action prepare_init(CLI::App& command);
Action prepare_run(CLI::App& command);
Action prepare_check(CLI::App& command);
Action prepare_calibrate(CLI::App& command);
Action prepare_graph(CLI::App& command);
Action prepare_types(CLI::App& command);
Action prepare_explain(CLI::App& command);
Action prepare_top(CLI::App& command);
Action prepare_ctl(CLI::App& command);
Action prepare_tail(CLI::App& command);
Action prepare_bench(CLI::App& command);
Action prepare_scan(CLI::App& command);
Action prepare_doctor(CLI::App& command);

// Commands for recordings.
Action prepare_verify(CLI::App& command);
Action prepare_info(CLI::App& command);
Action prepare_runs(CLI::App& command);
Action prepare_seal(CLI::App& command);
Action prepare_rm(CLI::App& command);
Action prepare_merge(CLI::App& command);
Action prepare_compare(CLI::App& command);
Action prepare_export(CLI::App& command);
Action prepare_plot(CLI::App& command);
Action prepare_report(CLI::App& command);
Action prepare_view(CLI::App& command);
struct TailOptions;
/// The options of tail for recordings. Returns the action; none: its words do not name a recording.
std::function<std::optional<int>(const TailOptions&)> add_recorded_tail(CLI::App& command);
Action prepare_import(CLI::App& command);
Action prepare_replay(CLI::App& command);
Action prepare_forward(CLI::App& command);

}  // namespace rtdata::app
