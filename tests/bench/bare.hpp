// What several benchmarks need of the bare system.
#pragma once

#include <sys/epoll.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include <cstdint>
#include <string>

namespace bench {

inline constexpr std::int64_t millisecond = 1'000'000;

/// An absolute timerfd with epoll, as bare as can be.
class BareTimer {
 public:
  BareTimer() : timer_(::timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK)), epoll_(::epoll_create1(0)) {
    epoll_event event{};
    event.events = EPOLLIN;
    ::epoll_ctl(epoll_, EPOLL_CTL_ADD, timer_, &event);
  }
  BareTimer(const BareTimer&) = delete;
  BareTimer& operator=(const BareTimer&) = delete;
  ~BareTimer() {
    ::close(epoll_);
    ::close(timer_);
  }
  /// Setting it also clears it: it is never read.
  void arm(std::int64_t due) const {
    itimerspec spec{};
    spec.it_value.tv_sec = due / 1'000'000'000;
    spec.it_value.tv_nsec = static_cast<decltype(spec.it_value.tv_nsec)>(due % 1'000'000'000);
    ::timerfd_settime(timer_, TFD_TIMER_ABSTIME, &spec, nullptr);
  }
  void wait() const {
    epoll_event event{};
    while (::epoll_wait(epoll_, &event, 1, -1) < 1) {
    }
  }

 private:
  int timer_;
  int epoll_;
};

inline std::int64_t on_grid(std::int64_t time) { return (time + millisecond) / millisecond * millisecond; }

/// A name in a folder; the file is removed with all that SQLite puts beside it.
class Scratch {
 public:
  Scratch(const std::string& folder, const char* name)
      : path_(folder + "/rtdata_bench." + std::to_string(::getpid()) + "." + name) {
    remove();
  }
  Scratch(const Scratch&) = delete;
  Scratch& operator=(const Scratch&) = delete;
  ~Scratch() { remove(); }
  const std::string& path() const { return path_; }

 private:
  void remove() const {
    for (const char* tail : {"", "-wal", "-shm", "-journal", "-lock", "-live", ".lock", ".live"})
      ::unlink((path_ + tail).c_str());
  }
  std::string path_;
};

}  // namespace bench
