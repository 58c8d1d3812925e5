#include "app/run/growth.hpp"

#include <sys/stat.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <filesystem>
#include <map>
#include <memory>

#include "app/core/amounts.hpp"
#include "rtdata/data/codec.hpp"
#include "rtdata/data/value.hpp"

namespace rtdata::app {
namespace {

constexpr double seconds_per_day = 86400;

/// What fields of this kind usually hold, as long as it usually is when it is written as text.
Value typical_value(const Leaf& leaf) {
  switch (leaf.kind) {
    case Kind::boolean:
      return false;
    case Kind::character:
      return 'x';
    case Kind::f64:
      return 21.483271059;
    case Kind::f32:
      return 21.48327;
    case Kind::text:
      return std::string(std::min<std::size_t>((leaf.size - text_length_bytes) / 2, 200), 'x');
    case Kind::enumeration:
      if (!leaf.field->values.empty()) return std::string(leaf.field->values.front().name);
      return std::int64_t{0};
    case Kind::i8:
    case Kind::u8:
      return std::int64_t{100};
    case Kind::i16:
    case Kind::u16:
      return std::int64_t{1000};
    case Kind::i32:
    case Kind::u32:
      return std::int64_t{100'000};
    case Kind::i64:
    case Kind::u64:
    case Kind::record:
      break;
  }
  return std::int64_t{100'000'000};
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

/// Bytes of one event as the format writes it; 0 when it does not take such events.
double event_size(Codec& codec, const PartPlan& sensor) {
  const Description& description = *sensor.publishes->description;
  std::vector<std::byte> payload(description.size());
  for (const Leaf& leaf : description.leaves()) {
    if (!write(leaf, payload.data(), typical_value(leaf))) return 0;
  }
  const EventHeader header{from_nanoseconds(1'800'000'000'000'000'000), 100'000, sensor.name};
  std::vector<std::byte> bytes;
  if (!codec.encode(EventView(sensor.publishes->topic, header, description, payload), bytes)) return 0;
  return static_cast<double>(bytes.size());
}

/// Bytes of one row of SQLite.
double row_size(const PartPlan& sensor) {
  double size = static_cast<double>(sensor.name.size()) + 24;  // with time, sequence and the row's own header
  for (const Leaf& leaf : sensor.publishes->description->leaves()) size += column_size(leaf);
  return size;
}

/// The format of a file sink; null when there is none of its name.
std::unique_ptr<Codec> codec_of(const PartPlan& sink) {
  const ConfigItem* item = sink.item.find("format");
  const std::string* given = item != nullptr ? item->as_string() : nullptr;
  auto codec = CodecRegistry::standard().make(given == nullptr || *given == "jsonl" ? "json" : *given);
  return codec ? std::move(*codec) : nullptr;
}

/// As often as it is read, or as often as the device takes samples by itself; 0: not known.
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
  std::vector<const PartPlan*> publishing, storing;
  for (const PartPlan& part : plan.parts) {
    if (part.publishes) publishing.push_back(&part);
    if (part.stores) storing.push_back(&part);
  }
  for (const PartPlan* sink : storing) {
    const std::unique_ptr<Codec> codec = sink->type == "file" ? codec_of(*sink) : nullptr;
    if (sink->type != "sqlite" && codec == nullptr) continue;
    Growth growth{sink, 0, is_limited(*sink)};
    for (const PartPlan* sensor : publishing) {
      const PublishedTopic& published = *sensor->publishes;
      const double events = events_per_second(published);
      if (published.description == nullptr || events <= 0 || !sink->stores->wants(published.topic)) continue;
      growth.bytes_per_day += (codec ? event_size(*codec, *sensor) : row_size(*sensor)) * events * seconds_per_day;
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
