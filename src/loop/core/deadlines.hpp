// The deadlines of a loop, in the order in which they come due, and the firing of those that are due.
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

  /// Once for each deadline object on this loop, so that none asks for memory when it is inserted. Throws, with nothing
  /// changed.
  void reserve_one();
  void release_one() noexcept { --reserved_; }
  void insert(Deadline& deadline) noexcept;
  void remove(Deadline& deadline) noexcept;
  /// To be called after its `due` has changed.
  void moved(Deadline& deadline) noexcept;

  bool is_due(MonotonicTime now) const noexcept { return heap_.top() != nullptr && has_come(heap_.top()->due, now); }
  /// Of the first deadline, if it ever comes.
  std::optional<MonotonicTime> next_due() const noexcept;
  /// Up to here every due tick has been fired or counted.
  MonotonicTime handled_until() const noexcept { return handled_until_; }
  void begin(MonotonicTime now) noexcept { handled_until_ = now; }

  /// In virtual time: passes over the ticks before `until`, and before anything else is due, at which nothing is to be
  /// done.
  void leave_out_idle(MonotonicTime until) noexcept;

  bool is_firing() const noexcept { return firing_; }
  /// Unless they fire already. The timer is not armed for the next one before `arm` is called.
  void fire_due();
  void arm() noexcept;
  /// Waits for the next one without sleeping when it is due within `Loop::Config::spin`.
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
