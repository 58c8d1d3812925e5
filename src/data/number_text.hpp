// Numbers as text.
#pragma once

#include <charconv>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string_view>
#include <system_error>
#include <type_traits>

namespace rtdata::detail {

inline constexpr std::size_t longest_number = 32;

/// Writes `number` if it has at most six decimals and is not very large or small; returns null otherwise. Gives the
/// same digits as std::to_chars in a fraction of the time; most readings have few decimals.
inline char* put_short_decimal(char* to, double number) {
  const double size = std::abs(number);
  if (!(size >= 1e-3 && size < 1e5)) return nullptr;  // outside, std::to_chars may write an exponent
  constexpr std::uint32_t unit = 1'000'000;
  // Two decimal numbers of at most 15 digits never give the same double, so these digits are the shortest.
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

/// True if a decimal number (not 0 and far from 1) is less than 1 in magnitude.
inline bool is_tiny(std::string_view text) noexcept {
  std::int64_t magnitude = 0;  // of its first digit that is not 0
  bool is_fraction = false, has_begun = false;
  std::size_t i = 0;
  for (; i < text.size() && text[i] != 'e' && text[i] != 'E'; ++i) {
    if (text[i] == '.') is_fraction = true;
    if (text[i] < '0' || text[i] > '9') continue;
    has_begun = has_begun || text[i] != '0';
    if (has_begun && !is_fraction) ++magnitude;
    if (!has_begun && is_fraction) --magnitude;
  }
  if (i >= text.size()) return magnitude <= 0;
  const bool is_negative = i + 1 < text.size() && text[i + 1] == '-';
  std::int64_t exponent = 0;
  for (++i; i < text.size(); ++i) {
    if (text[i] >= '0' && text[i] <= '9' && exponent < 1'000'000'000) exponent = exponent * 10 + (text[i] - '0');
  }
  return magnitude + (is_negative ? -exponent : exponent) <= 0;
}

/// Reads the whole text as the nearest number: 1e-400 is 0, -0 is 0 for unsigned types too, and a plus sign is allowed.
/// invalid_argument: not a number; result_out_of_range: too large.
template <class Number>
std::errc read_number(std::string_view text, Number& number) noexcept {
  if (text.size() > 1 && text[0] == '+' && text[1] != '-') text.remove_prefix(1);
  const auto [end, status] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (status == std::errc{} && end == text.data() + text.size() && !text.empty()) return {};
  if constexpr (std::is_floating_point_v<Number>) {
    if (status == std::errc::result_out_of_range && end == text.data() + text.size() && is_tiny(text)) {
      number = text.front() == '-' ? -Number{0} : Number{0};
      return {};
    }
  } else if constexpr (std::is_unsigned_v<Number>) {
    if (text.size() > 1 && text[0] == '-' && text.find_first_not_of('0', 1) == std::string_view::npos) {
      number = 0;
      return {};
    }
  }
  if (status == std::errc::result_out_of_range && end == text.data() + text.size()) return status;
  return std::errc::invalid_argument;
}

/// true, false, 1 and 0; upper and lower case are the same.
inline bool read_boolean(std::string_view text, bool& flag) noexcept {
  const auto is = [&](std::string_view word) {
    if (text.size() != word.size()) return false;
    for (std::size_t i = 0; i < word.size(); ++i) {
      const char c = text[i] >= 'A' && text[i] <= 'Z' ? static_cast<char>(text[i] - 'A' + 'a') : text[i];
      if (c != word[i]) return false;
    }
    return true;
  };
  flag = text == "1" || is("true");
  return flag || text == "0" || is("false");
}

}  // namespace rtdata::detail
