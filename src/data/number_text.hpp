// Numbers as text.
#pragma once

#include <charconv>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace rtdata::detail {

inline constexpr std::size_t longest_number = 32;

/// The digits of `number` when it is a decimal number of at most six decimals, not very large or small; null when not.
/// They are those of std::to_chars, for a fraction of the time: readings mostly have few decimals.
inline char* put_short_decimal(char* to, double number) {
  const double size = std::abs(number);
  if (!(size >= 1e-3 && size < 1e5)) return nullptr;  // outside, std::to_chars may write an exponent
  constexpr std::uint32_t unit = 1'000'000;
  // Two decimal numbers of at most 15 digits are never the same double, so if this is the one then its digits are the
  // shortest.
  const auto millionths = static_cast<std::int64_t>(size * unit + 0.5);
  if (static_cast<double>(millionths) / unit != size) return nullptr;
  if (number < 0) *to++ = '-';
  to = std::to_chars(to, to + longest_number, static_cast<std::uint32_t>(millionths / unit)).ptr;
  auto rest = static_cast<std::uint32_t>(millionths % unit);
  if (rest == 0) return to;
  *to++ = '.';
  for (; rest != 0; rest = rest * 10 % unit) *to++ = static_cast<char>('0' + rest * 10 / unit);
  return to;
}

/// The shortest digits that read back as the same number; at most `longest_number`. Returns the end.
template <class Number>
char* put_number(char* to, Number number) {
  if constexpr (std::is_same_v<Number, double>) {
    if (char* end = put_short_decimal(to, number)) return end;
  }
  return std::to_chars(to, to + longest_number, number).ptr;
}

}  // namespace rtdata::detail
