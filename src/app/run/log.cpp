#include "app/run/log.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdio>
#include <utility>

#include "data/permissions.hpp"
#include "data/utf8.hpp"

namespace rtdata::app {

std::string_view name_of(LogLevel level) noexcept {
  constexpr std::string_view names[] = {"debug", "info", "warning", "error"};
  return names[static_cast<std::size_t>(level)];
}

Log::~Log() {
  writer_.wait_until_written(std::chrono::seconds{2});
  // The descriptor stays open, because a stuck writer may still use it, and the process ends soon.
}

namespace {

int open_file(const std::string& path, mode_t permissions) noexcept {
  // Does not wait for the reader of a named pipe.
  return ::open(path.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC | O_NONBLOCK, permissions);
}

/// Puts a new file behind the descriptor when the present file is full or was moved (logrotate). The descriptor number
/// stays the same, so that a fatal signal always writes to the right file; spdlog's own rotating sink gives no
/// descriptor.
class LogFile {
 public:
  LogFile(std::string path, int fd, const LogSettings& settings)
      : path_(std::move(path)), fd_(fd), max_bytes_(settings.max_bytes), keep_(settings.keep) {}

  void make_room(std::size_t bytes) noexcept {
    struct stat open {};
    if (::fstat(fd_, &open) != 0 || !S_ISREG(open.st_mode)) return;
    struct stat there {};
    if (::stat(path_.c_str(), &there) != 0) {
      if (errno == ENOENT) begin_new(open.st_mode);
    } else if (there.st_ino != open.st_ino || there.st_dev != open.st_dev) {
      begin_new(open.st_mode);
    } else if (max_bytes_ != 0 && open.st_size > 0 && static_cast<std::uint64_t>(open.st_size) + bytes > max_bytes_) {
      rotate(open.st_mode);
    }
  }

 private:
  void rotate(mode_t mode) noexcept {
    const auto numbered = [&](unsigned number) { return path_ + "." + std::to_string(number); };
    for (unsigned i = keep_; i-- > 1;) ::rename(numbered(i).c_str(), numbered(i + 1).c_str());  // some may not exist
    if (::rename(path_.c_str(), numbered(1).c_str()) != 0) return tell(errno);
    begin_new(mode);
  }

  void begin_new(mode_t mode) noexcept {
    const int made = open_file(path_, mode & 0666);
    if (made < 0) return tell(errno);
    ::fchmod(made, mode & 07777);
    ::dup3(made, fd_, O_CLOEXEC);
    ::close(made);
    is_reported_ = false;
  }

  /// Writes a message to the continued file.
  void tell(int reason) noexcept {
    if (std::exchange(is_reported_, true)) return;
    std::array<char, 96> line{};
    const int size = std::snprintf(line.data(), line.size(), "cannot begin a new log file: error %d\n", reason);
    write_fully(fd_, line.data(), static_cast<std::size_t>(size));
  }

  std::string path_;
  int fd_;
  std::uint64_t max_bytes_;
  unsigned keep_;
  bool is_reported_ = false;
};

}  // namespace

Result<void> Log::open(const std::string& file, const LogSettings& settings) {
  const auto permissions = detail::permissions_of(settings.permissions, file);
  if (!permissions) return permissions.error();
  fd_ = open_file(file, *permissions);
  if (fd_ < 0) {
    return system_error(errno, "cannot write the log file", file,
                        "choose another with --log FILE; the program continues without a log");
  }
  file_ = file;
  least_ = settings.level;
  writer_.open(fd_,
               [log_file = LogFile(file, fd_, settings)](std::size_t bytes) mutable { log_file.make_room(bytes); });
  return {};
}

void Log::write(LogLevel level, std::string_view object, std::string_view text, std::string_view error_id) noexcept {
  if (fd_ < 0 || level < least_) return;
  std::string line = to_iso8601(wall_clock_now());
  line.replace(line.size() - 4, 3, "");  // microseconds are enough
  line.append(" ").append(name_of(level)).append(" ").append(object).append(object.empty() ? "" : ": ").append(text);
  if (!error_id.empty()) line.append(" [").append(error_id).append("]");
  std::replace(line.begin(), line.end(), '\n', ' ');
  line += '\n';
  writer_.write(detail::is_readable(line) ? line : detail::readable(line));
}

}  // namespace rtdata::app
