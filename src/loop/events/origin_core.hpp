// An origin: a source of events on a topic, and its account. The runtime keeps it by its name for the whole run, so
// that a sensor that is removed and added again goes on in the same sequence.
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
  /// Where its events come from; the account of each has other equations. An origin keeps its first one.
  enum class Supply : std::uint8_t { none, schedule, feed };

  OriginCore(std::string_view name, TopicCore& topic, std::uint32_t index);
  OriginCore(const OriginCore&) = delete;
  OriginCore& operator=(const OriginCore&) = delete;

  // The schedule. Instants are on the monotonic clock.
  void begin_segment(MonotonicTime first_due, Duration period) noexcept;
  /// Without a segment: ticks of this period that come due until the next one begins are missed ("made anew"). 0: none
  /// are. Throws.
  void be_away(Duration period) {
    if (period > Duration{0}) expect_gaps();
    if (gaps_ != nullptr) gaps_->away_period = period;
  }
  /// Ends at `end`, up to which every due tick has been counted.
  void end_segment(MonotonicTime end) noexcept;
  bool has_segment() const noexcept { return period_.count() > 0; }
  /// Without a segment: the next may not begin before, or its ticks would be among those of the last one.
  MonotonicTime free_from() const noexcept { return first_due_; }
  Time first_due() const noexcept;
  /// The segment under way as it would be if it ended at `end`.
  Segment segment(MonotonicTime end) const noexcept;

  /// The tick that was due then has not been counted, and the next will not be before it: it is begun as soon as a read
  /// has ended. `MonotonicTime::max()`: there is none any more.
  void keep_tick(MonotonicTime due) noexcept { kept_due_ = due; }

  // What became of a tick: exactly one of these for each.
  void begin_read() noexcept {
    ++counts.scheduled;
    ++counts.in_flight;
  }
  /// A read has ended well. The caller says whether it was late: `late_after` may have changed since the read began.
  void end_read(bool is_late) noexcept {
    --counts.in_flight;
    ++counts.taken;
    if (is_late) ++counts.late;
    if (gap_is_open_) [[unlikely]]
      interrupt_gap();
  }
  /// A read that needs no waiting: begins and ends at once.
  void read_at_once(Duration lateness) noexcept {
    ++counts.scheduled;
    ++counts.taken;
    if (lateness > late_after) ++counts.late;
    if (gap_is_open_) [[unlikely]]
      interrupt_gap();
  }
  /// What has just been published is of the read that was due then.
  void count_lateness(MonotonicTime due) noexcept;
  void fail_read(std::string_view reason, MonotonicTime due) noexcept;
  void fail_tick(std::string_view reason, MonotonicTime due) noexcept;
  /// `count` ticks, the first of them due at `first`, were skipped.
  void miss(std::uint64_t count, std::string_view reason, MonotonicTime first) noexcept;

  // For an origin without a schedule: the begin and the end of a time in which it could publish nothing, or did not.
  // The first does nothing while such a time lasts, the second does nothing otherwise.
  void begin_absence(Gap::Kind kind, std::string_view reason, MonotonicTime from) noexcept;
  void end_absence(MonotonicTime to) noexcept;

  /// All so far; one that still lasts is counted with its time up to `now`.
  Outages outages(Time now) const noexcept;
  bool had_outage() const noexcept { return ended_outages().number > 0; }
  /// Those that have ended; one that lasts is counted, without its time.
  Outages ended_outages() const noexcept { return gaps_ != nullptr ? gaps_->outages : Outages{}; }
  /// When the one that lasts began; without one, the earliest time.
  Time absent_since() const noexcept { return gaps_ != nullptr ? gaps_->absent_since : Time::min(); }

  /// To be called before an origin without a schedule, or a mirror, has its first gap. Throws; may be called again.
  void expect_gaps() {
    if (gaps_ == nullptr) gaps_ = std::make_unique<Gaps>();
  }

  /// Tells of the gap under way, if there is one. An absence goes on in another.
  void close_gap() noexcept;
  /// The same; and gaps that are reported later join none from before.
  void divide_gaps() noexcept;
  /// Null: none.
  const Gap* gap_under_way() const noexcept { return gap_is_open_ ? &gaps_->gap : nullptr; }

  /// What goes on when the name is claimed again, on this loop or a tier that is made again.
  struct State {
    SensorCounts counts;
    std::uint64_t sequence = 0;
    Time last_time = Time::min();
    MonotonicTime free_from{};
    Supply supply = Supply::none;
    Outages outages{};  // that have ended
  };
  State state() const noexcept { return {counts, sequence, last_time, free_from(), supply, ended_outages()}; }
  /// It goes on there. Nothing changes of an origin of this loop.
  void adopt(const State& state);
  /// Sets a mirror's account to the one that the origin's loop has sent. `under_way`: the segment that has not ended;
  /// period 0: none. `gap`: under way; null: none.
  void mirror(const SensorCounts& sent, std::uint64_t last_sequence, const Segment& under_way, const Gap* gap) noexcept;
  /// The same of its outages: those that have ended, and when the one that lasts began.
  void mirror(const Outages& ended, Time absent_since) noexcept;
  /// The segment of a mirror has ended; the account that says so comes later.
  void forget_segment() noexcept { period_ = Duration{0}; }
  /// The gap under way of a mirror has closed.
  void forget_gap() noexcept { gap_is_open_ = false; }

  // What publishing touches comes first: of ten thousand origins, each line of cache counts.
  const std::string name;
  TopicCore& topic;
  std::uint64_t sequence = 0;    ///< of the last event published
  Time last_time = Time::min();  ///< of the last event published
  Duration late_after{0};
  Passage* only_way = nullptr;   ///< to another loop, when that is all its events go to
  const std::uint32_t index;     ///< within its topic
  bool is_claimed = false;       ///< a sensor or feed of this name exists now on this loop
  bool is_mirror = false;        ///< it publishes on another loop, from which a bridge brings events and accounts
  Supply supply = Supply::none;  ///< of its last claim, once it has published

 private:
  bool gap_is_open_ = false;

 public:
  SensorCounts counts;
  SensorEntry* sensor = nullptr;  ///< that exists now, if any; feeds too

 private:
  void miss_while_away(MonotonicTime until) noexcept;
  /// Of the ticks of the segment that were counted; one period before the first, while there is none.
  MonotonicTime last_due() const noexcept;
  void extend_gap(Gap::Kind kind, std::string_view reason, MonotonicTime first, MonotonicTime last,
                  std::uint64_t count) noexcept;
  /// There was a reading: later failures begin another gap, or join this one when there are too many.
  void interrupt_gap() noexcept;
  /// To all listeners.
  void report(const Gap& gap) noexcept;

  MonotonicTime first_due_{};  // of the segment under way; without one, `free_from`
  MonotonicTime kept_due_ = MonotonicTime::max();
  Duration period_{0};  // without one, 0
  std::uint64_t scheduled_before_ = 0;
  /// The gap under way, which may be several that are joined.
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
  /// Thousands of sensors never have a gap: it is made with the first one. An open gap has it.
  std::unique_ptr<Gaps> gaps_;

 public:
  std::vector<std::string> made_of;  ///< topics of whose events it makes its own, while it is claimed: `set_made_of`
  LoopCore* comes_from = nullptr;    ///< of a mirror, the loop that it publishes on, while there is a bridge to that
};

}  // namespace rtdata::detail
