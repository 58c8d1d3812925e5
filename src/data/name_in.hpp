// The names of enumerators, as a table in their order.
#pragma once

#include <cstddef>
#include <string_view>

namespace rtdata::detail {

/// The name at the place of a value; `unknown` for a value that is no enumerator.
template <class Enum, std::size_t count>
constexpr std::string_view name_in(const std::string_view (&names)[count], Enum value,
                                   std::string_view unknown = "unknown") noexcept {
  const auto place = static_cast<std::size_t>(value);
  return place < count ? names[place] : unknown;
}

}  // namespace rtdata::detail
