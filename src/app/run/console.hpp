// The messages of a run: a selection on the terminal, and all of them in the log file.
#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "app/control/status.hpp"
#include "app/core/configuration_commands.hpp"
#include "app/run/async_writer.hpp"
#include "app/run/log.hpp"
#include "rtdata/config/system.hpp"

namespace rtdata::app {

/// Thread: the loop's, unless stated otherwise. Functions do not wait unless stated.
class RunConsole {
 public:
  explicit RunConsole(const RunOptions& options) : options_(options) {}

  /// Opens the log file of the plan, unless the file belongs to something else.
  void open_log(SystemPlan& plan);
  Log& log() noexcept { return log_; }

  /// Values of a configuration that are never shown.
  void add_secrets(const std::vector<std::string>& secrets);
  std::string without_secrets(const std::string& text) const;

  /// Writes to the log file and shows the message on the terminal: an error of an object only once, until another
  /// message about it.
  void say(LogLevel level, std::string_view object, std::string_view what, std::string_view error_id = {});
  /// Shows text only on the terminal.
  void tell(const std::string& text);
  void report_log_failure();

  /// Reserves standard output for a sink.
  void leave_stdout() noexcept { uses_stdout_ = true; }
  bool leaves_stdout() const noexcept { return uses_stdout_; }
  /// The table, if standard output is a terminal.
  void open_view();
  bool has_view() const noexcept { return has_view_; }
  /// Draws the table over the previous one.
  void draw(const Status& status);
  void close_view();

  /// The last message.
  void report(LogLevel level, const Status& status, const std::string& verdict);
  /// Waits at most some seconds.
  void wait_until_written();
  /// Ends the program after a second signal. Thread: that of signals.
  [[noreturn]] void end_at_once(const char* signal, std::optional<std::uint64_t> queued);
  /// Reports that the loop has not started to turn because of `where`. Thread: that of signals.
  void starts_slowly(const std::string& where);
  /// Ends the program because the loop has not processed a signal. Thread: that of signals.
  [[noreturn]] void end_hanging(const char* signal, const std::string& where);

 private:
  AsyncWriter& terminal();
  [[noreturn]] void leave(const std::string& text);
  std::optional<std::string> news(std::string_view object, const std::string& text);

  const RunOptions& options_;
  std::vector<std::string> secrets_;
  std::map<std::string, std::string, std::less<>> told_;  // last message shown for each object
  AsyncWriter terminal_{16};
  AsyncWriter messages_{64};
  Log log_;
  bool has_view_ = false;
  std::size_t drawn_ = 0;  // lines of the table
  std::atomic<bool> view_is_shown_{false};
  std::string note_;  // below the table
  bool uses_stdout_ = false;
  bool is_log_failure_reported_ = false;
};

}  // namespace rtdata::app
