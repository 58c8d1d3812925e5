// Numbers in payloads, for expressions and limits.
#pragma once

#include <cstddef>
#include <optional>
#include <string_view>

#include "rtdata/data/description.hpp"

namespace rtdata::detail {

/// The field at this path, if it is a number, a boolean or an enumeration. An empty path means the field `value`, or
/// else the only number that there is. Null otherwise.
const Leaf* number_field(const Description& description, std::string_view path) noexcept;

/// The value: 1 or 0 for a boolean, the number of an enumeration. Empty: absent.
std::optional<double> number_in(const Leaf& field, const std::byte* payload) noexcept;

}  // namespace rtdata::detail
