// The kernel's serial lines, with blocking calls.
#include <poll.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <mutex>

#include "io/tty.hpp"
#include "rtdata/io/serial.hpp"

namespace rtdata {
namespace {

constexpr const char* lost = "lost the serial line";

/// An open line. Shared with a call that hangs in it.
struct Line {
  explicit Line(int fd_) : fd(fd_) {}
  Line(const Line&) = delete;
  Line& operator=(const Line&) = delete;
  ~Line() { detail::close_tty(fd); }
  const int fd;
};

/// Milliseconds for poll, rounded up, so that no time is left when it returns.
int milliseconds(Duration left) {
  const auto ms = std::chrono::ceil<std::chrono::milliseconds>(std::max(left, Duration{0})).count();
  return static_cast<int>(std::min<std::int64_t>(ms, 1'000'000));
}

class KernelSerial final : public SerialTransport {
 public:
  KernelSerial(std::string device, SerialSettings settings) : device_(std::move(device)), settings_(settings) {}

  Result<void> open() override {
    const Result<std::shared_ptr<Line>> line = opened();
    if (!line) return line.error();
    return {};
  }

  Result<void> write(std::span<const std::uint8_t> bytes, Duration timeout) override {
    const auto until = std::chrono::steady_clock::now() + timeout;
    const Result<std::shared_ptr<Line>> line = opened();
    if (!line) return line.error();
    while (!bytes.empty()) {
      const ssize_t done = ::write((*line)->fd, bytes.data(), bytes.size());
      const int number = done < 0 ? errno : 0;
      if (done > 0) {
        bytes = bytes.subspan(static_cast<std::size_t>(done));
      } else if (number == EAGAIN || done == 0) {
        const Result<bool> ready = wait(*line, POLLOUT, until - std::chrono::steady_clock::now());
        if (!ready) return ready.error();
        if (!*ready)
          return Error{Errc::timed_out, "cannot write to the serial line", device_,
                       std::to_string(bytes.size()) + " bytes were not taken in " + to_string(timeout),
                       "is the device stopped?"};
      } else if (number != EINTR) {
        return gone(*line, number);
      }
    }
    return {};
  }

  Result<std::size_t> read(std::span<std::uint8_t> bytes, Duration timeout) override {
    const auto until = std::chrono::steady_clock::now() + timeout;
    const Result<std::shared_ptr<Line>> line = opened();
    if (!line) return line.error();
    for (;;) {
      const ssize_t got = ::read((*line)->fd, bytes.data(), bytes.size());
      const int number = got < 0 ? errno : 0;
      if (got > 0) return static_cast<std::size_t>(got);
      if (got == 0 && !bytes.empty()) return gone(*line, EIO);  // hung up
      if (number != EAGAIN && number != EINTR && number != 0) return gone(*line, number);
      const Result<bool> ready = wait(*line, POLLIN, until - std::chrono::steady_clock::now());
      if (!ready) return ready.error();
      if (!*ready) return std::size_t{0};
    }
  }

 private:
  Result<std::shared_ptr<Line>> opened() {
    {
      const std::lock_guard lock(mutex_);
      if (line_ != nullptr) return line_;
      if (std::exchange(is_opening_, true))
        return Error{Errc::busy, "cannot open the serial line", device_, "opening it hangs in the kernel",
                     "unplug the device, and plug it in again"};
    }
    const Result<int> fd = detail::open_tty(device_, settings_);
    const std::lock_guard lock(mutex_);
    is_opening_ = false;
    if (!fd) return fd.error();
    return line_ = std::make_shared<Line>(*fd);
  }
  /// The next call opens it again.
  Error gone(const std::shared_ptr<Line>& line, int number) {
    {
      const std::lock_guard lock(mutex_);
      if (line_ == line) line_ = nullptr;
    }
    constexpr const char* advice = "check the plug and the cable; it is opened again when it is back";
    if (number == EIO || number == ENXIO || number == ENODEV)
      return {Errc::disconnected, lost, device_, "the device has disappeared", advice};
    return system_error(number, lost, device_, advice);
  }
  Result<bool> wait(const std::shared_ptr<Line>& line, short what, Duration left) {
    struct pollfd one {
      line->fd, what, 0
    };
    const int ready = ::poll(&one, 1, milliseconds(left));
    if (ready < 0) {
      const int number = errno;
      if (number == EINTR) return true;
      return gone(line, number);
    }
    if (ready > 0 && (one.revents & (what | POLLIN)) == 0) return gone(line, EIO);  // a hang-up or an error only
    return ready > 0;
  }

  const std::string device_;
  const SerialSettings settings_;
  std::mutex mutex_;  // not while it is opened
  bool is_opening_ = false;
  std::shared_ptr<Line> line_;
};

}  // namespace

std::shared_ptr<SerialTransport> make_kernel_serial(std::string device, SerialSettings settings) {
  return std::make_shared<KernelSerial>(std::move(device), settings);
}

}  // namespace rtdata
