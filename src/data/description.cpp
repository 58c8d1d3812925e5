#include "rtdata/data/description.hpp"

#include <algorithm>
#include <atomic>
#include <cstring>
#include <limits>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <set>

#include "data/nearest.hpp"
#include "rtdata/data/describe.hpp"
#include "rtdata/data/text.hpp"

namespace rtdata {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::size_t largest_payload = std::size_t{1} << 24;
constexpr std::size_t most_leaves = 65536;
constexpr int deepest_record = 16;

constexpr std::string_view kind_names[] = {"bool",   "char",   "int8",  "int16",  "int32", "int64", "uint8", "uint16",
                                           "uint32", "uint64", "float", "double", "text",  "enum",  "record"};

Error bad(std::string where, std::string why, std::string advice = {}) {
  return {Errc::bad_description, "the description is not usable", std::move(where), std::move(why), std::move(advice)};
}

std::string lower_case(std::string_view text) {
  std::string lower(text);
  for (char& c : lower) c = detail::lower(c);
  return lower;
}

/// Bytes of an integer, a float, a bool or a char; 0 for the others.
std::size_t size_of(Kind kind) {
  switch (kind) {
    case Kind::boolean:
      return sizeof(bool);
    case Kind::character:
    case Kind::i8:
    case Kind::u8:
      return 1;
    case Kind::i16:
    case Kind::u16:
      return 2;
    case Kind::i32:
    case Kind::u32:
    case Kind::f32:
      return 4;
    case Kind::i64:
    case Kind::u64:
    case Kind::f64:
      return 8;
    case Kind::text:
    case Kind::enumeration:
    case Kind::record:
      break;
  }
  return 0;
}

std::size_t alignment_of(Kind kind) {
  switch (size_of(kind)) {
    case 2:
      return alignof(std::int16_t);
    case 4:
      return kind == Kind::f32 ? alignof(float) : alignof(std::int32_t);
    case 8:
      return kind == Kind::f64 ? alignof(double) : alignof(std::int64_t);
    default:
      return 1;
  }
}

bool is_integer(Kind kind) { return kind >= Kind::i8 && kind <= Kind::u64; }

std::size_t round_up(std::size_t value, std::size_t alignment) {
  return (value + alignment - 1) / alignment * alignment;
}

bool fits(std::int64_t value, Kind base) {
  switch (base) {
    case Kind::i8:
      return value >= -128 && value <= 127;
    case Kind::i16:
      return value >= -32768 && value <= 32767;
    case Kind::i32:
      return value >= std::numeric_limits<std::int32_t>::min() && value <= std::numeric_limits<std::int32_t>::max();
    case Kind::u8:
      return value >= 0 && value <= 255;
    case Kind::u16:
      return value >= 0 && value <= 65535;
    case Kind::u32:
      return value >= 0 && value <= std::numeric_limits<std::uint32_t>::max();
    default:
      return true;  // a u64 is kept bit for bit
  }
}

/// "double", "text<16>[4]", "optional int32".
std::string shape(const Field& field) {
  std::string text = field.optional != nullptr ? "optional " : "";
  text += name_of(field.kind);
  if (field.kind == Kind::text) text += "<" + std::to_string(field.size - text_length_bytes) + ">";
  if (field.is_array) text += "[" + std::to_string(field.count) + "]";
  return text;
}

bool same_shape(const Field& a, const Field& b) {
  return a.kind == b.kind && a.is_array == b.is_array && a.count == b.count &&
         (a.optional == nullptr) == (b.optional == nullptr) && (a.kind != Kind::text || a.size == b.size);
}

std::string list(const std::vector<EnumValue>& values) {
  std::string text;
  for (const auto& value : values) text += (text.empty() ? "" : ", ") + value.name + "=" + std::to_string(value.value);
  return text;
}

/// Everything of one record: names, shapes, sizes; then its records. `where` ends in a dot unless empty.
Result<void> check(const std::vector<Field>& fields, std::size_t size, const std::string& where, int depth) {
  if (depth > deepest_record) {
    return bad(where, "records are nested more than " + std::to_string(deepest_record) + " deep", "flatten them");
  }
  std::set<std::string> seen;
  for (const Field& field : fields) {
    const std::string path = where + field.name;
    const std::string place = "field " + path;
    if (!is_name(field.name)) {
      return bad("field \"" + path + "\"", "a field name has letters, digits and underscores and starts with no digit",
                 "rename it");
    }
    if (!seen.insert(lower_case(field.name)).second) {
      return bad(place, "the name is there twice (upper and lower case count as the same)", "rename one of them");
    }
    if (where.empty()) {
      for (const std::string_view taken : {"time", "origin", "sequence", "run"}) {
        if (lower_case(field.name) == taken) {
          return bad(place, "every event has a " + std::string(taken) + " of its own",
                     "rename the field, for example to device_" + std::string(taken));
        }
      }
    }
    if (field.count == 0 || (!field.is_array && field.count != 1)) {
      return bad(place, "an array needs at least one element", "give it a count");
    }
    std::size_t expected = size_of(field.kind);
    if (field.kind == Kind::enumeration) {
      if (!is_integer(field.enum_base)) return bad(place, "an enumeration is stored as an integer", "change `base`");
      if (field.values.empty()) return bad(place, "an enumeration needs at least one value", "add `values`");
      expected = size_of(field.enum_base);
      std::set<std::string> names;
      std::set<std::int64_t> numbers;
      for (const EnumValue& value : field.values) {
        if (value.name.empty()) return bad(place, "a value of the enumeration has no name", "name it");
        if (!names.insert(value.name).second) {
          return bad(place, "the value " + value.name + " is there twice", "rename one of them");
        }
        if (!numbers.insert(value.value).second) {
          return bad(place, "two values have the number " + std::to_string(value.value), "give each its own");
        }
        if (!fits(value.value, field.enum_base)) {
          return bad(place, std::to_string(value.value) + " does not fit into " + std::string(name_of(field.enum_base)),
                     "use a larger `base`");
        }
      }
    } else if (!field.values.empty()) {
      return bad(place, "only an enumeration has values", "remove them, or make it an enum");
    }
    if (field.kind == Kind::text) {
      if (field.size <= text_length_bytes || field.size > 65535 + text_length_bytes) {
        return bad(place, "a text holds between 1 and 65535 bytes", "change its capacity");
      }
      expected = field.size;
    }
    if (field.kind == Kind::record) {
      if (field.optional != nullptr) return bad(place, "a record cannot be optional", "make its fields optional");
      expected = field.size;
    } else if (!field.fields.empty()) {
      return bad(place, "only a record has fields of its own", "make its type \"record\"");
    }
    if (field.size != expected || field.size > largest_payload || field.count > largest_payload) {
      return bad(place, std::to_string(field.size) + " bytes are no size for a " + shape(field), "change it");
    }
    const std::size_t least = field.size + (field.optional != nullptr ? 1 : 0);
    if (field.stride < least || field.stride > largest_payload || field.offset > size ||
        field.stride * field.count > size - field.offset) {
      return bad(place, "it lies outside the " + std::to_string(size) + " bytes of its record",
                 "make the payload smaller");
    }
    if (field.optional != nullptr && field.optional->value_size != field.size) {
      return bad(place, "its optional access is for another size", "use optional_access(size)");
    }
    if (field.kind == Kind::record) {
      if (auto checked = check(field.fields, field.size, path + ".", depth + 1); !checked) return checked;
    }
  }
  return {};
}

/// False when there are too many.
bool add_leaves(const std::vector<Field>& fields, std::size_t base, const std::string& prefix,
                std::vector<Leaf>& leaves) {
  for (const Field& field : fields) {
    for (std::size_t i = 0; i < field.count; ++i) {
      std::string path = prefix + field.name;
      if (field.is_array) path += "[" + std::to_string(i) + "]";
      const std::size_t offset = base + field.offset + i * field.stride;
      if (field.kind == Kind::record) {
        if (field.fields.empty()) break;
        if (!add_leaves(field.fields, offset, path + ".", leaves)) return false;
        continue;
      }
      if (leaves.size() >= most_leaves) return false;
      leaves.push_back(
          {std::move(path), field.kind, field.unit, offset, field.size, field.optional, field.enum_base, &field, i});
    }
  }
  return true;
}

void compare(const std::vector<Field>& here, const std::vector<Field>& there, const std::string& prefix,
             std::vector<std::string>& lines) {
  const auto find = [](const std::vector<Field>& fields, const std::string& name) {
    return std::find_if(fields.begin(), fields.end(), [&](const Field& field) { return field.name == name; });
  };
  const std::size_t before = lines.size();
  for (const Field& mine : here) {
    const std::string what = "field " + prefix + mine.name + ": ";
    const auto other = find(there, mine.name);
    if (other == there.end()) {
      lines.push_back(what + "only here");
      continue;
    }
    if (!same_shape(mine, *other)) {
      lines.push_back(what + "type " + shape(mine) + " here, " + shape(*other) + " there");
      continue;
    }
    if (mine.unit != other->unit) {
      const auto unit = [](const std::string& text) { return text.empty() ? std::string("none") : text; };
      lines.push_back(what + "unit " + unit(mine.unit) + " here, " + unit(other->unit) + " there");
    }
    if (mine.values != other->values) {
      lines.push_back(what + "values " + list(mine.values) + " here, " + list(other->values) + " there");
    }
    compare(mine.fields, other->fields, prefix + mine.name + ".", lines);
  }
  for (const Field& other : there) {
    if (find(here, other.name) == here.end()) lines.push_back("field " + prefix + other.name + ": only there");
  }
  if (lines.size() != before) return;
  for (std::size_t i = 0; i < here.size(); ++i) {
    if (here[i].name == there[i].name) continue;
    lines.push_back("field " + prefix + here[i].name + ": number " + std::to_string(i + 1) + " here, " +
                    std::to_string(find(there, here[i].name) - there.begin() + 1) + " there");
    return;
  }
}

struct Layout {
  std::size_t size = 0;
  std::size_t alignment = 1;
};

/// Puts the fields one after the other as a C++ compiler does.
Result<Layout> lay_out(std::vector<Field>& fields, const std::string& name) {
  Layout layout;
  for (Field& field : fields) {
    if (field.size > largest_payload || field.count > largest_payload || field.stride > largest_payload) {
      return bad("record " + name + ", field " + field.name, "it is too large", "make it smaller");
    }
    field.offset = round_up(layout.size, field.alignment);
    layout.size = field.offset + field.stride * field.count;
    layout.alignment = std::max(layout.alignment, field.alignment);
    if (layout.size > largest_payload) {
      return bad("record " + name + ", field " + field.name,
                 "the payload would be larger than " + std::to_string(largest_payload) + " bytes", "make it smaller");
    }
  }
  layout.size = std::max<std::size_t>(1, round_up(layout.size, layout.alignment));
  return layout;
}

Field plain_field(std::string name, Kind kind, std::string unit) {
  Field field;
  field.name = std::move(name);
  field.kind = kind;
  field.unit = std::move(unit);
  field.size = size_of(kind);
  field.alignment = alignment_of(kind);
  return field;
}

Field text_field(std::string name, std::size_t capacity) {
  Field field = plain_field(std::move(name), Kind::text, {});
  // An impossible capacity stays impossible, and is refused by check().
  field.size = capacity > 65535 ? text_length_bytes + 65536 : capacity + text_length_bytes;
  return field;
}

Field enum_field(std::string name, std::vector<EnumValue> values, Kind base) {
  Field field = plain_field(std::move(name), Kind::enumeration, {});
  field.enum_base = base;
  field.size = size_of(base);
  field.alignment = alignment_of(base);
  field.values = std::move(values);
  return field;
}

Field record_field(std::string name, std::vector<Field> fields, std::size_t size, std::size_t alignment) {
  Field field = plain_field(std::move(name), Kind::record, {});
  field.fields = std::move(fields);
  field.size = size;
  field.alignment = alignment;
  return field;
}

Field array_of(Field field, std::size_t count) {
  field.is_array = true;
  field.count = count;
  return field;
}

/// What follows from size and alignment: the stride, and the place for presence.
Field finished(Field field, DescriptionBuilder::Presence presence) {
  field.stride = field.size;
  if (presence == DescriptionBuilder::Presence::optional) {
    field.optional = &optional_access(field.size);
    field.stride = round_up(field.size + 1, field.alignment);
  }
  return field;
}

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
    return bad(where, "a field is an object", R"(write {"name": "temperature", "type": "double"})");
  if (const auto key =
          unknown_key(node, {"name", "type", "unit", "array", "optional", "capacity", "base", "values", "fields"});
      !key.empty()) {
    return bad(
        where, "unknown key " + key,
        detail::suggestion(key, {"name", "type", "unit", "array", "optional", "capacity", "base", "values", "fields"}));
  }
  if (!node.contains("name") || !node["name"].is_string()) return bad(where, "a field has no name", "add \"name\"");
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
    return bad(place, "it has no known type",
               node.contains("type") && node["type"].is_string()
                   ? detail::suggestion(node["type"].get<std::string>(), kind_names_list)
                   : detail::suggestion("", kind_names_list));
  }
  const auto kind = static_cast<Kind>(type - std::begin(kind_names));
  const auto misplaced = [&](const char* key, Kind owner) { return kind != owner && node.contains(key); };
  for (const auto& [key, owner] : {std::pair{"capacity", Kind::text}, std::pair{"base", Kind::enumeration},
                                   std::pair{"values", Kind::enumeration}, std::pair{"fields", Kind::record}}) {
    if (misplaced(key, owner)) return bad(place, std::string(key) + " does not belong to this type", "remove it");
  }
  std::string unit;
  if (node.contains("unit")) {
    if (!node["unit"].is_string()) return bad(place, "unit is no string", R"(write "unit": "Cel")");
    unit = node["unit"].get<std::string>();
  }
  Field field;
  if (kind == Kind::text) {
    if (!node.contains("capacity") || !node["capacity"].is_number_unsigned()) {
      return bad(place, "a text needs a capacity", R"(write "capacity": 32)");
    }
    field = text_field(name, node["capacity"].get<std::size_t>());
  } else if (kind == Kind::enumeration) {
    if (!node.contains("values") || !node["values"].is_object()) {
      return bad(place, "an enumeration needs values", R"(write "values": {"idle": 0, "running": 1})");
    }
    std::vector<EnumValue> values;
    for (const auto& [key, number] : node["values"].items()) {
      if (!number.is_number_integer() ||
          (number.is_number_unsigned() &&
           number.get<std::uint64_t>() > static_cast<std::uint64_t>(std::numeric_limits<std::int64_t>::max()))) {
        return bad(place, "the value " + key + " is no integer of 64 bits", "give it a number");
      }
      values.push_back({key, number.get<std::int64_t>()});
    }
    Kind base = Kind::i32;
    if (node.contains("base")) {
      const auto* found = find_kind(node["base"]);
      if (found == nullptr || !is_integer(static_cast<Kind>(found - std::begin(kind_names)))) {
        return bad(place, "base is no integer type", "use int8 to int64 or uint8 to uint64");
      }
      base = static_cast<Kind>(found - std::begin(kind_names));
    }
    field = enum_field(name, std::move(values), base);
  } else if (kind == Kind::record) {
    if (!node.contains("fields")) return bad(place, "a record needs fields", "add \"fields\": [...]");
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
    if (!node["array"].is_number_unsigned()) return bad(place, "array is no count", R"(write "array": 3)");
    field = array_of(std::move(field), node["array"].get<std::size_t>());
  }
  auto presence = DescriptionBuilder::Presence::always;
  if (node.contains("optional")) {
    if (!node["optional"].is_boolean()) return bad(place, "optional is neither true nor false", "write true or false");
    if (node["optional"].get<bool>()) presence = DescriptionBuilder::Presence::optional;
  }
  if (field.size > largest_payload) return bad(place, "it is too large", "make it smaller");
  return finished(std::move(field), presence);
}

Result<std::vector<Field>> fields_from(const Json& tree, const std::string& where, int depth) {
  if (!tree.is_array()) return bad(where, "fields is no list", R"(write "fields": [{"name": ..., "type": ...}, ...])");
  if (depth > deepest_record) return bad(where, "records are nested too deep", "flatten them");
  std::vector<Field> fields;
  for (const Json& node : tree) {
    auto field = field_from(node, where, depth);
    if (!field) return std::move(field).error();
    fields.push_back(std::move(*field));
  }
  return fields;
}

}  // namespace

std::string_view name_of(Kind kind) noexcept {
  const auto index = static_cast<std::size_t>(kind);
  return index < std::size(kind_names) ? kind_names[index] : std::string_view("unknown");
}

std::byte* OptionalAccess::set(std::byte* optional, bool present) const noexcept {
  std::memset(optional, 0, value_size);
  optional[value_size] = static_cast<std::byte>(present ? 1 : 0);
  return present ? optional : nullptr;
}

const OptionalAccess& optional_access(std::size_t value_size) {
  static std::mutex mutex;
  static auto& known = *new std::map<std::size_t, OptionalAccess>;  // never destroyed: descriptions may outlive statics
  const std::lock_guard lock(mutex);
  return known.try_emplace(value_size, OptionalAccess{value_size}).first->second;
}

bool Field::same_meaning(const Field& other) const noexcept {
  return name == other.name && unit == other.unit && same_shape(*this, other) && values == other.values &&
         std::equal(fields.begin(), fields.end(), other.fields.begin(), other.fields.end(),
                    [](const Field& a, const Field& b) { return a.same_meaning(b); });
}

bool is_name(std::string_view text) noexcept { return detail::is_good_name(text); }

Result<std::shared_ptr<const Description>> Description::make(std::string name, std::vector<Field> fields,
                                                             std::size_t size, std::size_t alignment) {
  if (!is_name(name)) {
    return bad("record \"" + name + "\"",
               "a record's name has letters, digits and underscores and starts with no digit", "rename it");
  }
  if (size == 0 || size > largest_payload || alignment == 0 || (alignment & (alignment - 1)) != 0) {
    return bad("record " + name, "a payload of " + std::to_string(size) + " bytes is not possible",
               "use at most " + std::to_string(largest_payload));
  }
  if (auto checked = check(fields, size, "", 0); !checked) {
    Error error = std::move(checked).error();
    error.where = "record " + name + ", " + error.where;
    return error;
  }
  auto made = std::shared_ptr<Description>(new Description);
  made->name_ = std::move(name);
  made->fields_ = std::move(fields);
  made->size_ = size;
  made->alignment_ = alignment;
  if (!add_leaves(made->fields_, 0, "", made->leaves_)) {
    return bad("record " + made->name_, "it has more than " + std::to_string(most_leaves) + " values", "use fewer");
  }
  static std::atomic<std::uint64_t> last_serial{0};
  made->serial_ = ++last_serial;
  return std::shared_ptr<const Description>(std::move(made));
}

const Leaf* Description::find(std::string_view path) const noexcept {
  for (const Leaf& leaf : leaves_) {
    if (leaf.path == path) return &leaf;
  }
  return nullptr;
}

bool Description::same_meaning(const Description& other) const noexcept {
  return this == &other ||
         (name_ == other.name_ && std::equal(fields_.begin(), fields_.end(), other.fields_.begin(), other.fields_.end(),
                                             [](const Field& a, const Field& b) { return a.same_meaning(b); }));
}

bool Description::same_layout(const Description& other) const noexcept {
  return this == &other || (size_ == other.size_ && alignment_ == other.alignment_ &&
                            std::equal(leaves_.begin(), leaves_.end(), other.leaves_.begin(), other.leaves_.end(),
                                       [](const Leaf& a, const Leaf& b) {
                                         return a.kind == b.kind && a.offset == b.offset && a.size == b.size &&
                                                (a.optional == nullptr) == (b.optional == nullptr) &&
                                                (a.kind != Kind::enumeration || a.enum_base == b.enum_base);
                                       }));
}

std::vector<std::string> Description::differences(const Description& other) const {
  std::vector<std::string> lines;
  if (name_ != other.name_) lines.push_back("record name " + name_ + " here, " + other.name_ + " there");
  compare(fields_, other.fields_, "", lines);
  return lines;
}

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
    return bad("", std::string("it is no JSON: ") + exception.what(), R"(write {"name": ..., "fields": [...]})");
  }
  if (!twice.empty()) return bad("", "the key " + twice + " is there twice", "remove one");
  if (!tree.is_object() || !tree.contains("name") || !tree["name"].is_string() || !tree.contains("fields")) {
    return bad("", "it has no name and fields", R"(write {"name": "climate", "fields": [...]})");
  }
  if (const auto key = unknown_key(tree, {"name", "fields"}); !key.empty()) {
    return bad("", "unknown key " + key, "known are name, fields");
  }
  auto name = tree["name"].get<std::string>();
  auto fields = fields_from(tree["fields"], "record " + name, 0);
  if (!fields) return std::move(fields).error();
  auto layout = lay_out(*fields, name);
  if (!layout) return std::move(layout).error();
  return make(std::move(name), std::move(*fields), layout->size, layout->alignment);
}

DescriptionBuilder::DescriptionBuilder(std::string name) : name_(std::move(name)) {}

DescriptionBuilder& DescriptionBuilder::add(Field field, Presence presence) {
  fields_.push_back(finished(std::move(field), presence));
  return *this;
}

DescriptionBuilder& DescriptionBuilder::field(std::string name, Kind kind, std::string unit, Presence presence) {
  return add(plain_field(std::move(name), kind, std::move(unit)), presence);
}

DescriptionBuilder& DescriptionBuilder::text(std::string name, std::size_t capacity, Presence presence) {
  return add(text_field(std::move(name), capacity), presence);
}

DescriptionBuilder& DescriptionBuilder::array(std::string name, Kind kind, std::size_t count, std::string unit,
                                              Presence presence) {
  return add(array_of(plain_field(std::move(name), kind, std::move(unit)), count), presence);
}

DescriptionBuilder& DescriptionBuilder::text_array(std::string name, std::size_t capacity, std::size_t count,
                                                   Presence presence) {
  return add(array_of(text_field(std::move(name), capacity), count), presence);
}

DescriptionBuilder& DescriptionBuilder::enumeration(std::string name, std::vector<EnumValue> values, Kind base,
                                                    Presence presence) {
  return add(enum_field(std::move(name), std::move(values), base), presence);
}

DescriptionBuilder& DescriptionBuilder::enumeration_array(std::string name, std::vector<EnumValue> values,
                                                          std::size_t count, Kind base, Presence presence) {
  return add(array_of(enum_field(std::move(name), std::move(values), base), count), presence);
}

DescriptionBuilder& DescriptionBuilder::record(std::string name, const Description& description) {
  return add(record_field(std::move(name), description.fields(), description.size(), description.alignment()),
             Presence::always);
}

DescriptionBuilder& DescriptionBuilder::record_array(std::string name, const Description& description,
                                                     std::size_t count) {
  return add(
      array_of(record_field(std::move(name), description.fields(), description.size(), description.alignment()), count),
      Presence::always);
}

Result<std::shared_ptr<const Description>> DescriptionBuilder::build() {
  for (const Field& field : fields_) {
    // What the general calls cannot say: the capacity of a text, the values of an enumeration, the fields of a record.
    if (field.size != 0) continue;
    return bad("record " + name_ + ", field " + field.name,
               std::string(name_of(field.kind)) + " needs more than a name and a kind",
               "use text(), enumeration() or record()");
  }
  auto fields = fields_;
  auto layout = lay_out(fields, name_);
  if (!layout) return std::move(layout).error();
  return Description::make(name_, std::move(fields), layout->size, layout->alignment);
}

namespace detail {

std::shared_ptr<const Description> make_description(std::string_view name, const RawField* fields, std::size_t count,
                                                    std::size_t size, std::size_t alignment) {
  std::vector<Field> made(count);
  for (std::size_t i = 0; i < count; ++i) {
    const RawField& raw = fields[i];
    Field& field = made[i];
    field.name = raw.name;
    field.kind = raw.kind;
    field.unit = raw.unit;
    field.offset = raw.offset;
    field.size = raw.size;
    field.stride = raw.stride;
    field.alignment = raw.alignment;
    field.count = raw.count;
    field.is_array = raw.is_array;
    field.enum_base = raw.enum_base;
    for (std::size_t v = 0; v < raw.value_count; ++v) {
      field.values.push_back({std::string(raw.values[v].name), raw.values[v].value});
    }
    if (raw.is_optional) {
      if (!raw.optional_layout_known) {
        throw SetupError(bad("record " + std::string(name) + ", field " + field.name,
                             "this standard library lays out std::optional in an unknown way", "report it to rt-data"));
      }
      field.optional = &optional_access(raw.size);
    }
    if (raw.record != nullptr) field.fields = raw.record()->fields();
  }
  return Description::make(std::string(name), std::move(made), size, alignment).or_throw();
}

}  // namespace detail
}  // namespace rtdata
