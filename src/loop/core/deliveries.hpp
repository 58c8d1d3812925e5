// The deliveries of a loop: queues with pending events alternate, with a small group of events each, within a time
// budget.
#pragma once

#include <cstdint>

#include "rtdata/data/time.hpp"

namespace rtdata::detail {

class LoopCore;

/// A queue of events for handlers on a loop: the loop's side of a topic.
class DeliveryQueue {
 public:
  /// Delivers a small group of events of the round, starting at time `begin`; returns the end time. It returns early
  /// between two handlers if `Deliveries::must_pause`; the next call continues there.
  virtual MonotonicTime deliver_group(LoopCore& loop, MonotonicTime begin, MonotonicTime time_limit) = 0;

  bool has_pending() const noexcept { return head_ != tail_; }
  /// True if the loop delivers from it now.
  bool is_ready() const noexcept { return is_ready_; }

 protected:
  DeliveryQueue() = default;
  ~DeliveryQueue() = default;
  std::uint64_t head_ = 0;  // position of the next event to come
  std::uint64_t tail_ = 0;  // position of the next event to deliver
  std::uint64_t round_end_ = 0;

 private:
  friend class Deliveries;
  /// Starts a round: events queued so far belong to it, later ones do not.
  void begin_round() noexcept { round_end_ = head_; }
  bool is_in_round() const noexcept { return tail_ < round_end_; }
  DeliveryQueue* next_ready_ = nullptr;
  bool is_ready_ = false;
};

/// Thread: the loop's.
class Deliveries {
 public:
  explicit Deliveries(LoopCore& loop) noexcept : loop_(loop) {}
  Deliveries(const Deliveries&) = delete;
  Deliveries& operator=(const Deliveries&) = delete;
  ~Deliveries();

  /// Adds a queue with pending events.
  void add(DeliveryQueue& queue);
  bool is_empty() const noexcept { return first_ == nullptr; }
  bool is_delivering() const noexcept { return delivering_; }
  void handler_begins(MonotonicTime at) noexcept { handler_began_ = at; }
  /// When the running handler was called for the first event of its group, seldom more than some microseconds ago; for
  /// uses that need no clock reading for each event.
  MonotonicTime handler_began() const noexcept { return handler_began_; }

  enum class Budget { limited, none };
  void deliver(Budget budget);
  /// True if the last delivery ended because of its time budget or a due deadline, and events are left.
  bool is_interrupted() const noexcept { return !is_empty() && left_ == Left::later; }
  /// True if deliveries must stop now: the time budget ended at `limit`, or a deadline of the loop is due. Never with
  /// `MonotonicTime::max()` as `limit`.
  bool must_pause(MonotonicTime now, MonotonicTime limit) const noexcept;
  /// Called when virtual time advances: resets the number of rounds, which is limited at each instant for handlers that
  /// publish for each other.
  void begin_instant() noexcept { rounds_ = 0; }

 private:
  /// Why events are left in the queues.
  enum class Left {
    nothing,
    later,   // the budget was spent
    circle,  // the rounds were spent: handlers kept publishing events for each other
  };
  /// Delivers the events that were queued when the round began.
  Left deliver_round(MonotonicTime& current, MonotonicTime end);

  LoopCore& loop_;
  DeliveryQueue* first_ = nullptr;
  DeliveryQueue* last_ = nullptr;
  bool delivering_ = false;
  bool round_is_open_ = false;  // a delivery has ended within it
  Left left_ = Left::nothing;   // by the last delivery
  MonotonicTime handler_began_{};
  int rounds_ = 0;  // in this turn; on a manual loop, at this instant
};

}  // namespace rtdata::detail
