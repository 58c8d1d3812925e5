#include "loop/runtime/clock_log.hpp"

#include <algorithm>
#include <chrono>
#include <string>
#include <utility>
#include <vector>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata::detail {

namespace {

/// Both clocks at one instant; reads again if the thread was interrupted in between, which would look like a step.
std::pair<MonotonicTime, Time> both_times(Clock& clock) noexcept {
  constexpr Duration close_enough = std::chrono::microseconds{100};
  std::pair<MonotonicTime, Time> best;
  Duration narrowest = Duration::max();
  for (int tries = 0; tries < 10 && narrowest > close_enough; ++tries) {
    const MonotonicTime before = clock.monotonic();
    const Time realtime = clock.realtime();
    const Duration width = span_between(before, clock.monotonic());
    if (width >= narrowest) continue;
    narrowest = width;
    best = {before + width / 2, realtime};
  }
  return best;
}

}  // namespace

ClockLog::ClockLog(RuntimeCore& runtime, Clock* clock) : runtime_(runtime) {
  use(clock != nullptr ? *clock : system_clock_);
}

void ClockLog::share_line(const ClockLog& of) noexcept {
  start_ = of.start_;
  offset_ = of.offset_;
  last_offset_ = of.last_offset_;
  last_suspended_ = of.last_suspended_;
}

void ClockLog::use(Clock& clock) {
  clock_ = &clock;
  const auto [at, realtime] = both_times(clock);
  last_suspended_ = clock.suspended();
  start_ = {at, realtime, "system", clock.accuracy(), "start", last_suspended_};
  offset_ = difference(start_.monotonic.time_since_epoch(), start_.realtime.time_since_epoch());
  last_offset_ = offset_;
  system_ = {start_, start_, start_.accuracy};
}

namespace {

constexpr std::size_t most_clock_sources = 16;
constexpr Duration clock_look_interval = std::chrono::seconds{1};
constexpr Duration least_between_pairs = std::chrono::seconds{10};  // of one source, to limit the recording's size
constexpr Duration most_between_pairs = std::chrono::minutes{10};

bool is_step(Duration moved) noexcept {
  constexpr Duration noise = std::chrono::milliseconds{1};
  return moved > noise || moved < -noise;
}

}  // namespace

ClockPair ClockLog::read(const char* occasion) noexcept { return read(both_times(*clock_), occasion); }

ClockPair ClockLog::read(const std::pair<MonotonicTime, Time>& both, const char* occasion) noexcept {
  const auto& [at, realtime] = both;
  const Duration offset = difference(at.time_since_epoch(), realtime.time_since_epoch());
  return {
      at,       is_step(difference(last_offset_, offset)) ? realtime : later(Time{last_offset_}, at.time_since_epoch()),
      "system", clock_->accuracy(),
      occasion, suspended()};
}

Duration ClockLog::suspended() noexcept {
  const Duration now = clock_->suspended();
  return is_step(difference(last_suspended_, now)) ? now : last_suspended_;
}

bool ClockLog::look(const char* occasion) {
  if (is_repeated()) return false;
  const auto both = clock_ == &manual_clock_ ? std::pair(manual_clock_.monotonic(), manual_clock_.realtime())
                                             : both_times(*clock_);
  const Duration offset = difference(both.first.time_since_epoch(), both.second.time_since_epoch());
  const Duration moved = difference(last_offset_, offset);
  const bool has_moved = is_step(moved);
  // The usual case, checked first.
  if (!has_moved && occasion == nullptr && span_between(system_.latest.monotonic, both.first) < clock_look_interval)
    return false;
  ClockPair pair = read(both, occasion);
  if (has_moved) {
    const Duration asleep = difference(last_suspended_, pair.suspended);
    const Duration set = difference(asleep, moved);
    last_offset_ = offset;
    last_suspended_ = pair.suspended;
    if (asleep > Duration{0})
      runtime_.log(LogLevel::warning, "clock",
                   "the computer was suspended for " +
                       to_string(std::chrono::round<std::chrono::milliseconds>(asleep)) +
                       "; schedules and recorded times stood still, UTC takes it into account");
    if (is_step(set))
      runtime_.log(LogLevel::warning, "clock",
                   "the time of day was set by " + to_string(set) +
                       "; recorded times continue without a jump, the step is recorded");
    // The clock was right until now (a leap second, a suspended machine): records its last value before the step.
    if (system_.latest.accuracy && system_.latest.monotonic > system_.recorded.monotonic)
      record(system_, system_.latest);
    if (occasion == nullptr) pair.occasion = is_step(set) ? "step" : "suspended";
  } else if (occasion == nullptr) {
    pair.occasion = pair.accuracy.has_value() == system_.recorded.accuracy.has_value() ? "regular" : "sync";
    if (!system_.is_news(pair)) {
      system_.latest = pair;
      return false;
    }
  }
  if (std::string_view(pair.occasion) == "end") {
    for (Source& source : plugged_) {
      if (source.latest.monotonic > source.recorded.monotonic) record(source, source.latest);
    }
  }
  record(system_, pair);
  return true;
}

Result<void> ClockLog::note_wall_clock(ClockPair pair) {
  const auto refused = [&](Errc code, const char* why, const char* advice) {
    return Error{code, "cannot note the time of day", "source \"" + pair.source + "\"", why, advice};
  };
  if (pair.source.empty() || pair.source.size() > 64 || pair.source == "system") {
    return refused(Errc::bad_name, "a source has a name of 1 to 64 characters that is not \"system\"",
                   "name it after what it is: \"gps\"");
  }
  if (pair.accuracy && *pair.accuracy <= Duration{0}) {
    return refused(Errc::bad_argument, "its accuracy is not above 0",
                   "give the largest possible difference from UTC, or none");
  }
  if (RuntimeCore* main = runtime_.hub) {  // the main loop's recordings keep the clock
    main->own_loop->post([main, pair] { [[maybe_unused]] const auto noted = main->clock_log.note_wall_clock(pair); });
    return {};
  }
  pair.suspended = suspended();
  const auto known = std::find_if(plugged_.begin(), plugged_.end(),
                                  [&](const Source& s) { return s.latest.source == pair.source; });
  if (known == plugged_.end()) {
    if (plugged_.size() == most_clock_sources)
      return refused(Errc::bad_argument, "there are 16 sources already", "use one name for each source");
    pair.occasion = "start";
    plugged_.push_back({pair, pair, pair.accuracy});
    record(plugged_.back(), pair);
    return {};
  }
  pair.occasion = known->recorded.accuracy.has_value() == pair.accuracy.has_value() ? "regular" : "sync";
  known->latest = pair;
  if (known->is_news(pair)) record(*known, pair);
  return {};
}

bool ClockLog::Source::is_news(const ClockPair& pair) const noexcept {
  constexpr Duration most_drift = std::chrono::milliseconds{100};  // between regular pairs
  const Duration since = span_between(recorded.monotonic, pair.monotonic);
  if (since < least_between_pairs) return false;
  if (pair.accuracy.has_value() != recorded.accuracy.has_value()) return true;
  if (pair.accuracy && (since >= most_between_pairs || *pair.accuracy <= *best / 2)) return true;
  const Duration moved = difference(since, span_between(recorded.realtime, pair.realtime));
  const Duration noise = later(later(MonotonicTime{most_drift}, pair.accuracy.value_or(Duration{0})),
                               recorded.accuracy.value_or(Duration{0}))
                             .time_since_epoch();
  return moved > noise || moved < -noise;
}

void ClockLog::record(Source& source, const ClockPair& pair) {
  const bool is_known = source.best && pair.accuracy;
  source.best = is_known ? std::min(source.best, pair.accuracy) : pair.accuracy;
  source.recorded = pair;
  source.latest = pair;
  if (is_repeated()) return;
  for (Recorder* recorder : runtime_.recorders) recorder->on_clock(pair);
}

std::vector<ClockPair> ClockLog::pairs() {
  std::vector<ClockPair> pairs;
  if (is_repeated()) return pairs;
  for (const Source& source : plugged_) pairs.push_back(source.latest);
  pairs.push_back(read("start"));
  return pairs;
}

}  // namespace rtdata::detail
