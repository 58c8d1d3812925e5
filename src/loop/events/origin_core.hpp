// An origin: a source of events on a topic, and its account. The runtime keeps it by name for the whole run, so that a
// sensor that is removed and added again continues the same sequence.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "loop/events/allowance.hpp"
#include "rtdata/loop/ledger.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata::detail {

class LoopCore;
struct Passage;
class RuntimeCore;
class SensorEntry;
class TopicCore;

class OriginCore {
 public:
  /// Where its events come from, which determines the equations of its account. An origin never changes it.
  enum class Supply : std::uint8_t { none, schedule, feed };

  OriginCore(std::string_view name, TopicCore& topic, std::uint32_t index);
  OriginCore(const OriginCore&) = delete;
  OriginCore& operator=(const OriginCore&) = delete;

  // The schedule, in times of the monotonic clock.
  void begin_segment(MonotonicTime first_due, Duration period) noexcept;
  /// Between two segments: counts the ticks of this period until the next segment as missed ("made anew"). 0: no ticks.
  /// Throws.
  void set_absence_period(Duration period) {
    if (period > Duration{0}) expect_gaps();
    if (gaps_ != nullptr) gaps_->away_period = period;
  }
  /// Ends the segment at `end`; all due ticks up to there were counted.
  void end_segment(MonotonicTime end) noexcept;
  bool has_segment() const noexcept { return period_.count() > 0; }
  /// Between two segments: the earliest begin of the next one, so that ticks do not overlap.
  MonotonicTime free_from() const noexcept { return first_due_; }
  Time first_due() const noexcept;
  /// The current segment as if it ended at `end`.
  Segment segment(MonotonicTime end) const noexcept;

  /// Notes a due tick that was not counted yet, because it begins when the running read has ended.
  /// `MonotonicTime::max()`: none.
  void keep_tick(MonotonicTime due) noexcept { kept_due_ = due; }

  // The result of a tick: exactly one of these for each tick.
  void begin_read() noexcept {
    ++counts.scheduled;
    ++counts.in_flight;
  }
  /// A read has ended without an error. The caller decides if it was late, because `late_after` may have changed since
  /// the read began.
  void end_read(bool is_late) noexcept {
    --counts.in_flight;
    ++counts.taken;
    if (is_late) ++counts.late;
    if (gap_is_open_) [[unlikely]]
      interrupt_gap();
  }
  /// A read that begins and ends at once.
  void read_at_once(Duration lateness) noexcept {
    ++counts.scheduled;
    ++counts.taken;
    if (lateness > late_after) ++counts.late;
    if (gap_is_open_) [[unlikely]]
      interrupt_gap();
  }
  /// Counts the lateness of the sample just published, from a read due at `due`.
  void count_lateness(MonotonicTime due) noexcept;
  void fail_read(std::string_view reason, MonotonicTime due) noexcept;
  void fail_tick(std::string_view reason, MonotonicTime due) noexcept;
  /// `count` ticks, the first of them due at `first`, were skipped.
  void miss(std::uint64_t count, std::string_view reason, MonotonicTime first) noexcept;

  // For an origin without a schedule: begin and end of an absence, a time in which it could not or did not publish. The
  // first does nothing during an absence, the second does nothing otherwise.
  void begin_absence(Gap::Kind kind, std::string_view reason, MonotonicTime from) noexcept;
  void end_absence(MonotonicTime to) noexcept;

  /// All outages so far; a current one counts with its time up to `now`.
  Outages outages(Time now) const noexcept;
  bool had_outage() const noexcept { return ended_outages().number > 0; }
  /// Ended outages; a current one is counted, without its time.
  Outages ended_outages() const noexcept { return gaps_ != nullptr ? gaps_->outages : Outages{}; }
  /// The begin of the current absence; without one, the earliest time.
  Time absent_since() const noexcept { return gaps_ != nullptr ? gaps_->absent_since : Time::min(); }

  /// Call it before the first gap of an origin without a schedule, or of a mirror. Throws; may be called again.
  void expect_gaps() {
    if (gaps_ == nullptr) gaps_ = std::make_unique<Gaps>();
  }

  /// Reports the current gap, if there is one. An absence continues in a new gap.
  void close_gap() noexcept;
  /// The same; and later gaps are not joined with earlier ones.
  void divide_gaps() noexcept;
  /// Null: none.
  const Gap* gap_under_way() const noexcept { return gap_is_open_ ? &gaps_->gap : nullptr; }

  /// The state that continues when the name is claimed again, on this loop or on a restarted tier.
  struct State {
    SensorCounts counts;
    std::uint64_t sequence = 0;
    Time last_time = Time::min();
    MonotonicTime free_from{};
    Supply supply = Supply::none;
    Outages outages{};  // outages that have ended
  };
  State state() const noexcept { return {counts, sequence, last_time, free_from(), supply, ended_outages()}; }
  /// Continues with this state. Does nothing for an origin of this loop.
  void adopt(const State& state);
  /// Sets a mirror's account to the one sent by the origin's loop. `under_way`: the current segment; period 0: none.
  /// `gap`: the current gap; null: none.
  void mirror(const SensorCounts& sent, std::uint64_t last_sequence, const Segment& under_way, const Gap* gap) noexcept;
  /// The same for its outages: the ended ones, and the begin of the current one.
  void mirror(const Outages& ended, Time absent_since) noexcept;
  /// The segment of a mirror has ended; the account that says so comes later.
  void forget_segment() noexcept { period_ = Duration{0}; }
  /// The gap under way of a mirror has closed.
  void forget_gap() noexcept { gap_is_open_ = false; }

  // Members used by publishing come first, to use few cache lines with ten thousand origins.
  const std::string name;
  TopicCore& topic;
  std::uint64_t sequence = 0;    ///< of the last event published
  Time last_time = Time::min();  ///< of the last event published
  Duration late_after{0};
  Passage* only_way = nullptr;   ///< to another loop, if its events go nowhere else
  const std::uint32_t index;     ///< within its topic
  bool is_claimed = false;       ///< a sensor or feed of this name exists now on this loop
  bool is_mirror = false;        ///< it belongs to another loop, from which a bridge brings events and accounts
  Supply supply = Supply::none;  ///< of its last claim, once it has published

 private:
  bool gap_is_open_ = false;

 public:
  SensorCounts counts;
  SensorEntry* sensor = nullptr;  ///< that exists now, if any; feeds too

 private:
  void miss_while_away(MonotonicTime until) noexcept;
  /// The last counted tick of the segment; one period before the first tick if none.
  MonotonicTime last_due() const noexcept;
  void extend_gap(Gap::Kind kind, std::string_view reason, MonotonicTime first, MonotonicTime last,
                  std::uint64_t count) noexcept;
  /// After a reading: later failures begin a new gap, or join this one if there are too many.
  void interrupt_gap() noexcept;
  /// To all listeners.
  void report(const Gap& gap) noexcept;

  MonotonicTime first_due_{};  // of the current segment; without one, `free_from`
  MonotonicTime kept_due_ = MonotonicTime::max();
  Duration period_{0};  // without one, 0
  std::uint64_t scheduled_before_ = 0;
  /// The current gap, which may consist of several joined ones.
  struct Gaps {
    Gap gap;
    Gap::Kind last_kind{};  // of the last part
    std::string_view last_reason;
    std::uint64_t parts = 0;
    bool is_joining = false;      // a reading does not end it
    bool is_interrupted = false;  // by a reading, since the last part
    bool is_absence = false;      // it has not ended
    Allowance allowance;
    Time joined_up_to = Time::min();  // the end of the joined gap that was reported last
    Outages outages;                  // number of all, time of those that have ended
    Time absent_since = Time::min();  // with an absence that has not ended
    Duration away_period{0};
  };
  /// Made with the first gap, because thousands of sensors never have one. Exists while a gap is open.
  std::unique_ptr<Gaps> gaps_;

 public:
  std::vector<std::string> made_of;  ///< topics from which its events are made, while claimed: `set_made_of`
  LoopCore* comes_from = nullptr;    ///< of a mirror, the loop that it publishes on, while there is a bridge to that
};

}  // namespace rtdata::detail
