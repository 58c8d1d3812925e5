#include "app/run/console.hpp"

#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cstring>
#include <sstream>
#include <utility>

#include "app/control/account.hpp"
#include "app/control/status_view.hpp"
#include "app/core/table.hpp"
#include "app/core/terminal_text.hpp"
#include "app/run/log_file.hpp"
#include "app/run/stop_signals.hpp"
#include "rtdata/config/read.hpp"

namespace rtdata::app {
namespace {

std::vector<std::string> lines_in(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) lines.push_back(line);
  return lines;
}

}  // namespace

void RunConsole::open_log(SystemPlan& plan) {
  messages_.open(STDERR_FILENO);
  const LogSettings& settings = plan.settings.log;
  const std::string file = log_file_of(plan, options_.log_file);
  if (!check_log_file(file, plan)) return;  // the file belongs to something else
  // Probably a mistyped name: do not make a log file for it.
  const auto is_unread = [](const Problem& problem) { return problem.id == "cannot-read"; };
  if (options_.log_file.empty() && std::any_of(plan.problems.begin(), plan.problems.end(), is_unread)) return;
  if (auto opened = log_.open(file, settings); !opened) {
    say(LogLevel::warning, "log", opened.error().text(), opened.error().id());
  }
}

void RunConsole::add_secrets(const std::vector<std::string>& secrets) {
  secrets_.insert(secrets_.end(), secrets.begin(), secrets.end());
}

std::string RunConsole::without_secrets(const std::string& text) const { return hide_secrets(text, secrets_); }

/// Opened when there is something to write.
AsyncWriter& RunConsole::terminal() {
  terminal_.open(STDOUT_FILENO);
  return terminal_;
}

/// The text on the terminal: an error of an object is shown once, until another message about the object; repeats and
/// the same reason of its health are not shown. Empty: nothing new. The log has everything.
std::optional<std::string> RunConsole::news(std::string_view object, const std::string& text) {
  if (object.empty() || object == "program") return text;
  std::string once = text;
  if (const std::size_t at = once.rfind(" ("); at != std::string::npos && once.ends_with(" times)")) once.resize(at);
  std::string& told = told_[std::string(object)];
  if (once == told) return std::nullopt;
  if (!told.empty() && once.ends_with(": " + told)) return once.substr(0, once.size() - told.size() - 2);
  told = std::move(once);
  return text;
}

void RunConsole::say(LogLevel level, std::string_view object, std::string_view what, std::string_view error_id) {
  const std::string text = without_secrets(std::string(what));
  log_.write(level, object, text, error_id);
  report_log_failure();
  if (level < (options_.talk == Talk::quiet ? LogLevel::warning : LogLevel::info)) return;
  const std::optional<std::string> shown = news(object, text);
  if (!shown) return;
  std::string line = "rtdata: ";
  if (level >= LogLevel::warning) line.append(name_of(level)).append(": ");
  line.append(object).append(object.empty() ? "" : ": ").append(detail::with_id(*shown, error_id));
  if (has_view_) {
    note_ = line;
  } else {
    tell(line + "\n");
  }
}

void RunConsole::tell(const std::string& text) { messages_.write(for_terminal(text, columns_of(STDERR_FILENO))); }

void RunConsole::report_log_failure() {
  const int failed = log_.counts().last_errno.load();
  if (failed == 0 || std::exchange(is_log_failure_reported_, true)) return;
  const Error error = system_error(failed, "cannot write the log file", log_.file());
  say(LogLevel::warning, "log", error.text(), error.id());
}

void RunConsole::open_view() {
  has_view_ = options_.talk == Talk::normal && !uses_stdout_ && ::isatty(STDOUT_FILENO) == 1;
}

void RunConsole::draw(const Status& status) {
  if (!has_view_) return;
  winsize size{};
  if (::ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) != 0 || size.ws_col == 0) size = {24, 80, 0, 0};
  const std::size_t columns = std::max<std::size_t>(size.ws_col, 20) - 1;  // the last column makes some terminals wrap
  const std::size_t rows = std::max<std::size_t>(size.ws_row, 6) - 1;
  std::vector<std::string> below = lines_in(for_terminal(note_, columns));
  below.resize(std::min<std::size_t>(below.size(), 5));
  below.emplace_back("Ctrl-C ends it");
  std::vector<std::string> lines = lines_of(status, columns, rows - std::min(rows, below.size()));
  lines.resize(std::min(lines.size(), rows - std::min(rows, below.size())));
  lines.insert(lines.end(), below.begin(), below.end());
  std::string text = drawn_ == 0 ? "\x1b[?25l" : "\x1b[" + std::to_string(drawn_) + "A";
  text += '\r';
  for (const std::string& one : lines) text += fitted(one, columns) + "\x1b[K\r\n";
  drawn_ = lines.size();
  terminal().write(text + "\x1b[J");
  view_is_shown_ = true;
}

void RunConsole::close_view() {
  if (!std::exchange(has_view_, false)) return;
  const std::string above = drawn_ == 0 ? "" : "\x1b[" + std::to_string(std::exchange(drawn_, 0)) + "A\r\x1b[J";
  terminal_.write(above + "\x1b[?25h");
  terminal_.wait_until_written(std::chrono::seconds{2});
  view_is_shown_ = false;
  if (note_.empty()) return;
  tell(note_ + "\n");
  messages_.wait_until_written(std::chrono::seconds{2});  // before the tables, which are written directly
}

void RunConsole::report(LogLevel level, const Status& status, const std::string& verdict) {
  const std::string recorded = recorded_text(status);
  for (const std::string& line : lines_in(recorded)) log_.write(LogLevel::info, "program", line);
  log_.write(level, "program", verdict);
  if (options_.talk == Talk::normal) {
    const std::size_t columns = columns_of(uses_stdout_ ? STDERR_FILENO : STDOUT_FILENO);
    const std::string text = summary(status, columns) + "\n" + recorded + for_terminal(verdict, columns) + "\n";
    (uses_stdout_ ? messages_ : terminal()).write(text);
  } else if (level != LogLevel::info) {
    tell("rtdata: " + std::string(name_of(level)) + ": " + verdict + "\n");
  }
}

void RunConsole::wait_until_written() {
  messages_.wait_until_written(std::chrono::seconds{2});
  terminal_.wait_until_written(std::chrono::seconds{2});
}

void RunConsole::end_at_once(const char* signal, std::optional<std::uint64_t> queued) {
  const std::string
      text = std::string("ended at once by a second ") + signal + ": " +
             (queued ? std::to_string(*queued) + " queued events were not stored"
                     : "how many queued events were not stored is not known, because the loop is held by a callback");
  leave(text);
}

void RunConsole::end_hanging(const char* signal, const std::string& where) {
  leave(std::string("ended by ") + signal + " though it hangs: the main loop has not returned from " + where + " for " +
        to_string(StopSignals::hang_limit) + "; the next run on its recordings reports the rest of the account");
}

void RunConsole::starts_slowly(const std::string& where) {
  const std::string text = "does not run yet after " + to_string(StopSignals::slow_limit) +
                           ": it has not returned from " + where + "; check its device";
  log_.write(LogLevel::warning, "program", text);
  const std::string line = for_terminal("rtdata: warning: program: " + text + "\n", columns_of(STDERR_FILENO));
  write_fully(STDERR_FILENO, line.data(), line.size());
}

void RunConsole::leave(const std::string& text) {
  log_.write(LogLevel::error, "program", text);
  log_.wait_until_written(std::chrono::seconds{1});
  const std::string line = for_terminal("\nrtdata: " + text + "\n", columns_of(STDERR_FILENO));
  if (view_is_shown_) {
    const char* const show_cursor = "\x1b[?25h";
    write_fully(STDOUT_FILENO, show_cursor, std::strlen(show_cursor));
  }
  write_fully(STDERR_FILENO, line.data(), line.size());
  ::_exit(exit_other);
}

}  // namespace rtdata::app
