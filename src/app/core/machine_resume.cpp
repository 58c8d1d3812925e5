// Finds the state in which a machine resumes after a pause, from a recording.
#include <algorithm>

#include "app/core/machines.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/outputs/output.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata::app {
namespace {

using fsm::MachineSettings;

constexpr std::size_t most_runs = 100;  // number of runs to search

struct LastKnown {
  RunInfo run;
  std::string state;
  Duration in_state{0};           // at the end of the recorded run
  std::optional<Duration> pause;  // since then; empty: no clock can measure it
};

/// The time between the end of the recorded data and now.
std::optional<Duration> pause_since(const Recording& recording, const RunInfo& run, Time last, Loop& loop) {
  Clock& clock = loop.runtime().core().clock();
  if (run.boot_id == clock.boot_id()) {
    const MonotonicTime then{last.time_since_epoch() - run.clock_offset};
    return std::max(clock.monotonic() - then, Duration{0});
  }
  // After another boot only times of day can be compared, and both must be known to be right.
  if (!clock.accuracy()) return std::nullopt;
  const auto pairs = recording.clock(run.run);
  const bool was_right = pairs && std::any_of(pairs->begin(), pairs->end(),
                                              [](const RecordedClock& pair) { return pair.accuracy.has_value(); });
  const auto line = recording.utc_line(run.run);
  if (!was_right || !line) return std::nullopt;
  const Duration pause = clock.realtime() - line->utc(last);
  if (pause < Duration{0}) return std::nullopt;
  return pause;
}

Result<std::optional<LastKnown>> last_known(Loop& loop, const MachineSettings& settings, const std::string& path) try {
  const Recording recording = Recording::open(path).or_throw();
  const std::vector<RunInfo> runs = recording.runs().or_throw();
  std::size_t looked_at = 0;
  for (auto run = runs.rbegin(); run != runs.rend() && looked_at < most_runs; ++run, ++looked_at) {
    RowFilter filter;
    filter.topic = settings.topic.empty() ? settings.name : settings.topic;
    filter.run = run->run;
    filter.origin = settings.name;
    auto changes = recording.events<fsm::StateChange>(filter);
    if (!changes && changes.error().code == Errc::not_found) return std::optional<LastKnown>{};
    auto events = std::move(changes).or_throw();
    std::optional<LastKnown> last;
    Time at{};
    while (const auto* const next = events.next().or_throw()) {
      last = LastKnown{*run, std::string(next->data.to), Duration{0}, std::nullopt};
      at = next->time;
    }
    if (!last) continue;
    const Time end = run->ended ? std::max(*run->ended, at) : at;
    last->in_state = end - at;
    last->pause = pause_since(recording, *run, end, loop);
    return last;
  }
  return std::optional<LastKnown>{};
} catch (const SetupError& error) {
  return error.error();
}

}  // namespace

std::optional<Resumed> resumed(Loop& loop, const MachineSettings& settings, const std::string& path) {
  const auto tell = [&](LogLevel level, const std::string& text) {
    loop.runtime().core().log(level, "machine " + settings.name, text);
  };
  const std::string begins = "it begins in " + settings.start;
  const auto found = last_known(loop, settings, path);
  if (!found) {
    tell(LogLevel::warning, "its last state cannot be read, " + begins + ": " + found.error().text());
    return std::nullopt;
  }
  if (!*found) {
    tell(LogLevel::info, "the recording has no state of the machine, " + begins);
    return std::nullopt;
  }
  const LastKnown& last = **found;
  const bool is_there = std::any_of(settings.states.begin(), settings.states.end(),
                                    [&](const fsm::StateSettings& state) { return state.name == last.state; });
  if (!is_there) {
    tell(LogLevel::warning, "its last state, " + last.state + ", is no longer a state of the machine, " + begins);
    return std::nullopt;
  }
  const bool is_fresh = last.pause ? *last.pause <= settings.resume->max_age
                                   : settings.resume->unknown_age == fsm::ResumeSettings::UnknownAge::resume;
  const std::string pause = last.pause
                                ? "a pause of " + to_string(std::chrono::round<std::chrono::milliseconds>(*last.pause))
                                : "a pause of unknown length, since no clock can be trusted";
  if (!is_fresh) {
    tell(LogLevel::warning, begins + ": it was in " + last.state + ", before " + pause);
    return std::nullopt;
  }
  tell(LogLevel::warning, "it continues in " + last.state + ", after " + pause);
  return Resumed{{last.state, last.in_state + last.pause.value_or(Duration{0}), "resumed after " + pause}, last.run};
}

Result<bool> was_armed(const std::string& path, std::int64_t run, const std::string& output,
                       const std::string& topic) try {
  const Recording recording = Recording::open(path).or_throw();
  const std::vector<RunInfo> runs = recording.runs().or_throw();
  std::size_t looked_at = 0;
  // Searches backwards, because a run after a reload has no events of unchanged outputs.
  for (auto one = runs.rbegin(); one != runs.rend() && looked_at < most_runs; ++one) {
    if (one->run > run) continue;
    ++looked_at;
    RowFilter filter;
    filter.topic = topic;
    filter.run = one->run;
    filter.origin = output;
    auto changes = recording.events<OutputChange>(filter);
    if (!changes && changes.error().code == Errc::not_found) return false;
    auto events = std::move(changes).or_throw();
    std::optional<bool> is_armed;
    while (const auto* const next = events.next().or_throw())
      if (next->data.cause != OutputCause::stop) is_armed = next->data.armed;
    if (is_armed) return *is_armed;
  }
  return false;
} catch (const SetupError& error) {
  return error.error();
}

}  // namespace rtdata::app
