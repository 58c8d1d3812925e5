// Copying of a few bytes, without the call that std::memcpy of a size unknown to the compiler is.
#pragma once

#include <cstddef>
#include <cstring>

namespace rtdata::detail {

/// Like std::memcpy, which it is for more than 16 bytes. Returns the end.
template <class Byte>
Byte* copy_short(Byte* to, const void* data, std::size_t size) {
  const auto* from = static_cast<const char*>(data);
  const auto both_ends = [&]<std::size_t part>(std::integral_constant<std::size_t, part>) {
    std::memcpy(to, from, part);
    std::memcpy(to + size - part, from + size - part, part);
  };
  if (size > 16) {
    std::memcpy(to, from, size);
  } else if (size >= 8) {
    both_ends(std::integral_constant<std::size_t, 8>{});
  } else if (size >= 4) {
    both_ends(std::integral_constant<std::size_t, 4>{});
  } else {
    for (std::size_t i = 0; i < size; ++i) to[i] = static_cast<Byte>(from[i]);
  }
  return to + size;
}

}  // namespace rtdata::detail
