#include "rtdata/loop/runtime.hpp"

#include <pthread.h>
#include <time.h>

#include <algorithm>
#include <utility>

#include "data/name_in.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/tier/bridge.hpp"
#include "loop/tier/tier_core.hpp"

namespace rtdata {

std::string_view name_of(Health health) noexcept {
  constexpr std::string_view names[] = {"ok", "degraded", "faulted"};
  return detail::name_in(names, health);
}

Runtime::Runtime() : Runtime(Config{}) {}
Runtime::Runtime(Config config) : core_(std::make_unique<detail::RuntimeCore>(*this, std::move(config))) {}
Runtime::~Runtime() = default;

const Runtime::Config& Runtime::config() const noexcept { return core_->config; }
void Runtime::on_log(Callback<void(const LogRecord&)> handler) {
  if (core_->own_loop != nullptr) {
    core_->own_loop->check_thread("cannot set on_log", "runtime");
    core_->own_loop->check_not_ending("cannot set on_log");
  }
  core_->reports.on_log.set(std::move(handler));
}

Result<void> Runtime::note_wall_clock(const ClockPair& pair) {
  if (core_->own_loop != nullptr && core_->own_loop->is_run_by_another_thread()) {
    return Error{Errc::busy, "cannot note the time of day", "source \"" + pair.source + "\"",
                 "its loop runs on another thread, or this is a call on a lane",
                 "post a function to the loop that does it there"};
  }
  return core_->clock_log.note_wall_clock(pair);
}

void Runtime::note_place(std::string object, std::string place) {
  if (core_->own_loop != nullptr) core_->own_loop->check_thread("cannot note a place", object);
  core_->reports.places[std::move(object)] = std::move(place);
}

std::vector<SensorStatus> Runtime::sensors() const {
  std::vector<SensorStatus> all;
  for (const auto* sensor : core_->sensors.all()) all.push_back(detail::status_of(*sensor));
  for (const auto* bridge : core_->inbound) bridge->receiving.add_statuses(all);
  return all;
}

std::vector<SinkStatus> Runtime::sinks() const {
  std::vector<SinkStatus> all(core_->closed_sinks.begin(), core_->closed_sinks.end());
  for (const auto* recorder : core_->recorders) all.push_back(recorder->status());
  return all;
}

std::vector<TopicStatus> Runtime::topics() const {
  std::vector<TopicStatus> all;
  for (const auto& topic : core_->topics()) {
    std::uint64_t published = 0;
    for (const auto* origin : topic->origins()) published += origin->sequence;
    all.push_back({topic->name, topic->type.description, published, topic->subscription_counts()});
  }
  return all;
}

std::vector<LoopStatus> Runtime::loops() const {
  const auto processor_time = [](pthread_t thread) {
    clockid_t clock{};
    timespec spent{};
    if (::pthread_getcpuclockid(thread, &clock) != 0 || ::clock_gettime(clock, &spent) != 0) return Duration{0};
    return Duration{std::chrono::seconds{spent.tv_sec} + std::chrono::nanoseconds{spent.tv_nsec}};
  };
  std::vector<LoopStatus> all;
  if (detail::LoopCore* loop = core_->own_loop) {
    all.push_back({loop->config.name,
                   core_->hub != nullptr,
                   loop->is_running(),
                   current_scheduling(),
                   processor_time(::pthread_self()),
                   {},
                   loop->posts.counts()});
  }
  for (detail::TierCore* tier : core_->tiers) {
    all.push_back({tier->config.name, true, tier->is_running(), tier->scheduling,
                   tier->is_running() ? processor_time(tier->native_thread()) : Duration{0}, tier->warnings,
                   tier->loop.core().posts.counts()});
  }
  return all;
}

bool Runtime::balances() const {
  for (const detail::OriginCore& origin : core_->origins()) {
    if (!origin.counts.balances() || (origin.counts.published != origin.sequence && !origin.is_mirror)) return false;
  }
  for (const SinkStatus& sink : sinks()) {
    if (!sink.counts.balances()) return false;
  }
  for (const auto& topic : core_->topics()) {
    if (!topic->subscription_counts().balances()) return false;
  }
  return core_->exchange.tiers_were_balanced &&
         std::all_of(core_->tiers.begin(), core_->tiers.end(), [](detail::TierCore* tier) { return tier->balances(); });
}

bool Runtime::has_loss() const {
  if (core_->exchange.lost > 0) return true;
  for (const detail::OriginCore& origin : core_->origins()) {
    if (origin.counts.has_loss() || origin.had_outage()) return true;
  }
  for (const SinkStatus& sink : sinks()) {
    if (sink.counts.all_dropped() > 0) return true;
  }
  if (core_->hub != nullptr) {
    for (const auto& topic : core_->topics()) {
      if (topic->subscription_counts().dropped > 0) return true;
    }
  }
  return core_->exchange.tiers_had_loss ||
         std::any_of(core_->tiers.begin(), core_->tiers.end(), [](detail::TierCore* tier) { return tier->has_loss(); });
}

}  // namespace rtdata
