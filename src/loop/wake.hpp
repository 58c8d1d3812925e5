// Wakes a loop up from other threads.
#pragma once

#include <sys/eventfd.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdint>

namespace rtdata::detail {

/// An eventfd; wake-ups that the loop has not answered yet are one. In place of uv_async_t, whose loop (in libuv 1.44)
/// spins until the sender has left its call: for good, when the sender waits for the CPU that a real-time loop spins
/// on.
class Wake {
 public:
  Wake() = default;
  Wake(const Wake&) = delete;
  Wake& operator=(const Wake&) = delete;
  ~Wake() {
    if (fd_ >= 0) ::close(fd_);
  }

  /// False: errno says why.
  bool open() noexcept {
    fd_ = ::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    return fd_ >= 0;
  }
  int fd() const noexcept { return fd_; }

  /// Any thread, signal handlers too.
  void send() noexcept {
    if (is_sent_.exchange(true, std::memory_order_acq_rel)) return;
    const int before = errno;
    constexpr std::uint64_t one = 1;
    [[maybe_unused]] const auto written = ::write(fd_, &one, sizeof one);
    errno = before;
  }
  /// The loop's thread, when `fd` is readable: what was sent before is seen from now on, what comes later wakes again.
  void answer() noexcept {
    std::uint64_t sent = 0;
    [[maybe_unused]] const auto read = ::read(fd_, &sent, sizeof sent);
    is_sent_.exchange(false, std::memory_order_acq_rel);
  }

 private:
  int fd_ = -1;
  std::atomic<bool> is_sent_{false};
};

}  // namespace rtdata::detail
