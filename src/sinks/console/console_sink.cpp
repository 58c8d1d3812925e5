#include "rtdata/sinks/console.hpp"

#include <fcntl.h>
#include <limits.h>
#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <ctime>

#include "data/setting_mistake.hpp"
#include "data/utf8.hpp"
#include "io/no_sigpipe.hpp"

namespace rtdata {
namespace {

/// The reason why the descriptor cannot be written; empty: it can.
const char* obstacle(int descriptor) {
  const int flags = ::fcntl(descriptor, F_GETFL);
  return flags < 0 ? "it is not open" : (flags & O_ACCMODE) == O_RDONLY ? "it is open for reading only" : "";
}
constexpr const char* descriptor_advice = "use 1 (standard output) or 2 (standard error)";

class ConsoleWriter final : public Writer {
 public:
  explicit ConsoleWriter(const ConsoleConfig& config)
      : where_("descriptor " + std::to_string(config.descriptor)), time_(config.time) {
    if (const std::string why = obstacle(config.descriptor); !why.empty())
      throw SetupError({Errc::bad_argument, "cannot print", where_, why, descriptor_advice});
    // A copy: an abandoned lane must not write into what has this number by then.
    fd_ = ::fcntl(config.descriptor, F_DUPFD_CLOEXEC, 3);
    if (fd_ < 0) throw SetupError(system_error(errno, "cannot print", where_));
  }
  ~ConsoleWriter() override { ::close(fd_); }

  Result<void> open() override { return {}; }

  Result<void> write(Batch& batch) override {
    if (text_.empty()) {  // otherwise it is the same batch again
      for (const Record& record : batch) append(record);
    }
    const detail::NoSigpipe guard;
    while (done_ < text_.size()) {
      if (auto written = write_some(); !written) return written;
    }
    text_.clear();
    done_ = 0;
    return {};
  }

 private:
  Result<void> write_some() {
    constexpr int patience = 500;  // ms; then the lane is free to end
    pollfd ready{fd_, POLLOUT, 0};
    const int count = ::poll(&ready, 1, patience);
    if (count == 0)
      return Error{Errc::timed_out, "cannot print", where_, "its reader does not read", "events wait in the queue"};
    if (count < 0 && errno == EINTR) return {};
    // A pipe that is ready takes this much without blocking.
    const ssize_t written = ::write(fd_, text_.data() + done_, std::min<std::size_t>(text_.size() - done_, PIPE_BUF));
    if (written >= 0) {
      done_ += static_cast<std::size_t>(written);
      return {};
    }
    const int reason = errno;
    if (reason == EINTR || reason == EAGAIN) return {};
    if (reason == EPIPE) return Error{Errc::closed, "printing has ended", where_, "its reader has closed it", ""};
    return system_error(reason, "cannot print", where_);
  }

  void append(const Record& record) {
    append_time(record.header.time);
    text_ += ' ';
    text_ += record.info->topic;
    text_ += ' ';
    text_ += detail::visible(record.info->origin);
    text_ += " #";
    text_ += std::to_string(record.header.sequence);
    const EventView event = record.view();
    for (const Leaf& leaf : event.description().leaves()) {
      text_ += ' ';
      text_ += leaf.path;
      text_ += '=';
      text_ += detail::visible(to_string(event.value(leaf)));
      if (leaf.unit.empty() || leaf.unit == "1") continue;
      text_ += ' ';
      text_ += leaf.unit;
    }
    text_ += '\n';
  }

  void append_time(Time time) {
    const std::int64_t milliseconds = std::chrono::floor<std::chrono::milliseconds>(time.time_since_epoch()).count();
    const std::int64_t whole = milliseconds >= 0 ? milliseconds / 1000 : (milliseconds - 999) / 1000;
    const auto seconds = static_cast<std::time_t>(whole);
    std::tm parts{};
    if (time_ == ConsoleTime::local) {
      ::localtime_r(&seconds, &parts);
    } else {
      ::gmtime_r(&seconds, &parts);
    }
    char text[64];
    std::snprintf(text, sizeof text, "%02d:%02d:%02d.%03d", parts.tm_hour, parts.tm_min, parts.tm_sec,
                  static_cast<int>(milliseconds - whole * 1000));
    text_ += text;
  }

  const std::string where_;
  int fd_ = -1;
  const ConsoleTime time_;
  std::string text_;      // of the batch under way
  std::size_t done_ = 0;  // bytes of it that were written
};

}  // namespace

void check_config(const ConsoleConfig& config, const ConfigItem& item, Problems& problems) {
  detail::add_mistake({"descriptor", obstacle(config.descriptor), descriptor_advice}, item, problems);
}

ConsoleSink::ConsoleSink(Loop& loop, ConsoleConfig config)
    : Sink(loop, config.sink, std::make_unique<ConsoleWriter>(config)) {}

}  // namespace rtdata
