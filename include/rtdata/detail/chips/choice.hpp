/// For drivers: a setting for which a chip allows only some numbers, such as rates.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <optional>

namespace rtdata::detail {

/// The index of `number` in the chip's list, which is also its code in the register. Empty: the chip does not have it.
template <class T, std::size_t N>
std::optional<unsigned> place_of(const std::array<T, N>& all, T one) noexcept {
  const auto found = std::find(all.begin(), all.end(), one);
  if (found == all.end()) return std::nullopt;
  return static_cast<unsigned>(found - all.begin());
}

}  // namespace rtdata::detail
