/// Value: one value of a payload, of any kind, read and written through its description.
///
/// For code that works on any payload: tables, exports, configuration, limits. Typed code uses the struct itself.
///
/// Functions without state; any thread. Errors name the field's path: out_of_range, bad_argument, does_not_fit.
///
///     for (const Leaf& leaf : description.leaves()) table.bind(leaf.path, read(leaf, payload));
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <variant>

#include "rtdata/data/description.hpp"

namespace rtdata {

/// std::monostate is an absent optional. A float is held exactly, as a double. An enumeration is its name, or its
/// number when the number has no name.
using Value = std::variant<std::monostate, bool, char, std::int64_t, std::uint64_t, double, std::string>;

/// The value of a leaf in the payload that starts at `payload`. Signed integers come as int64, unsigned ones as uint64.
Value read(const Leaf& leaf, const std::byte* payload);

/// Puts a value in its place; on error the payload stays as it was. Nothing is narrowed in silence: a number must be in
/// the range of its place, a fraction does not go into an integer, an integer goes into a float only when that holds it
/// exactly, only a bool goes into a bool. A double is rounded to the nearest float; NaN and infinities are values.
/// An enumeration takes the name of a value or its number. Absent goes into an optional only.
Result<void> write(const Leaf& leaf, std::byte* payload, const Value& value);

/// As a person reads it: "absent", "true", "a", "-3", "0.1", "idle". Numbers are the shortest that read back equal.
std::string to_string(const Value& value);

/// Whether the leaf is there: false for an optional that has no value.
bool is_present(const Leaf& leaf, const std::byte* payload) noexcept;

/// Where the value of a leaf lies; null when it is absent.
const std::byte* find_value(const Leaf& leaf, const std::byte* payload) noexcept;

}  // namespace rtdata
