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

/// What a subcommand does once the command line is read; returns the exit status.
using Action = std::function<int(const Registry&)>;

/// For what people read: lines as wide as the terminal, while it lives. Not where a run goes on, whose handlers may
/// print from any thread, and not around data.
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

/// An option without a value, which makes `to` this. `to` is of what the command's Action holds.
template <class Value>
void add_flag(CLI::App& command, const char* name, Value& to, Value is, const char* doc) {
  command.add_flag_callback(
      name, [&to, is] { to = is; }, doc);
}
/// Of a command that prints for people or for programs.
inline void add_json(CLI::App& command, ShowAs& show_as, const char* doc = "Print JSON") {
  add_flag(command, "--json", show_as, ShowAs::json, doc);
}

/// Each adds to the command what it takes, and returns what is done with it.
Action prepare_init(CLI::App& command);
Action prepare_run(CLI::App& command);
Action prepare_check(CLI::App& command);
Action prepare_graph(CLI::App& command);
Action prepare_types(CLI::App& command);
Action prepare_explain(CLI::App& command);
Action prepare_top(CLI::App& command);
Action prepare_ctl(CLI::App& command);
Action prepare_bench(CLI::App& command);
Action prepare_scan(CLI::App& command);
Action prepare_doctor(CLI::App& command);

// Of recordings.
Action prepare_verify(CLI::App& command);
Action prepare_info(CLI::App& command);
Action prepare_runs(CLI::App& command);
Action prepare_seal(CLI::App& command);
Action prepare_rm(CLI::App& command);
Action prepare_merge(CLI::App& command);
Action prepare_compare(CLI::App& command);
Action prepare_export(CLI::App& command);
Action prepare_import(CLI::App& command);
Action prepare_replay(CLI::App& command);
Action prepare_forward(CLI::App& command);

}  // namespace rtdata::app
