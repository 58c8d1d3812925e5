#include <algorithm>
#include <limits>
#include <set>

#include "data/field_layout.hpp"
#include "data/json_tree.hpp"
#include "data/nearest.hpp"
#include "rtdata/data/text.hpp"

namespace rtdata {

using namespace detail;

namespace {

using Type = JsonNode::Type;

void append_key(std::string& out, std::string_view key) {
  if (out.back() != '{') out += ',';
  append_json(out, key);
  out += ':';
}

void append(std::string& out, std::string_view key, std::string_view text) {
  append_key(out, key);
  append_json(out, text);
}

void append(std::string& out, const std::vector<Field>& fields) {
  out += '[';
  for (const Field& field : fields) {
    if (out.back() != '[') out += ',';
    out += '{';
    append(out, "name", field.name);
    append(out, "type", name_of(field.kind));
    if (!field.unit.empty()) append(out, "unit", field.unit);
    if (field.is_array) {
      append_key(out, "array");
      out += std::to_string(field.count);
    }
    if (field.optional != nullptr) {
      append_key(out, "optional");
      out += "true";
    }
    if (field.kind == Kind::text) {
      append_key(out, "capacity");
      out += std::to_string(field.size - text_length_bytes);
    }
    if (field.kind == Kind::enumeration) {
      append(out, "base", name_of(field.enum_base));
      append_key(out, "values");
      out += '{';
      for (const EnumValue& value : field.values) {
        append_key(out, value.name);
        out += std::to_string(value.value);
      }
      out += '}';
    }
    if (field.kind == Kind::record) {
      append_key(out, "fields");
      append(out, field.fields);
    }
    out += '}';
  }
  out += ']';
}

/// A key that is not in `known`, or empty.
std::string unknown_key(const JsonNode& node, std::initializer_list<std::string_view> known) {
  for (const std::string& key : node.keys) {
    if (std::find(known.begin(), known.end(), key) == known.end()) return key;
  }
  return {};
}

/// A duplicate key in an object below; null: none.
const std::string* key_twice(const JsonNode& node) {
  std::set<std::string_view> keys;
  for (const std::string& key : node.keys) {
    if (!keys.insert(key).second) return &key;
  }
  for (const JsonNode& child : node.children) {
    if (const std::string* twice = key_twice(child)) return twice;
  }
  return nullptr;
}

bool is(const JsonNode* node, Type type) { return node != nullptr && node->type == type; }

Result<std::vector<Field>> fields_from(const JsonNode& tree, const std::string& where, int depth);

Result<Field> field_from(const JsonNode& node, const std::string& where, int depth) {
  if (node.type != Type::object)
    return not_usable(where, "a field is an object", R"(write {"name": "temperature", "type": "double"})");
  if (const auto key = unknown_key(
          node, {"name", "type", "unit", "array", "optional", "capacity", "base", "values", "fields"});
      !key.empty()) {
    return not_usable(
        where, "unknown key " + key,
        detail::suggestion(key, {"name", "type", "unit", "array", "optional", "capacity", "base", "values", "fields"}));
  }
  const JsonNode* const name_node = node.find("name");
  if (!is(name_node, Type::string)) return not_usable(where, "a field has no name", "add \"name\"");
  const std::string& name = name_node->text;
  const std::string place = where + ", field " + name;
  const auto find_kind = [](const JsonNode* type) -> const std::string_view* {
    if (!is(type, Type::string)) return nullptr;
    const auto found = std::find(std::begin(kind_names), std::end(kind_names), type->text);
    return found == std::end(kind_names) ? nullptr : found;
  };
  const auto kind_names_list = std::vector<std::string_view>(std::begin(kind_names), std::end(kind_names));
  const JsonNode* const type_node = node.find("type");
  const auto* type = find_kind(type_node);
  if (type == nullptr) {
    return not_usable(place, "it has no known type",
                      suggestion(is(type_node, Type::string) ? type_node->text : std::string(), kind_names_list));
  }
  const auto kind = static_cast<Kind>(type - std::begin(kind_names));
  const auto misplaced = [&](const char* key, Kind owner) { return kind != owner && node.find(key) != nullptr; };
  for (const auto& [key, owner] : {std::pair{"capacity", Kind::text}, std::pair{"base", Kind::enumeration},
                                   std::pair{"values", Kind::enumeration}, std::pair{"fields", Kind::record}}) {
    if (misplaced(key, owner))
      return not_usable(place, std::string(key) + " does not belong to this type", "remove it");
  }
  std::string unit;
  if (const JsonNode* given = node.find("unit")) {
    if (!is(given, Type::string)) return not_usable(place, "unit is not a string", R"(write "unit": "Cel")");
    unit = given->text;
  }
  Field field;
  if (kind == Kind::text) {
    const JsonNode* const capacity = node.find("capacity");
    if (!is(capacity, Type::natural)) return not_usable(place, "a text needs a capacity", R"(write "capacity": 32)");
    field = text_field(name, static_cast<std::size_t>(capacity->natural));
  } else if (kind == Kind::enumeration) {
    const JsonNode* const named = node.find("values");
    if (!is(named, Type::object)) {
      return not_usable(place, "an enumeration needs values", R"(write "values": {"idle": 0, "running": 1})");
    }
    std::vector<EnumValue> values;
    for (std::size_t i = 0; i < named->keys.size(); ++i) {
      const JsonNode& number = named->children[i];
      const bool is_natural = is(&number, Type::natural) &&
                              number.natural <= std::uint64_t{std::numeric_limits<std::int64_t>::max()};
      if (!is_natural && !is(&number, Type::integer)) {
        return not_usable(place, "the value " + named->keys[i] + " is not an integer of 64 bits", "give it a number");
      }
      values.push_back({named->keys[i], is_natural ? static_cast<std::int64_t>(number.natural) : number.integer});
    }
    Kind base = Kind::i32;
    if (const JsonNode* given = node.find("base")) {
      const auto* found = find_kind(given);
      if (found == nullptr || !is_integer_kind(static_cast<Kind>(found - std::begin(kind_names)))) {
        return not_usable(place, "base is not an integer type", "use int8 to int64 or uint8 to uint64");
      }
      base = static_cast<Kind>(found - std::begin(kind_names));
    }
    field = enum_field(name, std::move(values), base);
  } else if (kind == Kind::record) {
    const JsonNode* const given = node.find("fields");
    if (given == nullptr) return not_usable(place, "a record needs fields", "add \"fields\": [...]");
    auto fields = fields_from(*given, place, depth + 1);
    if (!fields) return std::move(fields).error();
    auto layout = lay_out(*fields, name);
    if (!layout) return std::move(layout).error();
    field = record_field(name, std::move(*fields), layout->size, layout->alignment);
  } else {
    field = plain_field(name, kind, {});
  }
  field.unit = std::move(unit);
  if (const JsonNode* count = node.find("array")) {
    if (!is(count, Type::natural)) return not_usable(place, "array is not a count", R"(write "array": 3)");
    field = array_of(std::move(field), static_cast<std::size_t>(count->natural));
  }
  auto presence = DescriptionBuilder::Presence::always;
  if (const JsonNode* optional = node.find("optional")) {
    if (!is(optional, Type::boolean))
      return not_usable(place, "optional is neither true nor false", "write true or false");
    if (optional->flag) presence = DescriptionBuilder::Presence::optional;
  }
  if (field.size > largest_payload) return not_usable(place, "it is too large", "make it smaller");
  return finished(std::move(field), presence);
}

Result<std::vector<Field>> fields_from(const JsonNode& tree, const std::string& where, int depth) {
  if (tree.type != Type::array)
    return not_usable(where, "fields is not a list", R"(write "fields": [{"name": ..., "type": ...}, ...])");
  if (depth > deepest_record) return not_usable(where, "records are nested too deep", "flatten them");
  std::vector<Field> fields;
  for (const JsonNode& node : tree.children) {
    auto field = field_from(node, where, depth);
    if (!field) return std::move(field).error();
    fields.push_back(std::move(*field));
  }
  return fields;
}

}  // namespace

std::string Description::to_json() const {
  std::string json = "{";
  append(json, "name", name_);
  append_key(json, "fields");
  append(json, fields_);
  return json + '}';
}

Result<std::shared_ptr<const Description>> Description::from_json(std::string_view json) {
  JsonNode tree;
  if (const std::string mistake = parse_json(json, tree); !mistake.empty())
    return not_usable("", "it is not JSON: " + mistake, R"(write {"name": ..., "fields": [...]})");
  if (const std::string* twice = key_twice(tree))
    return not_usable("", "the key " + *twice + " is there twice", "remove one");
  const JsonNode* const name_node = tree.find("name");
  const JsonNode* const fields_node = tree.find("fields");
  if (!is(&tree, Type::object) || !is(name_node, Type::string) || fields_node == nullptr) {
    return not_usable("", "it has no name and fields", R"(write {"name": "climate", "fields": [...]})");
  }
  if (const auto key = unknown_key(tree, {"name", "fields"}); !key.empty()) {
    return not_usable("", "unknown key " + key, "known are name, fields");
  }
  auto name = name_node->text;
  auto fields = fields_from(*fields_node, "record " + name, 0);
  if (!fields) return std::move(fields).error();
  auto layout = lay_out(*fields, name);
  if (!layout) return std::move(layout).error();
  return make(std::move(name), std::move(*fields), layout->size, layout->alignment);
}

}  // namespace rtdata
