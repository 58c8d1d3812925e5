// Blame: finds the callback that held the loop longer than its limit.
#pragma once

#include <string>

#include "loop/core/deadline.hpp"
#include "rtdata/loop/callback.hpp"

namespace rtdata::detail {

class LoopCore;

/// Thread: the loop's.
class Blame {
 public:
  /// A callback that takes longer than `limit` is counted and reported as holding the loop.
  Blame(LoopCore& loop, Duration limit);
  Blame(const Blame&) = delete;
  Blame& operator=(const Blame&) = delete;
  ~Blame();

  /// Adds the time that a callback took. True: it held the loop, which has been reported.
  template <class Named>
  bool time_callback(CallbackTimes& times, MonotonicTime from, MonotonicTime to, const Named& name) {
    const Duration took = to - from;
    times.add(took);
    if (took <= limit_) [[likely]]
      return false;
    ++times.held;
    report_hold(name, took);
    return true;
  }
  /// When a callback was blamed last.
  MonotonicTime held_last() const noexcept { return held_last_; }

 private:
  /// Sets the loop's health to ok some time after it was last held.
  struct Recovery final : Deadline {
    explicit Recovery(Blame& blame_) : blame(blame_) {}
    void fire(MonotonicTime now) override;
    Blame& blame;
  };
  template <class Named>
  void report_hold(const Named& name, Duration took) noexcept {
    try {
      report(name(), took);
    } catch (...) {  // out of memory: it is still counted
    }
  }
  void report(const std::string& name, Duration took);

  LoopCore& loop_;
  const Duration limit_;
  Recovery recovery_{*this};
  MonotonicTime held_last_{};
};

}  // namespace rtdata::detail
