// Puts texts into a fixed size; cut texts end with "...".
#pragma once

#include <algorithm>
#include <cstddef>
#include <string_view>

#include "rtdata/data/text.hpp"

namespace rtdata::detail {

/// Puts as much of a text as fits into `most` bytes, whole characters only; what is cut ends with "...". Returns its
/// size.
inline std::size_t put_fitting(char* to, std::size_t most, std::string_view text) noexcept {
  constexpr std::string_view mark = "...";
  std::size_t size = text.size();
  if (size > most) {
    size = most - std::min(most, mark.size());
    while (size > 0 && (static_cast<unsigned char>(text[size]) & 0xc0U) == 0x80U) --size;
  }
  std::size_t end = text.copy(to, size);
  if (size < text.size()) end += mark.copy(to + end, most - end);
  return end;
}

/// The same as a text of a payload.
template <std::size_t N>
text<N> fitting(std::string_view content) noexcept {
  char bytes[N];
  return text<N>(std::string_view(bytes, put_fitting(bytes, N, content)));
}

}  // namespace rtdata::detail
