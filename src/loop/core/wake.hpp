// Wakes a loop up from other threads.
#pragma once

#include <sys/eventfd.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdint>

namespace rtdata::detail {

/// An eventfd to which a sender writes only if the loop sleeps or is about to; a turning loop checks the flag itself.
/// It replaces uv_async_t: in libuv 1.44 the loop spins until the sender has left its call, which is for ever if the
/// sender waits for the processor of a spinning real-time loop.
class Wake {
 public:
  Wake() = default;
  Wake(const Wake&) = delete;
  Wake& operator=(const Wake&) = delete;
  ~Wake() {
    if (fd_ >= 0) ::close(fd_);
  }

  /// False: see errno.
  bool open() noexcept {
    fd_ = ::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    return fd_ >= 0;
  }
  int fd() const noexcept { return fd_; }

  /// Any thread, signal handlers too.
  void send() noexcept {
    if (state_.exchange(has_news, std::memory_order_acq_rel) != sleeps) return;
    const int before = errno;
    constexpr std::uint64_t one = 1;
    [[maybe_unused]] const auto written = ::write(fd_, &one, sizeof one);
    errno = before;
  }

  /// True if something was sent that the loop has not taken. Any thread.
  bool is_sent() const noexcept { return state_.load(std::memory_order_acquire) == has_news; }

  // ---- the loop's thread

  /// Call it when `fd` is readable.
  void answer() noexcept {
    std::uint64_t sent = 0;
    [[maybe_unused]] const auto read = ::read(fd_, &sent, sizeof sent);
  }
  /// The loop turns from here on. True: something was sent. Acquire order: the loop sees all writes of senders before
  /// `send`.
  bool take_news() noexcept { return state_.exchange(turns, std::memory_order_acq_rel) == has_news; }
  /// The loop may sleep from here on. False: something was sent, which the loop must take first.
  bool rest() noexcept {
    State expected = turns;
    return state_.compare_exchange_strong(expected, sleeps, std::memory_order_acq_rel) || expected == sleeps;
  }

 private:
  enum State : int { sleeps, turns, has_news };
  int fd_ = -1;
  std::atomic<State> state_{sleeps};
};

}  // namespace rtdata::detail
