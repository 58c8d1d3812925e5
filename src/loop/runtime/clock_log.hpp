// The clock of a run: the monotonic time of events, and the recorded time of day against it.
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
  /// Uses the time of another run's clock: a tier uses that of its main loop.
  void share_line(const ClockLog& of) noexcept;

  Time time_of(MonotonicTime at) const noexcept { return later(Time{offset_}, at.time_since_epoch()); }
  MonotonicTime monotonic_of(Time time) const noexcept {
    return MonotonicTime{difference(offset_, time.time_since_epoch())};
  }
  const ClockPair& start() const noexcept { return start_; }

  /// Records the time of day if it was set (moved by more than 1 ms against the monotonic clock) or the computer was
  /// suspended, if its accuracy changed, regularly while the accuracy is known, or always if an occasion is given.
  /// Returns true if it recorded.
  bool look(const char* occasion = nullptr);
  /// See Runtime::note_wall_clock.
  Result<void> note_wall_clock(ClockPair pair);
  /// The time of day now. Offsets that differ by less than 1 ms count as equal, because reading two clocks is inexact.
  ClockPair read(const char* occasion) noexcept;
  ClockPair read(const std::pair<MonotonicTime, Time>& both, const char* occasion) noexcept;
  /// For the runtime of a replay: its time of day is meaningless, so no pairs are recorded. The replay passes the
  /// recorded pairs to the recorders.
  void repeat_run() noexcept { repeated_until_ = Time::min(); }
  bool is_repeated() const noexcept { return repeated_until_.has_value(); }
  /// For a replay: sets the time reached. A fast replay is ahead of the clock.
  void is_repeated_until(Time time) noexcept {
    if (repeated_until_ && time > *repeated_until_) repeated_until_ = time;
  }
  /// The end time of a run that ends now.
  Time end(MonotonicTime now) const noexcept { return std::max(time_of(now), repeated_until_.value_or(Time::min())); }
  /// The pairs for a recording that begins now: the present pair, and the last ones of other sources.
  std::vector<ClockPair> pairs();

 private:
  /// A source of the time of day.
  struct Source {
    ClockPair recorded, latest;
    std::optional<Duration> best;  ///< accuracy, since one is known
    /// True if a pair has new information.
    bool is_news(const ClockPair& pair) const noexcept;
  };
  void use(Clock& clock);
  /// See Clock::suspended; differences of less than 1 ms count as equal.
  Duration suspended() noexcept;
  void record(Source& source, const ClockPair& pair);

  RuntimeCore& runtime_;
  SystemClock system_clock_;
  ManualClock manual_clock_;
  Clock* clock_;
  Duration offset_{0};
  ClockPair start_;
  Duration last_offset_{0};
  Duration last_suspended_{0};
  std::optional<Time> repeated_until_;
  Source system_;
  std::vector<Source> plugged_;
};

}  // namespace rtdata::detail
