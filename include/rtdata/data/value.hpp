/// Value: one value of a payload, of any kind, read and written through its description.
///
/// For code that works on any payload: tables, exports, configuration, limits. Typed code uses the struct itself.
///
/// Functions without state; any thread. Errors name the field's path: out-of-range, bad-argument, does-not-fit.
///
///     for (const rtdata::Leaf& leaf : description.leaves()) table.bind(leaf.path, rtdata::read(leaf, payload));
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

/// Writes a value into the payload; on error the payload does not change. No value is converted with loss: a number
/// must be in range, an integer field takes no fraction, a float field takes an integer only if it is exact, a bool
/// field takes only a bool. A double is rounded to the nearest float; NaN and infinities are values. An enumeration
/// takes the name of a value or its number. Only an optional field takes "absent".
Result<void> write(const Leaf& leaf, std::byte* payload, const Value& value);

/// As a person reads it: "absent", "true", "a", "-3", "0.1", "idle". Numbers are the shortest that read back equal.
std::string to_string(const Value& value);

/// False for an optional without a value.
bool is_present(const Leaf& leaf, const std::byte* payload) noexcept;

/// The address of a leaf's value; null if it is absent.
const std::byte* find_value(const Leaf& leaf, const std::byte* payload) noexcept;

}  // namespace rtdata
