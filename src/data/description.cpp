#include "rtdata/data/description.hpp"

#include <algorithm>
#include <atomic>
#include <cstring>
#include <map>
#include <mutex>
#include <set>
#include <utility>

#include "data/field_layout.hpp"
#include "data/load.hpp"
#include "data/lower_case.hpp"
#include "data/name_in.hpp"
#include "data/nearest.hpp"
#include "data/utf8.hpp"
#include "rtdata/data/describe.hpp"
#include "rtdata/data/text.hpp"

namespace rtdata {

using namespace detail;

namespace {

constexpr std::size_t most_leaves = 65536;

bool fits(std::int64_t value, Kind base) {
  return base == Kind::u64 ||  // kept bit for bit
         for_integer(base, [value](auto zero) { return std::in_range<decltype(zero)>(value); });
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

/// Stands in headers, tables and JSON.
bool is_good_text(std::string_view text) { return is_readable(text) && !needs_escape(text); }

std::string listed_values(const std::vector<EnumValue>& values) {
  std::string text;
  for (const auto& value : values) text += (text.empty() ? "" : ", ") + value.name + "=" + std::to_string(value.value);
  return text;
}

/// "pressure.raw": a field added to the value "pressure"; there can be no record "pressure" then.
bool is_added_name(std::string_view name, const std::vector<Field>& fields) {
  const auto dot = name.rfind('.');
  return dot != std::string_view::npos && is_name(name.substr(dot + 1)) && field_at(fields, name.substr(0, dot));
}

/// Checks one record (names, shapes, sizes), then its nested records. `where` ends with a dot unless empty.
Result<void> check(const std::vector<Field>& fields, std::size_t size, const std::string& where, int depth) {
  if (depth > deepest_record) {
    return not_usable(where, "records are nested more than " + std::to_string(deepest_record) + " deep",
                      "flatten them");
  }
  std::set<std::string> seen;
  for (const Field& field : fields) {
    const std::string path = where + field.name;
    const std::string place = "field " + path;
    if (!is_name(field.name) && !(where.empty() && is_added_name(field.name, fields))) {
      return not_usable("field \"" + path + "\"",
                        "a field name has letters, digits and underscores and does not start with a digit",
                        "rename it");
    }
    if (!seen.insert(lower_case(field.name)).second) {
      return not_usable(place, "the name is there twice (upper and lower case count as the same)",
                        "rename one of them");
    }
    if (where.empty()) {
      for (const std::string_view taken : {"time", "origin", "sequence", "run"}) {
        if (lower_case(field.name) == taken) {
          return not_usable(place, "every event has a " + std::string(taken) + " of its own",
                            "rename the field, for example to device_" + std::string(taken));
        }
      }
      if (lower_case(field.name) == "_rowid_")
        return not_usable(place, "SQLite has that name for the number of a row", "rename the field");
    }
    if (field.count == 0 || (!field.is_array && field.count != 1)) {
      return not_usable(place, "an array needs at least one element", "give it a count");
    }
    if (!is_good_text(field.unit)) return not_usable(place, "its unit is not UTF-8", "write it in UTF-8");
    std::size_t expected = size_of(field.kind);
    if (field.kind == Kind::enumeration) {
      if (!is_integer_kind(field.enum_base))
        return not_usable(place, "an enumeration is stored as an integer", "change `base`");
      if (field.values.empty()) return not_usable(place, "an enumeration needs at least one value", "add `values`");
      expected = size_of(field.enum_base);
      std::set<std::string> names;
      std::set<std::int64_t> numbers;
      for (const EnumValue& value : field.values) {
        if (!is_good_text(value.name))
          return not_usable(place, "the name of a value is not UTF-8", "write it in UTF-8");
        if (value.name.empty()) return not_usable(place, "a value of the enumeration has no name", "name it");
        if (!names.insert(value.name).second) {
          return not_usable(place, "the value " + value.name + " is there twice", "rename one of them");
        }
        if (!numbers.insert(value.value).second) {
          return not_usable(place, "two values have the number " + std::to_string(value.value), "give each its own");
        }
        if (!fits(value.value, field.enum_base)) {
          return not_usable(place,
                            std::to_string(value.value) + " does not fit into " + std::string(name_of(field.enum_base)),
                            "use a larger `base`");
        }
      }
    } else if (!field.values.empty()) {
      return not_usable(place, "only an enumeration has values", "remove them, or make it an enum");
    }
    if (field.kind == Kind::text) {
      if (field.size <= text_length_bytes || field.size > 65535 + text_length_bytes) {
        return not_usable(place, "a text holds between 1 and 65535 bytes", "change its capacity");
      }
      expected = field.size;
    }
    if (field.kind == Kind::record) {
      if (field.optional != nullptr)
        return not_usable(place, "a record cannot be optional", "make its fields optional");
      expected = field.size;
    } else if (!field.fields.empty()) {
      return not_usable(place, "only a record has fields of its own", "make its type \"record\"");
    }
    if (field.size != expected || field.size > largest_payload || field.count > largest_payload) {
      return not_usable(place, std::to_string(field.size) + " bytes is not a possible size for a " + shape(field),
                        "change it");
    }
    const std::size_t least = field.size + (field.optional != nullptr ? 1 : 0);
    if (field.stride < least || field.stride > largest_payload || field.offset > size ||
        field.stride * field.count > size - field.offset) {
      return not_usable(place, "it lies outside the " + std::to_string(size) + " bytes of its record",
                        "make the payload smaller");
    }
    if (field.optional != nullptr && field.optional->value_size != field.size) {
      return not_usable(place, "its optional access is for another size", "use optional_access(size)");
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
      lines.push_back(what + "values " + listed_values(mine.values) + " here, " + listed_values(other->values) +
                      " there");
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

}  // namespace

std::string_view name_of(Kind kind) noexcept { return name_in(kind_names, kind); }

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
                                                             std::size_t size, std::size_t alignment,
                                                             bool is_of_changes) {
  if (!is_name(name)) {
    return not_usable("record \"" + name + "\"",
                      "a record's name has letters, digits and underscores and does not start with a digit",
                      "rename it");
  }
  if (size == 0 || size > largest_payload || alignment == 0 || (alignment & (alignment - 1)) != 0) {
    return not_usable("record " + name, "a payload of " + std::to_string(size) + " bytes is not possible",
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
  made->is_of_changes_ = is_of_changes;
  if (!add_leaves(made->fields_, 0, "", made->leaves_)) {
    return not_usable("record " + made->name_, "it has more than " + std::to_string(most_leaves) + " values",
                      "use fewer");
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

namespace detail {

std::shared_ptr<const Description> make_description(std::string_view name, const RawField* fields, std::size_t count,
                                                    std::size_t size, std::size_t alignment, bool is_of_changes) {
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
        throw SetupError(not_usable("record " + std::string(name) + ", field " + field.name,
                                    "this standard library lays out std::optional in an unknown way",
                                    "report it to rt-data"));
      }
      field.optional = &optional_access(raw.size);
    }
    if (raw.record != nullptr) field.fields = raw.record()->fields();
  }
  return Description::make(std::string(name), std::move(made), size, alignment, is_of_changes).or_throw();
}

}  // namespace detail
}  // namespace rtdata
