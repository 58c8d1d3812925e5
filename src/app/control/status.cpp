#include "app/control/status.hpp"

#include <algorithm>
#include <bit>

#include "loop/core/callback_survey.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/tier/tier_core.hpp"
#include "rtdata/fsm/configured.hpp"
#include "rtdata/outputs/output.hpp"

namespace rtdata::app {

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
    const std::size_t next = i + 1;  // its smallest is the first that is above
    const std::uint64_t end = next < 8 ? next : (8 + (next & 7)) << (next / 8 - 1);
    return std::min(largest_, Duration{static_cast<Duration::rep>(end)});
  }
  return largest_;
}

StatusSource::StatusSource(Loop& loop, Info info)
    : loop_(loop),
      info_(std::make_shared<const Info>(std::move(info))),
      started_(loop.time()),
      started_at_(loop.now()) {
  keep_changes();
}

void StatusSource::set(Info info) {
  info_ = std::make_shared<const Info>(std::move(info));
  keep_changes();
}

void StatusSource::keep_changes() {
  change_subscriptions_.clear();
  for (const std::string& topic : info_->changes) {
    change_subscriptions_.push_back(loop_.subscribe(topic, [this](const EventView& event) {
      auto kept = changes_.find(event.origin());
      if (kept == changes_.end()) kept = changes_.emplace(event.origin(), std::vector<std::byte>{}).first;
      kept->second.assign(event.payload().begin(), event.payload().end());
    }));
    change_subscriptions_.back().set_name("status");
  }
}

std::function<std::string()> StatusSource::answer(std::uint64_t client, std::string_view line) {
  if (auto why = refusal_of(line)) return [text = *std::move(why)] { return text; };
  auto& last = clients_[client];
  const auto before = std::exchange(last, take());
  return [now = last, before] { return text(*now, before.get()); };
}

void StatusSource::forget(std::uint64_t client) {
  clients_.erase(client);
  if (!clients_.empty()) return;
  subscription_.close();
  seen_.clear();
}

void StatusSource::begin_watching() {
  if (subscription_) return;
  subscription_ = loop_.subscribe("#", [this](const EventView& event) {
    const auto found = seen_.find(event.origin());
    if (found == seen_.end()) return;  // made since the last request
    Seen& seen = found->second;
    seen.payload.assign(event.payload().begin(), event.payload().end());
    if (seen.period > Duration{0} && event.time() >= seen.first_due) {
      seen.now.add((event.time() - seen.first_due) % seen.period);
    }
  });
  subscription_.set_name("status");
}

void StatusSource::take_schedules(const std::vector<SensorStatus>& sensors) {
  constexpr Duration span = std::chrono::milliseconds{900};
  const MonotonicTime now = loop_.now();
  const bool turns = now - turned_ >= span;
  if (turns) turned_ = now;
  for (const SensorStatus& sensor : sensors) {
    Seen& seen = seen_[sensor.name];
    const Duration period = sensor.running && sensor.counts.has_schedule ? sensor.period : Duration{0};
    if (seen.first_due != sensor.first_due || seen.period != period) {
      seen.now = {};
      seen.before = nullptr;
    }
    seen.first_due = sensor.first_due;
    seen.period = period;
    if (!turns) continue;
    seen.before = seen.now.total() > 0 ? std::make_shared<const TimeCounts>(std::move(seen.now)) : nullptr;
    seen.now = {};
  }
}

std::shared_ptr<const StatusSource::Snapshot> StatusSource::take() {
  begin_watching();
  auto shot = std::make_shared<Snapshot>();
  const Runtime& runtime = loop_.runtime();
  shot->info = info_;
  for (const Info::Part& part : info_->parts)
    shot->places.push_back(part.bus != nullptr ? part.bus->place_counts() : std::vector<PlaceCounts>{});
  shot->started = started_;
  shot->at = loop_.now();
  shot->running_for = shot->at - started_at_;
  shot->sensors = runtime.sensors();
  take_schedules(shot->sensors);
  shot->seen.reserve(shot->sensors.size());
  for (const SensorStatus& sensor : shot->sensors) {
    const Seen& seen = seen_[sensor.name];
    auto lateness = seen.before;
    if (lateness == nullptr && seen.now.total() > 0) lateness = std::make_shared<const TimeCounts>(seen.now);
    const auto kept = changes_.find(sensor.name);
    const bool is_kept = seen.payload.empty() && kept != changes_.end();
    shot->seen.push_back({is_kept ? kept->second : seen.payload, std::move(lateness)});
  }
  shot->loops = runtime.loops();
  shot->sinks = runtime.sinks();
  const detail::RuntimeCore& core = loop_.core().runtime;
  for (const detail::ClosedSink& closed : core.closed_sinks) {
    std::optional<std::string>& path = shot->closed_paths.emplace_back();
    if (closed.path) path = core.hide(*closed.path);
  }
  shot->topics = runtime.topics();
  if (info_->made != nullptr) {
    for (const std::string& name : info_->made->names("machine")) {
      const auto* machine = info_->made->find<fsm::ConfiguredMachine>("machine", name);
      if (machine == nullptr) continue;
      const auto [state, since] = machine->now();
      shot->machines[name] = {std::string(state), std::max(shot->at - since, Duration{0})};
    }
  }
  shot->callbacks = loop_.callbacks();
  shot->callbacks_loop = loop_.config().name;
  ask_tiers(*shot);
  return shot;
}

void StatusSource::ask_tiers(Snapshot& shot) {
  const auto& running = loop_.core().runtime.tiers;
  std::erase_if(tiers_, [&](const AskedTier& known) {
    return std::none_of(running.begin(), running.end(),
                        [&](const auto* tier) { return tier->config.name == known.name; });
  });
  for (detail::TierCore* tier : running) {
    if (!tier->is_running()) continue;
    auto known = std::find_if(tiers_.begin(), tiers_.end(),
                              [&](const AskedTier& one) { return one.name == tier->config.name; });
    if (known == tiers_.end()) known = tiers_.insert(tiers_.end(), AskedTier{tier->config.name, {}, {}, {}});
    if (known->asked != nullptr && known->asked->is_done()) known->answered = std::move(known->asked);
    if (known->asked == nullptr)
      known->asked = tier->loop.core().nodes.begin_survey();  // else it hangs: one question is enough
    known->doing = tier->where();
    shot.tiers.push_back(*known);
  }
}

}  // namespace rtdata::app
