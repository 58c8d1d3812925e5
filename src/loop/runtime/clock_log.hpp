// The clock of a run: the monotonic clock that events are timed on, and the record of the time of day against it.
#pragma once

#include <algorithm>
#include <optional>
#include <utility>
#include <vector>

#include "data/saturating.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/loop/clock.hpp"

namespace rtdata::detail {

class RuntimeCore;

/// Thread: the loop's.
class ClockLog {
 public:
  /// By this clock; null: the machine's.
  ClockLog(RuntimeCore& runtime, Clock* clock);

  Clock& clock() noexcept { return *clock_; }
  /// A manual loop brings its own.
  void use_manual_clock() { use(manual_clock_); }
  /// Puts times on the line of another run's clock: a tier's on that of its main loop.
  void share_line(const ClockLog& of) noexcept;

  Time time_of(MonotonicTime at) const noexcept { return later(Time{offset_}, at.time_since_epoch()); }
  MonotonicTime monotonic_of(Time time) const noexcept {
    return MonotonicTime{difference(offset_, time.time_since_epoch())};
  }
  const ClockPair& start() const noexcept { return start_; }

  /// Records the time of day when it was set (moved against the monotonic clock by more than 1 ms), when its accuracy is
  /// another, once in a while as long as that is known, or always when an occasion is given. Returns whether it did.
  bool look(const char* occasion = nullptr);
  /// See Runtime::note_wall_clock.
  Result<void> note_wall_clock(ClockPair pair);
  /// The time of day now. Two offsets that differ by less than 1 ms count as one: that is the noise of reading two
  /// clocks.
  ClockPair read(const char* occasion) noexcept;
  ClockPair read(const std::pair<MonotonicTime, Time>& both, const char* occasion) noexcept;
  /// For a runtime that gives a recorded run again: what it has for a time of day tells nothing, and no pair of it is
  /// recorded. Whoever gives the run again hands the pairs of the recording to the recorders.
  void repeat_run() noexcept { repeated_until_ = Time::min(); }
  bool is_repeated() const noexcept { return repeated_until_.has_value(); }
  /// Of a run that is given again: up to here. Faster than it was recorded, it is ahead of the clock.
  void is_repeated_until(Time time) noexcept {
    if (repeated_until_ && time > *repeated_until_) repeated_until_ = time;
  }
  /// When a run ends that ends now.
  Time end(MonotonicTime now) const noexcept { return std::max(time_of(now), repeated_until_.value_or(Time::min())); }
  /// For a recording that begins now: the pair now, and the last ones of other sources.
  std::vector<ClockPair> pairs();

 private:
  /// A source of the time of day.
  struct Source {
    ClockPair recorded, latest;
    std::optional<Duration> best;  ///< accuracy, since one is known
    /// Whether a pair says what the recorded one does not.
    bool is_news(const ClockPair& pair) const noexcept;
  };
  void use(Clock& clock);
  void record(Source& source, const ClockPair& pair);

  RuntimeCore& runtime_;
  SystemClock system_clock_;
  ManualClock manual_clock_;
  Clock* clock_;
  Duration offset_{0};
  ClockPair start_;
  Duration last_offset_{0};
  std::optional<Time> repeated_until_;
  Source system_;
  std::vector<Source> plugged_;
};

}  // namespace rtdata::detail
