#include <nlohmann/json.hpp>

#include "rtdata/config/registry.hpp"
#include "rtdata/config/system.hpp"

namespace rtdata {
namespace {

using Json = nlohmann::ordered_json;

/// The schema of the parts of one kind in a file.
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

std::string Registry::schema() const {
  auto json = Json::parse(
      schema_of<SystemSettings>("rtdata configuration", "sensors, where their readings go, and the log"));
  for (auto kind = kinds_.rbegin(); kind != kinds_.rend(); ++kind)
    json["properties"][kind->key] = schema_of_kind(*kind);
  return json.dump(2);
}

}  // namespace rtdata
