// A `char` of a payload is a number from 0 to 255, for signed (x86) and unsigned (ARM) `char`. In text it is the
// Unicode character with that number.
#pragma once

#include <optional>
#include <string>
#include <string_view>

namespace rtdata::detail {

/// In UTF-8.
inline std::string utf8_of(char character) {
  const auto code = static_cast<unsigned char>(character);
  if (code < 0x80) return {character};
  return {static_cast<char>(0xc0 | code >> 6), static_cast<char>(0x80 | (code & 0x3f))};
}

/// The character of a UTF-8 text of one character up to U+00FF; a single byte is taken as it is.
inline std::optional<char> character_of(std::string_view text) {
  if (text.size() == 1) return text[0];
  const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(text[i]); };
  if (text.size() != 2 || (byte(0) & 0xfe) != 0xc2 || (byte(1) & 0xc0) != 0x80) return std::nullopt;
  return static_cast<char>((byte(0) & 0x03) << 6 | (byte(1) & 0x3f));
}

}  // namespace rtdata::detail
