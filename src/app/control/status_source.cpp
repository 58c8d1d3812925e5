#include "app/control/status_source.hpp"

#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cstring>
#include <utility>

#include "app/control/request.hpp"
#include "fsm/configured.hpp"
#include "loop/core/callback_survey.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/tier/tier_core.hpp"
#include "rtdata/outputs/output.hpp"
#include "rtdata/sensors/limit.hpp"

namespace rtdata::app {
namespace {

constexpr std::size_t most_callbacks = 64;  // the slowest ones

Status::Lateness lateness_of(const TimeCounts& counts) {
  return {counts.percentile(0.5), counts.percentile(0.99), counts.largest()};
}

/// For an alarm or an output, shows the important fields only.
void show_change(Status::Sensor& sensor) {
  const std::vector<std::byte>& payload = sensor.payload;
  const Description& description = *sensor.description;
  const auto named = [&](const char* path) { return shown_value(read(*description.find(path), payload.data())); };
  if (description.same_meaning(*description_of<Alarm>()) && payload.size() == sizeof(Alarm)) {
    Alarm alarm;
    std::memcpy(&alarm, payload.data(), sizeof alarm);
    sensor.alarm = Status::Alarm{named("alarm"), alarm.is_active, alarm.acknowledged};
    sensor.value = sensor.alarm->name + (alarm.value ? " at " + shown_value(*alarm.value) : "");
  } else if (description.same_meaning(*description_of<OutputChange>()) && payload.size() == sizeof(OutputChange)) {
    OutputChange change;
    std::memcpy(&change, payload.data(), sizeof change);
    sensor.value = (change.done ? shown_value(*change.done) : std::string("not set")) + ", by " + named("cause");
  }
}

}  // namespace

// Eight steps for each power of two: 0 to 7 ns one by one, then 8, 9 ... 15, 16, 18 ...
void TimeCounts::add(Duration time) noexcept {
  const auto ns = static_cast<std::uint64_t>(std::max<Duration::rep>(time.count(), 0));
  auto index = static_cast<std::size_t>(ns);
  if (ns >= 8) {
    const auto shift = static_cast<std::size_t>(std::bit_width(ns)) - 4;
    index = 8 * (shift + 1) + ((ns >> shift) & 7);
  }
  ++counts_[std::min(index, counts_.size() - 1)];
  ++total_;
  largest_ = std::max(largest_, time);
}

void TimeCounts::add(const TimeCounts& other) noexcept {
  for (std::size_t i = 0; i < counts_.size(); ++i) counts_[i] += other.counts_[i];
  total_ += other.total_;
  largest_ = std::max(largest_, other.largest_);
}

Duration TimeCounts::percentile(double fraction) const noexcept {
  const auto wanted = static_cast<std::uint64_t>(fraction * static_cast<double>(total_));
  std::uint64_t below = 0;
  for (std::size_t i = 0; i < counts_.size(); ++i) {
    below += counts_[i];
    if (below <= wanted) continue;
    const std::size_t next = i + 1;  // the lower end of the next step
    const std::uint64_t end = next < 8 ? next : (8 + (next & 7)) << (next / 8 - 1);
    return std::min(largest_, Duration{static_cast<Duration::rep>(end)});
  }
  return largest_;
}

void Pace::add(std::uint64_t count, MonotonicTime at) {
  constexpr Duration span = std::chrono::seconds{5}, least = std::chrono::milliseconds{200};
  if (!marks_.empty() && count < marks_.back().count) marks_.clear();
  if (!marks_.empty() && (count == marks_.back().count || at <= marks_.back().at)) return;
  if (marks_.size() > 1 && at - marks_[marks_.size() - 2].at < least) marks_.pop_back();
  marks_.push_back({count, at});
  while (marks_.size() > 2 && at - marks_[1].at >= span) marks_.pop_front();
}

std::optional<double> Pace::per_second(MonotonicTime now, Duration period) const noexcept {
  const Duration known = std::max<Duration>(std::chrono::milliseconds{900}, 2 * period);
  if (marks_.empty()) return std::nullopt;
  const auto count = static_cast<double>(marks_.back().count - marks_.front().count);
  const auto span = static_cast<double>((marks_.back().at - marks_.front().at).count());
  const Duration since = now - marks_.back().at;
  if (marks_.size() < 2) return since < known ? std::nullopt : std::optional(0.0);
  // The pause is clearly longer than the interval: the count grows more slowly or has stopped.
  if (since > std::chrono::seconds{1} && static_cast<double>(since.count()) * count > 2 * span)
    return 1e9 / static_cast<double>(since.count());
  return count * 1e9 / span;
}

StatusSource::StatusSource(Loop& loop, Info info)
    : loop_(loop), info_(std::move(info)), started_(loop.time()), started_at_(loop.now()) {
  keep_changes();
}

void StatusSource::set(Info info) {
  info_ = std::move(info);
  keep_changes();
}

void StatusSource::keep_changes() {
  change_subscriptions_.clear();
  for (const std::string& topic : info_.changes) {
    change_subscriptions_.push_back(loop_.subscribe(topic, [this](const EventView& event) {
      auto kept = changes_.find(event.origin());
      if (kept == changes_.end()) kept = changes_.emplace(event.origin(), std::vector<std::byte>{}).first;
      kept->second.assign(event.payload().begin(), event.payload().end());
    }));
    change_subscriptions_.back().set_name("status");
  }
}

std::function<std::string()> StatusSource::answer(std::uint64_t client, std::string_view line) {
  if (std::string why = refusal_of(line); !why.empty())
    return [why = std::move(why)] { return answer_line("error", why); };
  return [status = std::make_shared<Status>(take(client))] { return json_of(*status); };
}

void StatusSource::forget(std::uint64_t client) {
  clients_.erase(client);
  if (!clients_.empty()) return;
  subscription_.close();
  seen_.clear();
  loads_.clear();
}

void StatusSource::watch() {
  if (subscription_) return;
  subscription_ = loop_.subscribe("#", [this](const EventView& event) {
    const auto found = seen_.find(event.origin());
    if (found == seen_.end()) return;  // new since the last time
    Seen& seen = found->second;
    seen.payload.assign(event.payload().begin(), event.payload().end());
    seen.came_at = loop_.now();
    if (seen.events++ == 0) seen.first_came_at = seen.came_at;
    if (seen.period > Duration{0} && event.time() >= seen.first_due)
      seen.now.add((event.time() - seen.first_due) % seen.period);
  });
  subscription_.set_name("status");
}

Status StatusSource::take(std::uint64_t client) {
  clients_.insert(client);
  watch();
  Status status = status_of(loop_.runtime(), info_.sink_paths);
  status.instance = {info_.name, ::getpid(), to_iso8601(started_), loop_.now() - started_at_, info_.configuration};
  add_seen(status);
  add_machines(status);
  for (const Info::Part& part : info_.parts) {
    Status::Part& one = status.parts.emplace_back(part);
    if (part.bus == nullptr) continue;
    for (const auto& [place, counts] : part.bus->place_counts())
      one.places.push_back(
          {place, counts.transfers, counts.failed, counts.retried, counts.busy, counts.longest, counts.skipped_bytes});
  }
  add_callbacks(status);
  return status;
}

MonotonicTime StatusSource::last_reading(Seen& seen, std::uint64_t readings, MonotonicTime taken) const {
  const bool is_each_an_event = readings - std::exchange(seen.readings_taken, readings) ==
                                seen.events - std::exchange(seen.events_taken, seen.events);
  if (is_each_an_event && seen.came_at > taken) return seen.came_at;
  // Filters held readings back after the last event, or it did not come over from its tier yet.
  const Time time = loop_.time();
  if (seen.period <= Duration{0} || time < seen.first_due) return loop_.now();
  return loop_.now() - (time - seen.first_due) % seen.period;
}

void StatusSource::add_seen(Status& status) {
  constexpr Duration span = std::chrono::milliseconds{900};
  const MonotonicTime now = loop_.now(), taken = std::exchange(taken_, now);
  const bool turns = now - turned_ >= span;
  if (turns) turned_ = now;
  std::map<std::string_view, TimeCounts> of_loops;
  for (Status::Sensor& sensor : status.sensors) {
    const auto [place, is_new] = seen_.try_emplace(sensor.name);
    Seen& seen = place->second;
    if (is_new) seen.readings_before = seen.readings_taken = sensor.readings;
    if (seen.first_due != sensor.first_due || seen.period != sensor.period) seen.now = {}, seen.before.reset();
    seen.first_due = sensor.first_due;
    seen.period = sensor.period;
    if (turns) {
      seen.before = seen.now.total() > 0 ? std::optional(std::move(seen.now)) : std::nullopt;
      seen.now = {};
    }
    if (const TimeCounts& late = seen.before ? *seen.before : seen.now; late.total() > 0) {
      sensor.lateness = lateness_of(late);
      of_loops[sensor.loop].add(late);
    }
    if (seen.events > 0 && !std::exchange(seen.has_begun, true) &&
        sensor.readings - seen.readings_before == seen.events)  // each reading was an event
      seen.pace.begin(seen.readings_before + 1, seen.first_came_at);
    seen.pace.add(sensor.readings, last_reading(seen, sensor.readings, taken));
    constexpr Duration unknown_period = std::chrono::milliseconds{2500};
    sensor.reached_hz = seen.pace.per_second(
        now, seen.period > Duration{0} || seen.events == 0 ? seen.period : unknown_period);
    const auto kept = changes_.find(sensor.name);
    sensor.payload = kept != changes_.end() ? kept->second : seen.payload;
    if (kept != changes_.end() && sensor.description != nullptr) show_change(sensor);
  }
  for (Status::Loop& loop : status.loops) {
    Pace& load = loads_[loop.name];
    load.add(static_cast<std::uint64_t>(loop.processor_time.count()), now);
    if (const auto ns = load.per_second(now)) loop.load_percent = *ns / 1e7;
    if (const auto late = of_loops.find(loop.name); late != of_loops.end()) loop.lateness = lateness_of(late->second);
  }
}

void StatusSource::add_machines(Status& status) const {
  if (info_.made == nullptr) return;
  for (Status::Sensor& sensor : status.sensors) {
    const auto* machine = info_.made->find<fsm::ConfiguredMachine>("machine", sensor.name);
    if (machine == nullptr) continue;
    const auto [state, since] = machine->now();
    sensor.state = std::string(state);
    sensor.in_state = std::max(loop_.now() - since, Duration{0});
    const auto tenths = std::chrono::floor<std::chrono::duration<std::int64_t, std::deci>>(*sensor.in_state);
    sensor.value = *sensor.state + " for " + to_string(Duration{tenths});
  }
}

void StatusSource::add_callbacks(Status& status) {
  const auto add = [&](const std::vector<CallbackStatus>& all, const std::string& loop) {
    for (const CallbackStatus& one : all)
      if (one.times.count > 0)
        status.callbacks.push_back({one.name, loop, one.times.count, one.times.total, one.times.max});
  };
  add(loop_.callbacks(), loop_.config().name);
  std::vector<AskedTier> asked;
  for (detail::TierCore* tier : loop_.core().runtime.tiers) {
    if (!tier->is_running()) continue;
    const auto known = std::find_if(tiers_.begin(), tiers_.end(),
                                    [&](const AskedTier& one) { return one.name == tier->config.name; });
    AskedTier& one = asked.emplace_back(known == tiers_.end() ? AskedTier{tier->config.name, {}, {}} : *known);
    if (one.asked != nullptr && one.asked->is_done()) one.answered = std::move(one.asked);
    if (one.asked == nullptr) one.asked = tier->loop.core().nodes.begin_survey();  // one request at a time
    if (one.answered != nullptr) add(one.answered->callbacks(), one.name);
    const auto shown = std::find_if(status.loops.begin(), status.loops.end(),
                                    [&](const Status::Loop& loop) { return loop.name == one.name; });
    if (tier->is_stuck() && shown != status.loops.end()) shown->hangs_in = tier->where();
  }
  tiers_ = std::move(asked);
  std::sort(status.callbacks.begin(), status.callbacks.end(),
            [](const Status::Callback& a, const Status::Callback& b) { return a.total > b.total; });
  status.callbacks.resize(std::min(status.callbacks.size(), most_callbacks));
}

}  // namespace rtdata::app
