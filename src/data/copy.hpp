// Copies and compares a few bytes without the function calls of std::memcpy and std::memcmp for unknown sizes.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string_view>

namespace rtdata::detail {

inline constexpr std::size_t few_bytes = 64;

/// Like std::memcpy, of at most `few_bytes`. Returns the end.
template <class Byte>
[[gnu::always_inline]] inline Byte* copy_few(Byte* to, const void* data, std::size_t size) {
  const auto* from = static_cast<const char*>(data);
  const auto both_ends = [&]<std::size_t part>(std::integral_constant<std::size_t, part>) {
    std::memcpy(to, from, part);
    std::memcpy(to + size - part, from + size - part, part);
  };
  if (size > 32) {
    both_ends(std::integral_constant<std::size_t, 32>{});
  } else if (size > 16) {
    both_ends(std::integral_constant<std::size_t, 16>{});
  } else if (size >= 8) {
    both_ends(std::integral_constant<std::size_t, 8>{});
  } else if (size >= 4) {
    both_ends(std::integral_constant<std::size_t, 4>{});
  } else {
    for (std::size_t i = 0; i < size; ++i) to[i] = static_cast<Byte>(from[i]);
  }
  return to + size;
}

/// Like std::memcpy. Returns the end.
template <class Byte>
Byte* copy_short(Byte* to, const void* data, std::size_t size) {
  if (size <= few_bytes) return copy_few(to, data, size);
  std::memcpy(to, data, size);
  return to + size;
}

/// Like operator==, which it uses for more than 16 bytes.
inline bool equal_short(std::string_view a, std::string_view b) {
  if (a.size() != b.size()) return false;
  const auto word = []<class Word>(const char* at, Word) {
    Word bytes;
    std::memcpy(&bytes, at, sizeof bytes);
    return bytes;
  };
  const auto both_ends = [&]<class Word>(Word kind) {
    const std::size_t last = a.size() - sizeof kind;
    return word(a.data(), kind) == word(b.data(), kind) && word(a.data() + last, kind) == word(b.data() + last, kind);
  };
  if (a.size() > 16) return std::memcmp(a.data(), b.data(), a.size()) == 0;
  if (a.size() >= 8) return both_ends(std::uint64_t{});
  if (a.size() >= 4) return both_ends(std::uint32_t{});
  for (std::size_t i = 0; i < a.size(); ++i)
    if (a[i] != b[i]) return false;
  return true;
}

}  // namespace rtdata::detail
