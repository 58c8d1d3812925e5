// The schedule of a loop: rate groups. Members with the same period and phase share one deadline.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "loop/core/deadline.hpp"
#include "loop/core/placed_list.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"

namespace rtdata::detail {

class RateGroup;
/// By period and phase; there are two groups with the same key only while one has had a tick that the other has not.
using RateGroups = std::multimap<std::pair<Duration, Duration>, std::unique_ptr<RateGroup>>;

/// An object that is called at a rate. `tick` may remove or add any member, including itself. A member that adds itself
/// again in its own tick gets the next one a period after the new start.
class RateMember {
 public:
  /// `tick.missed`: ticks of this member's schedule skipped just before; `tick.index` is not set.
  virtual void tick(const Tick& tick) = 0;
  /// For blame: "sensor chamber".
  virtual std::string blame_name() const = 0;

  /// Called after its tick held the loop longer than the loop's limit, which was reported. May remove or add any
  /// member.
  virtual void held(Duration) {}

  /// The earliest start of its next schedule, even if the turn began earlier.
  virtual MonotonicTime not_before() const noexcept { return {}; }
  /// The wanted phase of its first tick: after the start or, if negative, within the first period.
  virtual Duration wanted_phase() const noexcept { return Duration{0}; }
  /// Its schedule has begun: `first_due()` is known.
  virtual void schedule_began() {}

  bool is_scheduled() const noexcept { return group_ != nullptr || is_waiting_; }
  MonotonicTime first_due() const noexcept { return first_due_; }
  /// The first tick not yet fired or counted.
  MonotonicTime next_due() const noexcept;

  /// True if `tick` would do nothing now: in virtual time it is not called until something else is due.
  virtual bool is_idle() const noexcept { return false; }

  /// Prefetches the memory outside this object that its `tick` will use. Called while an earlier member ticks.
  virtual void prefetch() const noexcept {}
  Duration period() const noexcept { return period_; }
  /// The phase within its period; empty while it is not scheduled.
  std::optional<Duration> phase() const noexcept {
    if (group_ != nullptr) return first_due_.time_since_epoch() % period_;
    return is_waiting_ ? std::optional(first_phase() % period_) : std::nullopt;
  }

 protected:
  explicit RateMember(Duration period) noexcept : period_(period) {}
  ~RateMember() = default;
  /// While it is not scheduled.
  void set_period(Duration period) noexcept { period_ = period; }

 private:
  friend class RateGroup;
  friend class Schedule;
  /// A negative phase is moved into the first period: no tick is due before the schedule begins.
  Duration first_phase() const noexcept {
    const Duration wanted = wanted_phase();
    if (wanted.count() >= 0) return wanted;
    const Duration within = wanted % period_;
    return within.count() < 0 ? within + period_ : within;
  }
  RateGroup* group_ = nullptr;
  Duration period_;
  MonotonicTime first_due_{};

 public:
  CallbackTimes times;

 private:
  std::uint32_t place_ = 0;  // index in its group, or in the list of waiting members
  bool is_waiting_ = false;
  using Members = PlacedList<RateMember, &RateMember::place_>;
};

class RateGroup final : public Deadline {
 public:
  RateGroup(LoopCore& loop, Duration period) : loop_(loop), period_(period) {}
  void fire(MonotonicTime now) override;
  Duration period() const noexcept { return period_; }
  bool is_idle() const noexcept override;  // true if all members are idle
  void leave_out_until(MonotonicTime at) noexcept override;
  /// The member's next tick: the group's first unfired tick, unless the member has already had the running one.
  MonotonicTime next_due_of(const RateMember& member) const noexcept;

 private:
  friend class Schedule;
  LoopCore& loop_;
  Duration period_;
  RateGroups::iterator self_;
  RateMember::Members members_;
  std::size_t position_ = 0;                         // while firing: members before it have had their tick
  MonotonicTime firing_due_ = MonotonicTime::min();  // of the last tick
  MonotonicTime first_missed_{};                     // while firing: first tick not dealt with before
  bool firing_ = false;
};

class Schedule {
 public:
  explicit Schedule(LoopCore& loop) : loop_(loop) {}
  /// Adds a member; first due at the start of this turn (rounded up to the phase grid) plus phase. If the loop does not
  /// turn yet, the schedule begins when it does, so that set-up causes no missed ticks.
  void add(RateMember& member);
  void remove(RateMember& member) noexcept;
  /// Begins the schedules that wait for the loop to turn. Without memory a schedule waits for the next turn.
  void begin_waiting() noexcept;

 private:
  friend class RateGroup;
  void place(RateMember& member);
  void discard(RateGroup& group) noexcept;
  void report(const RateMember& member, std::string_view why) noexcept;
  LoopCore& loop_;
  RateMember::Members waiting_;
  RateGroups groups_;
  const RateMember* ticking_ = nullptr;
};

}  // namespace rtdata::detail
