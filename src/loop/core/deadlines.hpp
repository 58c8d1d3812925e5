// The deadlines of a loop, in order of time, and their firing.
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include "loop/core/deadline.hpp"

namespace rtdata::detail {

class LoopCore;

/// Thread: the loop's.
class Deadlines {
 public:
  explicit Deadlines(LoopCore& loop) noexcept : loop_(loop) {}

  /// Call it once for each deadline object on this loop, so that inserting does not allocate. Throws without changes.
  void reserve_one();
  void release_one() noexcept { --reserved_; }
  void insert(Deadline& deadline) noexcept;
  void remove(Deadline& deadline) noexcept;
  /// To be called after its `due` has changed.
  void moved(Deadline& deadline) noexcept;

  bool is_due(MonotonicTime now) const noexcept { return heap_.top() != nullptr && has_come(heap_.top()->due, now); }
  /// The time of the first deadline; empty if it never comes.
  std::optional<MonotonicTime> next_due() const noexcept;
  /// All ticks up to this time have been fired or counted.
  MonotonicTime handled_until() const noexcept { return handled_until_; }
  void begin(MonotonicTime now) noexcept { handled_until_ = now; }

  /// In virtual time: skips idle ticks before `until` and before any other deadline.
  void leave_out_idle(MonotonicTime until) noexcept;

  bool is_firing() const noexcept { return firing_; }
  /// Does nothing while deadlines fire. Call `arm` afterwards to arm the timer for the next one.
  void fire_due();
  void arm() noexcept;
  /// Busy-waits for the next one if it is due within `Loop::Config::spin`.
  void spin() noexcept;

 private:
  LoopCore& loop_;
  DeadlineHeap heap_;
  std::size_t reserved_ = 0;
  MonotonicTime handled_until_{};
  bool firing_ = false;
  MonotonicTime firing_until_{};
  std::vector<Deadline*> next_round_;  // inserted while firing and due already
};

}  // namespace rtdata::detail
