#include "loop/runtime/final_account.hpp"

#include <algorithm>
#include <set>
#include <string_view>
#include <vector>

#include "data/fitting.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/loop/ledger.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::detail {

std::vector<SensorStatus> closed_sensors(const RuntimeCore& runtime, const std::vector<SensorStatus>& open) {
  std::set<std::string_view> known;
  for (const SensorStatus& sensor : open) known.insert(sensor.name);
  std::vector<SensorStatus> all;
  for (const OriginCore& origin : runtime.origins()) {
    const bool has_account = origin.sequence > 0 || origin.counts.scheduled > 0 || origin.counts.received > 0 ||
                             origin.had_outage();
    const bool is_sensors = !origin.name.starts_with("program:") && !origin.topic.name.starts_with('$');
    if (origin.is_claimed || !has_account || !is_sensors || known.contains(origin.name)) continue;
    SensorStatus& closed = all.emplace_back();
    closed.name = origin.name;
    closed.topic = origin.topic.name;
    closed.counts = origin.counts;
    closed.outages = origin.ended_outages();
  }
  std::sort(all.begin(), all.end(), [](const SensorStatus& a, const SensorStatus& b) { return a.name < b.name; });
  return all;
}

void publish_final_account(LoopCore& loop) noexcept try {
  RuntimeCore& runtime = loop.runtime;
  const bool is_wanted = runtime.find_topic(account_topic) != nullptr ||
                         std::any_of(runtime.recorders.begin(), runtime.recorders.end(),
                                     [](const Recorder* recorder) { return recorder->wants(account_topic); });
  if (!is_wanted) return;
  std::vector<FinalCounts> accounts;
  const auto add = [&](std::string_view name, std::string_view of_topic, const SensorCounts& counts) {
    if (of_topic == account_topic) return;
    FinalCounts& account = accounts.emplace_back();
    account.name = fitting<200>(name);
    account.topic = fitting<200>(of_topic);
    account.published = counts.published;
    account.late = counts.late;
    account.missed = counts.missed;
    account.failed = counts.failed;
    account.unreadable = counts.unreadable;
    account.lost = counts.lost;
    account.lost_is_known = counts.lost_is_known;
  };
  const std::vector<SensorStatus> open = runtime.face.sensors();
  for (const SensorStatus& sensor : open) add(sensor.name, sensor.topic, sensor.counts);
  // Includes sensors removed before the end.
  for (const SensorStatus& sensor : closed_sensors(runtime, open)) add(sensor.name, sensor.topic, sensor.counts);
  TopicCore& topic = runtime.topic(account_topic, payload_type<FinalCounts>());
  for (const FinalCounts& account : accounts) publish_from_program(topic, &account);
  loop.deliver_all();
} catch (...) {  // no memory, or the program uses the name for another topic
}

}  // namespace rtdata::detail
