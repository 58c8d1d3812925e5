// Copies a few bytes with a fixed size, if further bytes follow.
#pragma once

#include <cstddef>
#include <cstring>

namespace rtdata::detail {

inline constexpr std::size_t padding = 16;

/// Like std::memcpy, where `padding` bytes more may be read and written. Returns the end.
[[gnu::always_inline]] inline char* copy_padded(char* to, const char* from, std::size_t size) {
  std::memcpy(to, from, padding);
  if (size > padding) [[unlikely]]
    std::memcpy(to + padding, from + padding, size - padding);
  return to + size;
}

}  // namespace rtdata::detail
