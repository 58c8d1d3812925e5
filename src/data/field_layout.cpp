#include "data/field_layout.hpp"

#include <algorithm>
#include <charconv>

#include "data/load.hpp"
#include "rtdata/data/text.hpp"

namespace rtdata::detail {
namespace {

std::size_t alignment_of(Kind kind) {
  return is_number_kind(kind) ? for_number(kind, [](auto zero) { return alignof(decltype(zero)); }) : 1;
}

std::size_t round_up(std::size_t value, std::size_t alignment) {
  return (value + alignment - 1) / alignment * alignment;
}

}  // namespace

Error not_usable(std::string where, std::string why, std::string advice) {
  return {Errc::bad_description, "the description is not usable", std::move(where), std::move(why), std::move(advice)};
}

std::size_t size_of(Kind kind) {
  if (kind == Kind::boolean || kind == Kind::character) return 1;
  return is_number_kind(kind) ? for_number(kind, [](auto zero) { return sizeof zero; }) : 0;
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
  // Keeps an invalid capacity invalid, so that check() refuses it.
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

Field finished(Field field, DescriptionBuilder::Presence presence) {
  field.stride = field.size;
  if (presence == DescriptionBuilder::Presence::optional) {
    field.optional = &optional_access(field.size);
    field.stride = round_up(field.size + 1, field.alignment);
  }
  return field;
}

Result<Layout> lay_out(std::vector<Field>& fields, const std::string& name) {
  Layout layout;
  for (Field& field : fields) {
    if (field.size > largest_payload || field.count > largest_payload || field.stride > largest_payload) {
      return not_usable("record " + name + ", field " + field.name, "it is too large", "make it smaller");
    }
    field.offset = round_up(layout.size, field.alignment);
    layout.size = field.offset + field.stride * field.count;
    layout.alignment = std::max(layout.alignment, field.alignment);
    if (layout.size > largest_payload) {
      return not_usable("record " + name + ", field " + field.name,
                        "the payload would be larger than " + std::to_string(largest_payload) + " bytes",
                        "make it smaller");
    }
  }
  layout.size = std::max<std::size_t>(1, round_up(layout.size, layout.alignment));
  return layout;
}

const Field* field_at(const std::vector<Field>& fields, std::string_view path) noexcept {
  const std::size_t name_end = std::min(path.find_first_of(".["), path.size());
  const auto field = std::find_if(fields.begin(), fields.end(),
                                  [&](const Field& one) { return one.name == path.substr(0, name_end); });
  if (field == fields.end()) return nullptr;
  path.remove_prefix(name_end);
  bool is_element = !field->is_array;
  if (path.starts_with('[')) {
    std::size_t index = 0;
    const auto parsed = std::from_chars(path.data() + 1, path.data() + path.size(), index);
    const auto digits = static_cast<std::size_t>(parsed.ptr - path.data());
    if (parsed.ec != std::errc() || !field->is_array || index >= field->count || digits >= path.size() ||
        path[digits] != ']' || (path[1] == '0' && digits != 2))
      return nullptr;
    path.remove_prefix(digits + 1);
    is_element = true;
  }
  if (path.empty()) return field->kind != Kind::record ? &*field : nullptr;
  return path.front() == '.' && field->kind == Kind::record && is_element ? field_at(field->fields, path.substr(1))
                                                                          : nullptr;
}

}  // namespace rtdata::detail
