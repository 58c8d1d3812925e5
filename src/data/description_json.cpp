#include <algorithm>
#include <limits>
#include <nlohmann/json.hpp>
#include <set>

#include "data/field_layout.hpp"
#include "data/nearest.hpp"
#include "rtdata/data/text.hpp"

namespace rtdata {

using namespace detail;

namespace {

using Json = nlohmann::ordered_json;

Json to_tree(const std::vector<Field>& fields) {
  Json tree = Json::array();
  for (const Field& field : fields) {
    Json node = {{"name", field.name}, {"type", name_of(field.kind)}};
    if (!field.unit.empty()) node["unit"] = field.unit;
    if (field.is_array) node["array"] = field.count;
    if (field.optional != nullptr) node["optional"] = true;
    if (field.kind == Kind::text) node["capacity"] = field.size - text_length_bytes;
    if (field.kind == Kind::enumeration) {
      node["base"] = name_of(field.enum_base);
      Json values = Json::object();
      for (const EnumValue& value : field.values) values[value.name] = value.value;
      node["values"] = std::move(values);
    }
    if (field.kind == Kind::record) node["fields"] = to_tree(field.fields);
    tree.push_back(std::move(node));
  }
  return tree;
}

/// A key that is not in `known`, or empty.
std::string unknown_key(const Json& node, std::initializer_list<std::string_view> known) {
  for (const auto& [key, child] : node.items()) {
    if (std::find(known.begin(), known.end(), key) == known.end()) return key;
  }
  return {};
}

Result<std::vector<Field>> fields_from(const Json& tree, const std::string& where, int depth);

Result<Field> field_from(const Json& node, const std::string& where, int depth) {
  if (!node.is_object())
    return not_usable(where, "a field is an object", R"(write {"name": "temperature", "type": "double"})");
  if (const auto key = unknown_key(
          node, {"name", "type", "unit", "array", "optional", "capacity", "base", "values", "fields"});
      !key.empty()) {
    return not_usable(
        where, "unknown key " + key,
        detail::suggestion(key, {"name", "type", "unit", "array", "optional", "capacity", "base", "values", "fields"}));
  }
  if (!node.contains("name") || !node["name"].is_string())
    return not_usable(where, "a field has no name", "add \"name\"");
  const auto name = node["name"].get<std::string>();
  const std::string place = where + ", field " + name;
  const auto find_kind = [](const Json& type) -> const std::string_view* {
    if (!type.is_string()) return nullptr;
    const auto found = std::find(std::begin(kind_names), std::end(kind_names), type.get_ref<const std::string&>());
    return found == std::end(kind_names) ? nullptr : found;
  };
  const auto kind_names_list = std::vector<std::string_view>(std::begin(kind_names), std::end(kind_names));
  const auto* type = node.contains("type") ? find_kind(node["type"]) : nullptr;
  if (type == nullptr) {
    return not_usable(place, "it has no known type",
                      node.contains("type") && node["type"].is_string()
                          ? detail::suggestion(node["type"].get<std::string>(), kind_names_list)
                          : detail::suggestion("", kind_names_list));
  }
  const auto kind = static_cast<Kind>(type - std::begin(kind_names));
  const auto misplaced = [&](const char* key, Kind owner) { return kind != owner && node.contains(key); };
  for (const auto& [key, owner] : {std::pair{"capacity", Kind::text}, std::pair{"base", Kind::enumeration},
                                   std::pair{"values", Kind::enumeration}, std::pair{"fields", Kind::record}}) {
    if (misplaced(key, owner))
      return not_usable(place, std::string(key) + " does not belong to this type", "remove it");
  }
  std::string unit;
  if (node.contains("unit")) {
    if (!node["unit"].is_string()) return not_usable(place, "unit is no string", R"(write "unit": "Cel")");
    unit = node["unit"].get<std::string>();
  }
  Field field;
  if (kind == Kind::text) {
    if (!node.contains("capacity") || !node["capacity"].is_number_unsigned()) {
      return not_usable(place, "a text needs a capacity", R"(write "capacity": 32)");
    }
    field = text_field(name, node["capacity"].get<std::size_t>());
  } else if (kind == Kind::enumeration) {
    if (!node.contains("values") || !node["values"].is_object()) {
      return not_usable(place, "an enumeration needs values", R"(write "values": {"idle": 0, "running": 1})");
    }
    std::vector<EnumValue> values;
    for (const auto& [key, number] : node["values"].items()) {
      if (!number.is_number_integer() ||
          (number.is_number_unsigned() &&
           number.get<std::uint64_t>() > static_cast<std::uint64_t>(std::numeric_limits<std::int64_t>::max()))) {
        return not_usable(place, "the value " + key + " is no integer of 64 bits", "give it a number");
      }
      values.push_back({key, number.get<std::int64_t>()});
    }
    Kind base = Kind::i32;
    if (node.contains("base")) {
      const auto* found = find_kind(node["base"]);
      if (found == nullptr || !is_integer_kind(static_cast<Kind>(found - std::begin(kind_names)))) {
        return not_usable(place, "base is no integer type", "use int8 to int64 or uint8 to uint64");
      }
      base = static_cast<Kind>(found - std::begin(kind_names));
    }
    field = enum_field(name, std::move(values), base);
  } else if (kind == Kind::record) {
    if (!node.contains("fields")) return not_usable(place, "a record needs fields", "add \"fields\": [...]");
    auto fields = fields_from(node["fields"], place, depth + 1);
    if (!fields) return std::move(fields).error();
    auto layout = lay_out(*fields, name);
    if (!layout) return std::move(layout).error();
    field = record_field(name, std::move(*fields), layout->size, layout->alignment);
  } else {
    field = plain_field(name, kind, {});
  }
  field.unit = std::move(unit);
  if (node.contains("array")) {
    if (!node["array"].is_number_unsigned()) return not_usable(place, "array is no count", R"(write "array": 3)");
    field = array_of(std::move(field), node["array"].get<std::size_t>());
  }
  auto presence = DescriptionBuilder::Presence::always;
  if (node.contains("optional")) {
    if (!node["optional"].is_boolean())
      return not_usable(place, "optional is neither true nor false", "write true or false");
    if (node["optional"].get<bool>()) presence = DescriptionBuilder::Presence::optional;
  }
  if (field.size > largest_payload) return not_usable(place, "it is too large", "make it smaller");
  return finished(std::move(field), presence);
}

Result<std::vector<Field>> fields_from(const Json& tree, const std::string& where, int depth) {
  if (!tree.is_array())
    return not_usable(where, "fields is no list", R"(write "fields": [{"name": ..., "type": ...}, ...])");
  if (depth > deepest_record) return not_usable(where, "records are nested too deep", "flatten them");
  std::vector<Field> fields;
  for (const Json& node : tree) {
    auto field = field_from(node, where, depth);
    if (!field) return std::move(field).error();
    fields.push_back(std::move(*field));
  }
  return fields;
}

}  // namespace

std::string Description::to_json() const {
  return Json{{"name", name_}, {"fields", to_tree(fields_)}}.dump(-1, ' ', false, Json::error_handler_t::replace);
}

Result<std::shared_ptr<const Description>> Description::from_json(std::string_view json) {
  Json tree;
  std::vector<std::set<std::string>> open;
  std::string twice;
  const auto watch = [&](int depth, Json::parse_event_t event, Json& parsed) {
    // Deep nesting costs stack when the tree is used, so what no description needs is not kept.
    if (depth > 3 * (deepest_record + 2)) return false;
    if (event == Json::parse_event_t::object_start) open.emplace_back();
    if (event == Json::parse_event_t::key && !open.back().insert(parsed.get<std::string>()).second) {
      twice = parsed.get<std::string>();
    }
    if (event == Json::parse_event_t::object_end) open.pop_back();
    return true;
  };
  try {
    tree = Json::parse(json, watch);
  } catch (const Json::exception& exception) {
    return not_usable("", std::string("it is no JSON: ") + exception.what(), R"(write {"name": ..., "fields": [...]})");
  }
  if (!twice.empty()) return not_usable("", "the key " + twice + " is there twice", "remove one");
  if (!tree.is_object() || !tree.contains("name") || !tree["name"].is_string() || !tree.contains("fields")) {
    return not_usable("", "it has no name and fields", R"(write {"name": "climate", "fields": [...]})");
  }
  if (const auto key = unknown_key(tree, {"name", "fields"}); !key.empty()) {
    return not_usable("", "unknown key " + key, "known are name, fields");
  }
  auto name = tree["name"].get<std::string>();
  auto fields = fields_from(tree["fields"], "record " + name, 0);
  if (!fields) return std::move(fields).error();
  auto layout = lay_out(*fields, name);
  if (!layout) return std::move(layout).error();
  return make(std::move(name), std::move(*fields), layout->size, layout->alignment);
}

}  // namespace rtdata
