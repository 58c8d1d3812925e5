#include "rtdata/loop/loop.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "data/rounded_time.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata {
namespace {

using Reads = std::vector<std::pair<Duration, Duration>>;  // phase, and how long it holds the loop

std::string percent(double share) { return std::to_string(std::llround(100 * share)) + " %"; }

std::string counted(std::size_t count) { return std::to_string(count) + (count == 1 ? " sensor" : " sensors"); }

std::string rounded(Duration duration) { return detail::rounded_time(static_cast<double>(duration.count())); }

/// The largest sum of reads due within `window`, for reads that repeat every `period` (longer than `window`).
Duration worst_of(Reads reads, Duration period, Duration window) {
  std::sort(reads.begin(), reads.end());
  const std::size_t count = reads.size();
  Duration sum{0}, worst{0};
  for (std::size_t first = 0, end = 0; first < count; ++first) {
    const auto due = [&](std::size_t i) { return reads[i % count].first + (i < count ? Duration{0} : period); };
    for (; end < first + count && due(end) < reads[first].first + window; ++end) sum += reads[end % count].second;
    worst = std::max(worst, sum);
    sum -= reads[first].second;
  }
  return worst;
}

constexpr const char* says_nothing = "whose types do not say how long a reading takes";

}  // namespace

bool LaneLoad::is_overloaded() const noexcept { return share > LoopLoad::most; }

std::string LaneLoad::text() const {
  std::string text = "lane " + lane + ": " + counted(sensors) + ", ";
  if (declared == 0) return text + "read times not known";
  text += percent(share);
  if (declared != sensors) text += " (" + std::to_string(declared) + " of " + std::to_string(sensors) + " declared)";
  return text;
}

double LoopLoad::share() const noexcept {
  return period.count() > 0 ? static_cast<double>(worst.count()) / static_cast<double>(period.count()) : 0;
}

std::string LoopLoad::text() const {
  std::string text = loop + ": " + counted(sensors) + ", ";
  if (declared == 0)
    return text + says_nothing + (period.count() > 0 ? "; the shortest period is " + rounded(period) : "");
  text += "worst " + rounded(worst);
  if (period.count() > 0) text += " of " + rounded(period) + ", " + percent(share());
  if (declared != sensors) text += " (" + std::to_string(declared) + " of " + std::to_string(sensors) + " declared)";
  return text;
}

LoopLoad estimate_load(std::string loop, std::span<const SensorLoad> sensors) {
  LoopLoad load;
  load.loop = std::move(loop);
  load.sensors = sensors.size();
  std::map<Duration, Reads> by_period;
  std::map<std::string, LaneLoad> lanes;
  double on_lanes = 0;  // share of the time that their readings hold the loop
  for (const SensorLoad& sensor : sensors) {
    const bool has_schedule = sensor.period.count() > 0;
    if (has_schedule && (load.period.count() == 0 || sensor.period < load.period)) load.period = sensor.period;
    if (has_schedule && !sensor.time.lane.empty()) {
      LaneLoad& lane = lanes[sensor.time.lane];
      ++lane.sensors;
      if (sensor.time.on_lane) {
        ++lane.declared;
        lane.share += static_cast<double>(sensor.time.on_lane->count()) / static_cast<double>(sensor.period.count());
      }
    }
    if (!sensor.time.on_loop) continue;
    ++load.declared;
    const Duration held = *sensor.time.on_loop;
    if (has_schedule) load.busy += static_cast<double>(held.count()) / static_cast<double>(sensor.period.count());
    if (has_schedule && !sensor.time.lane.empty()) {
      on_lanes += static_cast<double>(held.count()) / static_cast<double>(sensor.period.count());
    } else if (has_schedule && sensor.phase) {
      const Duration phase = (*sensor.phase % sensor.period + sensor.period) % sensor.period;
      by_period[sensor.period].emplace_back(phase, *sensor.time.on_loop);
    } else {
      load.worst += *sensor.time.on_loop;
    }
  }
  for (auto& [period, reads] : by_period) load.worst += worst_of(std::move(reads), period, load.period);
  load.worst += Duration{std::llround(on_lanes * static_cast<double>(load.period.count()))};
  for (auto& [key, lane] : lanes) {
    lane.lane = key;
    load.lanes.push_back(std::move(lane));
  }
  return load;
}

LoopLoad Loop::load() const {
  std::vector<SensorLoad> loads;
  for (const detail::SensorEntry* sensor : core_->runtime.sensors.all()) {
    if (sensor->loop() != core_.get()) continue;
    if (auto load = sensor->load()) loads.push_back(std::move(*load));
  }
  return estimate_load(core_->config.name, loads);
}

}  // namespace rtdata
