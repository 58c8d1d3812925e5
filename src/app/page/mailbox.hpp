// A mailbox: any thread puts functions in; the object's loop calls them, in order.
#pragma once

#include <sys/eventfd.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdint>
#include <memory>
#include <utility>

#include "rtdata/loop/callback.hpp"
#include "rtdata/loop/watch.hpp"

namespace rtdata::app {

/// Neither side waits for the other, and either may be gone: functions put after that are destroyed with the mailbox,
/// which both share. A function must not own its mailbox.
template <class To>
class Mailbox {
 public:
  /// Throws SetupError: the system gives no descriptor.
  Mailbox() : fd_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
    if (fd_ < 0) throw SetupError(system_error(errno, "cannot pass functions between threads", "eventfd"));
  }
  Mailbox(const Mailbox&) = delete;
  Mailbox& operator=(const Mailbox&) = delete;
  ~Mailbox() {
    for (Letter* one = newest_.load(); one != nullptr;) std::unique_ptr<Letter>(std::exchange(one, one->before));
    ::close(fd_);
  }

  /// Any thread.
  void put(Callback<void(To&)> function) {
    auto* const letter = new Letter{std::move(function), newest_.load(std::memory_order_relaxed)};
    while (
        !newest_.compare_exchange_weak(letter->before, letter, std::memory_order_release, std::memory_order_relaxed)) {
    }
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t size = ::write(fd_, &one, sizeof one);  // full: it is readable already
  }

  /// As long as the watch lives, this loop calls the functions, in the order in which they were put.
  FdWatch open(Loop& loop, To& to) {
    return {loop, fd_, FdWatch::readable, "page", [this, &to](const FdEvent&) { take(to); }};
  }

 private:
  struct Letter {
    Callback<void(To&)> function;
    Letter* before;
  };

  void take(To& to) {
    std::uint64_t count = 0;
    [[maybe_unused]] const ssize_t size = ::read(fd_, &count, sizeof count);
    Letter* next = nullptr;  // the oldest
    for (Letter* one = newest_.exchange(nullptr, std::memory_order_acquire); one != nullptr;) {
      Letter* const before = std::exchange(one->before, next);
      next = std::exchange(one, before);
    }
    while (next != nullptr) {
      const std::unique_ptr<Letter> letter(std::exchange(next, next->before));
      letter->function(to);
    }
  }

  const int fd_;
  std::atomic<Letter*> newest_{nullptr};
};

}  // namespace rtdata::app
