#include "app/run/growth.hpp"

#include <sys/stat.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <filesystem>
#include <map>

namespace rtdata::app {
namespace {

constexpr double seconds_per_day = 86400;

/// Bytes of a value as text, without quotes and separators.
double text_size(const Leaf& leaf) {
  switch (leaf.kind) {
    case Kind::boolean:
      return 5;
    case Kind::character:
      return 1;
    case Kind::i8:
    case Kind::u8:
      return 3;
    case Kind::i16:
    case Kind::u16:
      return 4;
    case Kind::i32:
    case Kind::u32:
      return 6;
    case Kind::text:
      return 2 + static_cast<double>(leaf.size) / 2;
    case Kind::enumeration:
      return 8;
    case Kind::f64:
      return 12;
    case Kind::f32:
    case Kind::i64:
    case Kind::u64:
    case Kind::record:
      break;
  }
  return 9;
}

/// Bytes of a value in a row of SQLite: integers take as many as their value needs.
double column_size(const Leaf& leaf) {
  switch (leaf.kind) {
    case Kind::f32:
    case Kind::f64:
      return 9;
    case Kind::text:
      return 2 + static_cast<double>(leaf.size) / 2;
    case Kind::i64:
    case Kind::u64:
      return 5;
    default:
      return static_cast<double>(std::min<std::size_t>(leaf.size, 3));
  }
}

/// Bytes of one event. The constants are what time, sequence, keys and separators take.
double event_size(const PartPlan& sink, const PartPlan& sensor) {
  const ConfigItem* item = sink.item.find("format");
  const std::string* given = item != nullptr ? item->as_string() : nullptr;
  const std::string format = sink.type == "sqlite" ? "sqlite" : given != nullptr ? *given : "jsonl";
  double size = static_cast<double>(sensor.name.size());
  size += format == "sqlite" ? 24 : format == "csv" ? 28 : format == "raw" ? 36 : 64;
  if (format == "json" || format == "jsonl") size += static_cast<double>(sensor.publishes->topic.size());
  for (const Leaf& leaf : sensor.publishes->description->leaves()) {
    if (format == "sqlite") {
      size += column_size(leaf);
    } else if (format == "csv") {
      size += text_size(leaf) + 1;
    } else if (format == "raw") {
      size += static_cast<double>(leaf.size);
    } else {
      size += text_size(leaf) + static_cast<double>(leaf.path.size()) + 4;
    }
  }
  return size;
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

std::string bytes_text(double bytes) {
  constexpr std::array units{"B", "kB", "MB", "GB", "TB"};
  std::size_t unit = 0;
  for (; bytes >= 999.5 && unit + 1 < units.size(); ++unit) bytes /= 1000;
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), bytes < 9.95 && unit > 0 ? "%.1f %s" : "%.0f %s", bytes, units[unit]);
  return text.data();
}

std::string Growth::text() const {
  return sink->name + ": about " + bytes_text(bytes_per_day) + " a day, " +
         (is_limited ? "up to its limit" : "without limit");
}

std::vector<Growth> growth_of(const SystemPlan& plan) {
  std::vector<Growth> all;
  std::vector<const PartPlan*> publishing, storing;
  for (const PartPlan& part : plan.parts) {
    if (part.publishes) publishing.push_back(&part);
    if (part.stores) storing.push_back(&part);
  }
  for (const PartPlan* sink : storing) {
    if (sink->type != "sqlite" && sink->type != "file") continue;
    Growth growth{sink, 0, is_limited(*sink)};
    for (const PartPlan* sensor : publishing) {
      const PublishedTopic& published = *sensor->publishes;
      if (published.description == nullptr || !published.load || published.load->period <= Duration{0}) continue;
      if (!sink->stores->wants(published.topic)) continue;
      const double period = std::chrono::duration<double>(published.load->period).count();
      growth.bytes_per_day += event_size(*sink, *sensor) / period * seconds_per_day;
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
    const ConfigItem* path = sink.item.find("path");
    std::array<char, 32> time{};
    if (hours >= 48) {
      std::snprintf(time.data(), time.size(), "%.0f days", hours / 24);
    } else if (hours >= 2) {
      std::snprintf(time.data(), time.size(), "%.0f hours", hours);
    } else {
      std::snprintf(time.data(), time.size(), "%.0f minutes", hours * 60);
    }
    plan.warnings.add(
        (path != nullptr ? *path : sink.item)
            .problem("fills-disk", "it grows by about " + bytes_text(growth.bytes_per_day) +
                                       " a day, without limit, and the disk, with " + bytes_text(fill.free_bytes) +
                                       " free, is full after " + time.data() + "; lower the rates, or set " +
                                       (sink.type == "sqlite" ? "`max_bytes` or `max_age`" : "`rotate` and `keep`")));
  }
}

}  // namespace rtdata::app
