#include "rtdata/config/parts.hpp"

#include <nlohmann/json.hpp>

#include "rtdata/config/system.hpp"

namespace rtdata {
namespace {

nlohmann::ordered_json without_head(const std::string& schema) {
  auto json = nlohmann::ordered_json::parse(schema);
  json.erase("$schema");
  return json;
}

}  // namespace

SensorPlan config_detail::sensor_plan(const std::string& name, const std::string& topic,
                                      Result<std::shared_ptr<const Description>> description) {
  SensorPlan plan;
  plan.name = name;
  plan.topic = topic.empty() ? name : topic;
  plan.description = std::move(description).or_throw();
  return plan;
}

SinkPlan config_detail::sink_plan(const std::string& type, std::string path, const SinkConfig& config) {
  SinkPlan plan;
  plan.type = type;
  plan.path = std::move(path);
  plan.name = !config.name.empty() ? config.name : plan.path.empty() || plan.path == "-" ? type : plan.path;
  plan.topics = config.topics;
  plan.close_deadline = config.close_deadline;
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
