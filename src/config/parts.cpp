#include "rtdata/config/parts.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "rtdata/config/system.hpp"

namespace rtdata {
namespace {

struct SizeUnit {
  std::string_view name;
  std::size_t bytes;
};
constexpr std::array size_units{SizeUnit{"B", 1},
                                SizeUnit{"kB", 1000},
                                SizeUnit{"MB", 1000 * 1000},
                                SizeUnit{"GB", 1000 * 1000 * 1000},
                                SizeUnit{"KiB", std::size_t{1} << 10},
                                SizeUnit{"MiB", std::size_t{1} << 20},
                                SizeUnit{"GiB", std::size_t{1} << 30}};

bool is_same_unit(std::string_view a, std::string_view b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](char x, char y) { return (x | 0x20) == (y | 0x20); });
}

Error size_error(std::string_view text, std::string why) {
  return {Errc::bad_argument, "cannot read this amount of memory", "\"" + std::string(text) + "\"", std::move(why),
          "write it with a unit, such as \"32 MB\" or \"512 KiB\""};
}

nlohmann::ordered_json without_head(const std::string& schema) {
  auto json = nlohmann::ordered_json::parse(schema);
  json.erase("$schema");
  return json;
}

}  // namespace

Result<ByteSize> parse_byte_size(std::string_view text) {
  double number = 0;
  const auto [end, status] = std::from_chars(text.data(), text.data() + text.size(), number, std::chars_format::fixed);
  if (status != std::errc{} || !(number >= 0)) return size_error(text, "it does not begin with a number");
  std::string_view unit = text.substr(static_cast<std::size_t>(end - text.data()));
  while (!unit.empty() && unit.front() == ' ') unit.remove_prefix(1);
  if (unit.empty()) return size_error(text, "it has no unit");
  for (const SizeUnit& known : size_units) {
    if (!is_same_unit(known.name, unit)) continue;
    const double bytes = number * static_cast<double>(known.bytes);
    if (bytes > 9e15) return size_error(text, "it is too large");
    if (bytes != std::floor(bytes)) return size_error(text, "it is no whole number of bytes");
    return ByteSize{static_cast<std::size_t>(bytes)};
  }
  return size_error(text, "there is no unit \"" + std::string(unit) + "\"");
}

std::string to_string(ByteSize size) {
  const SizeUnit* best = &size_units[0];
  for (const SizeUnit& unit : size_units) {
    if (size.bytes != 0 && size.bytes % unit.bytes == 0 && unit.bytes >= best->bytes) best = &unit;
  }
  return std::to_string(size.bytes / best->bytes) + " " + std::string(best->name);
}

bool ConfigValue<ByteSize>::read(const ConfigItem& item, ByteSize& out, Problems& problems) {
  const std::string* text = item.as_string();
  if (text == nullptr) {
    problems.add(item.problem("wrong-type", "expected an amount of memory such as \"32 MB\", got " + item.describe()));
    return false;
  }
  Result<ByteSize> size = parse_byte_size(*text);
  if (!size) {
    problems.add(item.problem("bad-value", "\"" + *text + "\": " + size.error().why + ": " + size.error().advice));
    return false;
  }
  constexpr std::size_t least = 64 * 1024;
  constexpr std::size_t most = std::size_t{64} << 30;
  if (size->bytes < least || size->bytes > most) {
    problems.add(item.problem("out-of-range", *text + " is out of range: 64 KiB to 64 GiB"));
    return false;
  }
  out = *size;
  return true;
}

void ConfigValue<ByteSize>::write(ByteSize value, ConfigItem& item) { item.set_string(to_string(value)); }

SinkConfig SinkKeys::config() const {
  SinkConfig config;
  config.name = name;
  config.topics = topics;
  config.batch_rows = batch_rows;
  config.batch_time = batch_time;
  config.queue_bytes = queue.bytes;
  config.when_full = when_full;
  config.retry_first = retry_first;
  config.retry_longest = retry_longest;
  config.close_deadline = close_deadline;
  return config;
}

SensorPlan config_detail::sensor_plan(const std::string& name, const std::string& topic,
                                      Result<std::shared_ptr<const Description>> description) {
  SensorPlan plan;
  plan.name = name;
  plan.topic = topic.empty() ? name : topic;
  plan.description = std::move(description).or_throw();
  return plan;
}

std::string Registry::schema() const {
  auto json = nlohmann::ordered_json::parse(
      schema_of<SystemSettings>("rtdata configuration", "sensors, where their readings go, and the log"));
  const auto list = [&](const char* key, const TypeRegistryBase& types) {
    auto& property = json["properties"][key];
    property["type"] = "array";
    property["items"] = without_head(types.schema());
    property.erase("default");
  };
  list("sensors", sensors_);
  list("sinks", sinks_);
  return json.dump(2);
}

}  // namespace rtdata
