// Fields without a C++ type: made of kinds, laid out as a compiler would.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/description.hpp"

namespace rtdata::detail {

inline constexpr std::size_t largest_payload = std::size_t{1} << 24;
inline constexpr int deepest_record = 16;

/// By the number of the kind.
inline constexpr std::string_view kind_names[] = {"bool",  "char",   "int8",   "int16",  "int32",
                                                  "int64", "uint8",  "uint16", "uint32", "uint64",
                                                  "float", "double", "text",   "enum",   "record"};

Error not_usable(std::string where, std::string why, std::string advice = {});

/// Bytes of an integer, a float, a bool or a char; 0 for the others.
std::size_t size_of(Kind kind);
inline bool is_integer_kind(Kind kind) { return kind >= Kind::i8 && kind <= Kind::u64; }
inline bool is_number_kind(Kind kind) { return kind >= Kind::i8 && kind <= Kind::f64; }

// Fields, not yet `finished`.
Field plain_field(std::string name, Kind kind, std::string unit);
Field text_field(std::string name, std::size_t capacity);
Field enum_field(std::string name, std::vector<EnumValue> values, Kind base);
Field record_field(std::string name, std::vector<Field> fields, std::size_t size, std::size_t alignment);
Field array_of(Field field, std::size_t count);
/// Adds the stride and the space for the presence flag.
Field finished(Field field, DescriptionBuilder::Presence presence);

struct Layout {
  std::size_t size = 0;
  std::size_t alignment = 1;
};

/// Puts the fields one after the other as a C++ compiler does. `name`: of their record.
Result<Layout> lay_out(std::vector<Field>& fields, const std::string& name);

/// The value, or array of values, with this path: "position.x", "accel", "accel[1]", "cells[0].voltage". Null: there is
/// none, or it is a record.
const Field* field_at(const std::vector<Field>& fields, std::string_view path) noexcept;

}  // namespace rtdata::detail
