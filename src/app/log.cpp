#include "app/log.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>

#include "data/utf8.hpp"

namespace rtdata::app {

std::string_view name_of(LogLevel level) noexcept {
  switch (level) {
    case LogLevel::debug:
      return "debug";
    case LogLevel::info:
      return "info";
    case LogLevel::warning:
      return "warning";
    case LogLevel::error:
      return "error";
  }
  return "error";
}

Log::~Log() {
  writer_.wait_until_written(std::chrono::seconds{2});
  // The descriptor stays open: a writer that is stuck may still use it, and the process ends soon.
}

Result<void> Log::open(const std::string& file, LogLevel least) {
  // Not to wait for the reader of a named pipe.
  fd_ = ::open(file.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC | O_NONBLOCK, 0644);
  if (fd_ < 0) {
    return system_error(errno, "cannot write the log file", file,
                        "choose another with --log FILE; the program runs on without");
  }
  file_ = file;
  least_ = least;
  writer_.open(fd_);
  return {};
}

void Log::write(LogLevel level, std::string_view object, std::string_view text, std::string_view error_id) noexcept {
  if (fd_ < 0 || level < least_) return;
  try {
    std::string line = to_iso8601(wall_clock_now());
    line.replace(line.size() - 4, 3, "");  // microseconds are enough
    line.append(" ").append(name_of(level)).append(" ").append(object).append(object.empty() ? "" : ": ").append(text);
    if (!error_id.empty()) line.append(" [").append(error_id).append("]");
    std::replace(line.begin(), line.end(), '\n', ' ');
    line += '\n';
    writer_.write(detail::is_readable(line) ? line : detail::readable(line));
  } catch (const std::bad_alloc&) {  // no memory for a line: the fatal end, if it comes, has its own
  }
}

}  // namespace rtdata::app
