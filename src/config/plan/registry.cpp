#include "rtdata/config/registry.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "rtdata/config/settings.hpp"

namespace rtdata {
namespace {

using Json = nlohmann::ordered_json;

/// The schema of what a file says of the parts of a kind.
Json schema_of_kind(const PartKind& kind) {
  auto item = Json::parse(kind.types.schema());
  item.erase("$schema");
  Json json = Json::object();
  if (kind.written == PartKind::Written::list) {
    json["type"] = "array";
    json["items"] = std::move(item);
  } else {
    Json by_name = Json::object();
    by_name["type"] = "object";
    by_name["additionalProperties"] = std::move(item);
    json["anyOf"] = Json::array({std::move(by_name), Json{{"type", "array"}, {"maxItems", 0}}});
  }
  json["description"] = kind.doc;
  return json;
}

}  // namespace

PublishedTopic config_detail::published_topic(const std::string& name, const std::string& topic,
                                              Result<std::shared_ptr<const Description>> description) {
  return {topic.empty() ? name : topic, std::move(description).or_throw(), std::nullopt};
}

std::string config_detail::sink_name(const std::string& type, const std::string& path, const SinkConfig& config) {
  if (!config.name.empty()) return config.name;
  return path.empty() || path == "-" ? type : path;
}

Registry::Registry() {
  using Types = TypeRegistry<PartPlan, const std::string&>;
  kinds_.push_back({"bus", "buses", "what sensors are connected to, by name; each has a `type`",
                    PartKind::Written::by_name, Types("bus")});
  kinds_.push_back({"sink", "sinks", "where it goes; each has a `type`", PartKind::Written::list, Types("sink")});
  kinds_.push_back({"sensor", "sensors", "what is read; each has a `type`", PartKind::Written::list, Types("sensor")});
}

const TypeRegistryBase& Registry::types(std::string_view kind) const {
  return std::find_if(kinds_.begin(), kinds_.end(), [&](const PartKind& known) { return known.name == kind; })->types;
}

std::string Registry::schema() const {
  auto json = Json::parse(
      schema_of<SystemSettings>("rtdata configuration", "sensors, where their readings go, and the log"));
  for (auto kind = kinds_.rbegin(); kind != kinds_.rend(); ++kind)
    json["properties"][kind->key] = schema_of_kind(*kind);
  return json.dump(2);
}

}  // namespace rtdata
