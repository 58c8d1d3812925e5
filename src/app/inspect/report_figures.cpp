#include "app/inspect/report_figures.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "recording/account_text.hpp"

namespace rtdata::app {

double coverage_of(const Curve& curve, const LedgerEntry& account, Duration outages, Duration run) {
  std::uint64_t events = 0, numbers = 0;
  for (const CurveStep& step : curve.steps) {
    events += step.events;
    numbers += step.numbers;
  }
  const SensorCounts& sensor = account.sensor;
  const std::uint64_t stored = std::max(events, account.stored), covered = stored + sensor.filtered;
  // Failed ticks are counted below.
  const std::uint64_t lost = account.dropped() + sensor.unreadable - detail::failed_unreadable(sensor) + sensor.lost;
  double share = stored == 0 ? 0 : static_cast<double>(numbers) / static_cast<double>(stored);
  if (lost != 0) share *= static_cast<double>(covered) / static_cast<double>(covered + lost);
  if (sensor.has_schedule && sensor.scheduled != 0)
    share *= 1 - static_cast<double>(sensor.missed + sensor.failed) / static_cast<double>(sensor.scheduled);
  if (outages > Duration{0})
    share *= std::max(0.0, 1 - static_cast<double>(outages.count()) / static_cast<double>(run.count()));
  return share;
}

std::optional<Duration> clock_error(const RunInfo& run, const std::vector<RecordedClock>& clock, Duration length) {
  constexpr double ns_a_ns = 1e-6;
  std::vector<std::pair<double, double>> known;  // instant and error, ns
  for (const RecordedClock& pair : clock)
    if (pair.accuracy)
      known.emplace_back(static_cast<double>(pair.monotonic.time_since_epoch().count()),
                         static_cast<double>(pair.accuracy->count()));
  if (known.empty()) return std::nullopt;
  std::sort(known.begin(), known.end());
  const auto grown = [&](std::size_t a, std::size_t b) { return std::abs(known[a].first - known[b].first) * ns_a_ns; };
  for (std::size_t i = 1; i < known.size(); ++i)
    known[i].second = std::min(known[i].second, known[i - 1].second + grown(i, i - 1));
  for (std::size_t i = known.size() - 1; i > 0; --i)
    known[i - 1].second = std::min(known[i - 1].second, known[i].second + grown(i, i - 1));
  const double start = static_cast<double>((run.started - run.clock_offset).time_since_epoch().count());
  const double end = start + static_cast<double>(length.count());
  double worst = known.front().second + std::max(known.front().first - start, 0.0) * ns_a_ns;
  worst = std::max(worst, known.back().second + std::max(end - known.back().first, 0.0) * ns_a_ns);
  for (std::size_t i = 1; i < known.size(); ++i)
    worst = std::max(worst, (known[i - 1].second + known[i].second + grown(i, i - 1)) / 2);
  return Duration{static_cast<std::int64_t>(std::ceil(worst))};
}

}  // namespace rtdata::app
