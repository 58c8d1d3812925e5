#include "app/run/data_at_risk.hpp"

#include <algorithm>
#include <array>
#include <cstdio>

#include "app/core/amounts.hpp"
#include "config/read/mistakes.hpp"
#include "data/listed.hpp"

namespace rtdata::app {
namespace {

using config_detail::child_or_self;
using config_detail::text_or_empty;

/// True if it has a parameter `silence` that is not set.
bool may_go_quiet(const PartPlan& part, const std::vector<ParameterInfo>& parameters) {
  const auto silence = std::find_if(parameters.begin(), parameters.end(),
                                    [](const ParameterInfo& parameter) { return parameter.key == "silence"; });
  if (silence == parameters.end()) return false;
  const std::string given = text_or_empty(part.item, "silence");
  const auto span = parse_duration(given.empty() ? silence->default_text() : given);
  return !span || *span <= Duration{0};
}

/// Warns of units that with RTU no device, or few devices, have. Buses and sensors of other types do not have the key.
void warn_of_units(SystemPlan& plan) {
  for (const PartPlan& part : plan.parts) {
    if (part.kind != "sensor" || part.type != "modbus") continue;
    const ConfigItem* const unit = part.item.find("unit");
    const auto bus = std::find_if(plan.parts.begin(), plan.parts.end(), [&](const PartPlan& other) {
      return other.kind == "bus" && other.name == part.place.bus;
    });
    if (unit == nullptr || bus == plan.parts.end()) continue;
    const ConfigItem* const over_tcp = bus->item.find("rtu_over_tcp");
    const bool is_rtu = bus->item.find("device") != nullptr || (over_tcp != nullptr && over_tcp->to_json() == "true");
    const std::string number = unit->to_json();
    const bool is_reserved = number.size() == 3 && number >= "248";
    if (is_rtu && (number == "0" || is_reserved))
      plan.warnings.add(unit->problem(
          "unlikely-address", number == "0" ? "with RTU, unit 0 addresses all devices, and none of them answers; "
                                              "devices have 1 to 247"
                                            : "with RTU, the units 248 to 255 are reserved: devices have 1 to 247"));
  }
}

}  // namespace

std::string unnoticed_silence(const Registry& registry, const SystemPlan& plan) {
  std::vector<std::string> names;
  for (const PartPlan* part : plan.of_kind("sensor")) {
    for (const PartKind& kind : registry.kinds()) {
      if (kind.name != part->kind) continue;
      const auto type = kind.types.find(part->type);
      if (type && may_go_quiet(*part, type->parameters)) names.push_back(part->name);
    }
  }
  if (names.empty()) return "";
  return "without `silence`, such as \"10 s\", no report is made when " +
         std::string(names.size() == 1 ? "this device goes" : "these devices go") + " quiet: " + detail::listed(names);
}

std::vector<std::string> latencies(const SystemPlan& plan) {
  std::vector<std::string> lines;
  for (const PartPlan* recording : plan.of_kind("sink")) {
    if (!recording->stores || !recording->stores->is_recording) continue;
    Duration time = recording->stores->batch_time;
    std::string followers, because;
    for (const PartPlan* sink : plan.of_kind("sink")) {
      if (!sink->stores || sink->stores->through != recording->name) continue;
      followers += (followers.empty() ? "" : ", ") + sink->name;
      if (sink->stores->batch_time >= time) continue;
      time = sink->stores->batch_time;
      because = sink->name;
    }
    if (followers.empty()) continue;
    lines.push_back(recording->name + ": commits within " + to_string(time) + ", by `batch_time` of " +
                    (because.empty() ? "its own" : because) + "; what goes through it: " + followers);
  }
  return lines;
}

std::string only_in_memory(const SystemPlan& plan) {
  std::string names;
  for (const PartPlan* sink : plan.of_kind("sink")) {
    if (!sink->stores || !sink->stores->is_sender || !sink->stores->through.empty()) continue;
    names += (names.empty() ? "" : ", ") + sink->name + " (" +
             bytes_text(static_cast<double>(sink->stores->queue_bytes)) + ")";
  }
  if (names.empty()) return names;
  return "events for " + names +
         " wait in memory only: while the peer is away, events are dropped when the queue is full, and the rest is "
         "lost at the "
         "end of the program; with `through` they wait in a recording";
}

void warn_of_losses(SystemPlan& plan) {
  warn_of_units(plan);
  for (const PartPlan& part : plan.parts) {
    if (part.stores && part.stores->is_recording && part.stores->close_deadline <= Duration{0}) {
      plan.warnings.add(child_or_self(part.item, "close_deadline")
                            .problem("loses-data",
                                     "the end of the run does not wait until the last events are stored: those that "
                                     "came within its `batch_time`, " +
                                         to_string(part.stores->batch_time) +
                                         ", are lost; give it some seconds, or remove `close_deadline`"));
    }
    if (!part.publishes || !part.publishes->load || part.publishes->load->period <= Duration{0}) continue;
    const Sampling& sampling = part.publishes->sampling;
    const Duration period = part.publishes->load->period;
    const ConfigItem& at = child_or_self(part.item, "rate");
    const double a_read = sampling.hertz * std::chrono::duration<double>(period).count();
    if (sampling.kept > 0 && a_read > static_cast<double>(sampling.kept)) {
      std::array<char, 32> needed{};
      std::snprintf(needed.data(), needed.size(), "%.3g Hz", 2 * sampling.hertz / static_cast<double>(sampling.kept));
      plan.warnings.add(
          at.problem("loses-data", "the chip takes " + std::to_string(static_cast<std::uint64_t>(a_read)) +
                                       " samples between two reads and keeps " + std::to_string(sampling.kept) +
                                       ": the others are lost; give it a `rate` of " + needed.data() +
                                       " or more, or a lower `sample_rate`"));
    }
    if (sampling.reading_time > period)
      plan.warnings.add(at.problem("loses-data", "a reading takes " + to_string(sampling.reading_time) +
                                                     " or more, and its period is " + to_string(period) +
                                                     ": ticks are missed; lower its `rate`"));
  }
}

}  // namespace rtdata::app
