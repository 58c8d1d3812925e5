/// For drivers: a setting that a chip has for some numbers only, such as its rates.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <optional>

namespace rtdata::detail {

/// Where the number is among those that the chip has, which are the bits that choose it; none: it has not got it.
template <class T, std::size_t N>
std::optional<unsigned> place_of(const std::array<T, N>& all, T one) noexcept {
  const auto found = std::find(all.begin(), all.end(), one);
  if (found == all.end()) return std::nullopt;
  return static_cast<unsigned>(found - all.begin());
}

}  // namespace rtdata::detail
