#include "app/run/growth.hpp"

#include <sys/stat.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <filesystem>
#include <map>

#include "app/core/amounts.hpp"
#include "config/read/mistakes.hpp"

namespace rtdata::app {
namespace {

constexpr double seconds_per_day = 86400;

/// For a row in any format: nearly right for numbers in a recording; text takes up to four times that.
constexpr double bytes_a_field = 9;

/// The rate of reads, or of the device's own samples; 0: unknown.
double events_per_second(const PublishedTopic& published) {
  if (published.sampling.hertz > 0) return published.sampling.hertz;
  if (!published.load || published.load->period <= Duration{0}) return 0;
  return 1 / std::chrono::duration<double>(published.load->period).count();
}

bool is_set(const ConfigItem& item, const char* key) {
  const ConfigItem* value = item.find(key);
  if (value == nullptr || value->is_null()) return false;
  if (const std::int64_t* number = value->as_signed()) return *number > 0;
  if (const double* number = value->as_number()) return *number > 0;
  if (const std::string* text = value->as_string()) {
    const auto span = parse_duration(*text);
    return span && *span > Duration{0};
  }
  return true;
}

bool is_limited(const PartPlan& sink) {
  if (sink.type == "sqlite") return is_set(sink.item, "max_bytes") || is_set(sink.item, "max_age");
  return is_set(sink.item, "rotate") && is_set(sink.item, "keep");
}

}  // namespace

std::string Growth::text() const {
  return sink->name + ": about " + bytes_text(bytes_per_day) + " a day, " +
         (is_limited ? "up to its limit" : "without limit");
}

std::vector<Growth> growth_of(const SystemPlan& plan) {
  std::vector<Growth> all;
  for (const PartPlan* sink : plan.of_kind("sink")) {
    if (sink->type != "sqlite" && sink->type != "file") continue;
    Growth growth{sink, 0, is_limited(*sink)};
    for (const PartPlan& part : plan.parts) {
      if (!part.publishes) continue;
      const PublishedTopic& published = *part.publishes;
      const double events = events_per_second(published);
      if (published.description == nullptr || events <= 0 || !sink->stores->wants(published.topic)) continue;
      const auto fields = static_cast<double>(published.description->leaves().size());
      growth.bytes_per_day += fields * bytes_a_field * events * seconds_per_day;
    }
    if (growth.bytes_per_day > 0) all.push_back(growth);
  }
  return all;
}

std::optional<Disk> disk_of(const std::string& path) {
  const std::filesystem::path parent = std::filesystem::path(path).parent_path();
  const std::string folder = parent.empty() ? "." : parent.string();
  struct stat status {};
  std::error_code failed;
  const auto space = std::filesystem::space(folder, failed);
  if (failed || ::stat(folder.c_str(), &status) != 0) return std::nullopt;
  return Disk{status.st_dev, space.available};
}

void warn_of_growth(SystemPlan& plan, Duration span,
                    const std::function<std::optional<Disk>(const std::string&)>& disk) {
  struct Fill {
    double bytes_per_day = 0;
    double free_bytes = 0;
  };
  std::map<std::uint64_t, Fill> fills;
  std::vector<std::pair<Growth, std::uint64_t>> unlimited;
  for (const Growth& growth : growth_of(plan)) {
    if (growth.is_limited) continue;
    const std::optional<Disk> on = disk(growth.sink->stores->path);
    if (!on) continue;
    unlimited.emplace_back(growth, on->device);
    fills[on->device].bytes_per_day += growth.bytes_per_day;
    fills[on->device].free_bytes = static_cast<double>(on->free_bytes);
  }
  for (const auto& [growth, device] : unlimited) {
    const Fill& fill = fills[device];
    const double hours = fill.free_bytes / fill.bytes_per_day * 24;
    if (hours >= std::chrono::duration<double, std::ratio<3600>>(span).count()) continue;
    const PartPlan& sink = *growth.sink;
    std::array<char, 32> time{};
    if (hours >= 48) {
      std::snprintf(time.data(), time.size(), "%.0f days", hours / 24);
    } else if (hours >= 2) {
      std::snprintf(time.data(), time.size(), "%.0f hours", hours);
    } else {
      std::snprintf(time.data(), time.size(), "%.0f minutes", hours * 60);
    }
    plan.warnings.add(
        config_detail::child_or_self(sink.item, "path")
            .problem("fills-disk", "this file grows by about " + bytes_text(growth.bytes_per_day) +
                                       " a day, without limit, and the disk, with " + bytes_text(fill.free_bytes) +
                                       " free, is full after " + time.data() + "; lower the rates, or set " +
                                       (sink.type == "sqlite" ? "`max_bytes` or `max_age`" : "`rotate` and `keep`")));
  }
}

}  // namespace rtdata::app
