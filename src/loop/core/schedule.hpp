// The schedule of a loop: rate groups. All that has the same period and phase shares one deadline.
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
/// By period and phase; several of one only while one of them has had a tick that the other has not.
using RateGroups = std::multimap<std::pair<Duration, Duration>, std::unique_ptr<RateGroup>>;

/// What is called at a rate. `tick` may remove or add any member, itself included. A member that adds itself again in
/// its own tick has the next one a period after the new start, since it has just had one.
class RateMember {
 public:
  /// `tick.missed`: ticks of this member's schedule skipped just before; `tick.index` is not set.
  virtual void tick(const Tick& tick) = 0;
  /// For blame: "sensor chamber".
  virtual std::string blame_name() const = 0;

  /// Its tick held the loop longer than the loop's limit, which has been reported. May remove or add any member.
  virtual void held(Duration) {}

  /// Its next schedule does not begin earlier, though the turn did.
  virtual MonotonicTime not_before() const noexcept { return {}; }
  /// Of its first tick, as wanted: after the start, or, if negative, within the first period.
  virtual Duration wanted_phase() const noexcept { return Duration{0}; }
  /// Its schedule has begun: `first_due()` is known.
  virtual void schedule_began() {}

  bool is_scheduled() const noexcept { return group_ != nullptr || is_waiting_; }
  MonotonicTime first_due() const noexcept { return first_due_; }
  /// The first tick that has not been dealt with.
  MonotonicTime next_due() const noexcept;

  /// As things are, `tick` would do nothing: in virtual time, until something else is due, it is not called.
  virtual bool is_idle() const noexcept { return false; }

  /// Asks the processor for memory that `tick` will use besides the member's own: called some members ahead of it.
  virtual void prefetch() const noexcept {}
  Duration period() const noexcept { return period_; }
  /// Within its period, as it is placed or will be; nothing while it is not scheduled.
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
  /// One before the start is that within the first period: no tick was due before a schedule began.
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
  std::uint32_t place_ = 0;  // among the members of its group, or of those that wait
  bool is_waiting_ = false;
  using Members = PlacedList<RateMember, &RateMember::place_>;
};

class RateGroup final : public Deadline {
 public:
  RateGroup(LoopCore& loop, Duration period) : loop_(loop), period_(period) {}
  void fire(MonotonicTime now) override;
  Duration period() const noexcept { return period_; }
  bool is_idle() const noexcept override;  // when all members are
  void leave_out_until(MonotonicTime at) noexcept override;
  /// Of this member: the group's first tick not dealt with, unless the group is past it in the tick under way.
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
  /// First due at the start of this turn (rounded up to the phase grid) plus phase. Added while the loop does not turn,
  /// it begins when the loop does, so that setting up takes no ticks from anybody.
  void add(RateMember& member);
  void remove(RateMember& member) noexcept;
  /// Begins the schedules that wait for the loop to turn. Those for which there is no memory wait for the next turn.
  void begin_waiting() noexcept;

 private:
  friend class RateGroup;
  void place(RateMember& member);
  void discard(RateGroup& group) noexcept;
  void report(const RateMember& member, const char* why) noexcept;
  LoopCore& loop_;
  RateMember::Members waiting_;
  RateGroups groups_;
  const RateMember* ticking_ = nullptr;
};

}  // namespace rtdata::detail
