#include "io/stream_line.hpp"

#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <utility>

#include "io/tty.hpp"

namespace rtdata {
namespace detail {
namespace {

/// Milliseconds for poll, rounded up, so that no time is left when it returns.
int milliseconds(Duration left) {
  const auto ms = std::chrono::ceil<std::chrono::milliseconds>(std::max(left, Duration{0})).count();
  return static_cast<int>(std::min<std::int64_t>(ms, 1'000'000));
}

}  // namespace

struct StreamLine::Line {
  Line(int fd_, void (*close_)(int) noexcept) : fd(fd_), close(close_) {}
  Line(const Line&) = delete;
  Line& operator=(const Line&) = delete;
  ~Line() { close(fd); }
  const int fd;
  void (*const close)(int) noexcept;
};

Result<void> StreamLine::open() {
  const Result<std::shared_ptr<Line>> line = opened();
  if (!line) return line.error();
  return {};
}

Result<void> StreamLine::write(std::span<const std::uint8_t> bytes, Duration timeout) {
  const auto until = std::chrono::steady_clock::now() + timeout;
  const Result<std::shared_ptr<Line>> line = opened();
  if (!line) return line.error();
  while (!bytes.empty()) {
    const ssize_t done = kind_.is_connection ? ::send((*line)->fd, bytes.data(), bytes.size(), MSG_NOSIGNAL)
                                             : ::write((*line)->fd, bytes.data(), bytes.size());
    const int number = done < 0 ? errno : 0;
    if (done > 0) {
      bytes = bytes.subspan(static_cast<std::size_t>(done));
    } else if (number == EAGAIN || done == 0) {
      const Result<bool> ready = wait(*line, POLLOUT, until - std::chrono::steady_clock::now());
      if (!ready) return ready.error();
      if (!*ready)
        return Error{Errc::timed_out,
                     kind_.is_connection ? "cannot write to the server" : "cannot write to the serial line", kind_.name,
                     std::to_string(bytes.size()) + " bytes were not taken in " + to_string(timeout),
                     "is the device stopped?"};
    } else if (number != EINTR) {
      return gone(*line, number);
    }
  }
  return {};
}

Result<std::size_t> StreamLine::read(std::span<std::uint8_t> bytes, Duration timeout) {
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

void StreamLine::drop() {
  const std::lock_guard lock(mutex_);
  line_ = nullptr;
}

Result<std::shared_ptr<StreamLine::Line>> StreamLine::opened() {
  {
    const std::lock_guard lock(mutex_);
    if (line_ != nullptr) return line_;
    if (std::exchange(is_opening_, true))
      return kind_.is_connection ? Error{Errc::busy, "cannot connect", kind_.name, "an earlier attempt still hangs",
                                         "is the name server away? `host` may be an address"}
                                 : Error{Errc::busy, "cannot open the serial line", kind_.name,
                                         "opening it hangs in the kernel", "unplug the device, and plug it in again"};
  }
  const Result<int> fd = kind_.open();
  const std::lock_guard lock(mutex_);
  is_opening_ = false;
  if (!fd) return fd.error();
  return line_ = std::make_shared<Line>(*fd, kind_.close);
}

/// The next call opens it again.
Error StreamLine::gone(const std::shared_ptr<Line>& line, int number) {
  {
    const std::lock_guard lock(mutex_);
    if (line_ == line) line_ = nullptr;
  }
  if (kind_.is_connection) {
    constexpr const char* lost = "lost the connection";
    if (number == EIO || number == ECONNRESET || number == EPIPE)
      return {Errc::disconnected, lost, kind_.name, "the server has closed it", "it is opened again when it is back"};
    return system_error(number, lost, kind_.name);
  }
  constexpr const char* lost = "lost the serial line";
  constexpr const char* advice = "check the plug and the cable; it is opened again when it is back";
  if (number == EIO || number == ENXIO || number == ENODEV)
    return {Errc::disconnected, lost, kind_.name, "the device has disappeared", advice};
  return system_error(number, lost, kind_.name, advice);
}

Result<bool> StreamLine::wait(const std::shared_ptr<Line>& line, short what, Duration left) {
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

}  // namespace detail

std::shared_ptr<SerialTransport> make_kernel_serial(std::string device, SerialSettings settings) {
  return std::make_shared<detail::StreamLine>(detail::StreamLine::Kind{
      device, [device, settings] { return detail::open_tty(device, settings); }, &detail::close_tty});
}

}  // namespace rtdata
