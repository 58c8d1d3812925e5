// Text that every reader can read: UTF-8 without zero bytes, and how other bytes are written in it.
#pragma once

#include <algorithm>
#include <cstddef>
#include <string>
#include <string_view>

#include "rtdata/data/description.hpp"
#include "rtdata/data/text.hpp"

namespace rtdata::detail {

/// Bytes of the UTF-8 character at the start of `text`, which is not empty; 0 when it is none.
std::size_t utf8_size(std::string_view text) noexcept;
bool is_utf8(std::string_view text) noexcept;

/// A text for people: each byte that is no UTF-8, and each zero byte, as \xHH. There is no way back.
std::string readable(std::string_view text);
/// Whether `readable` gives the same text.
bool is_readable(std::string_view text) noexcept;

/// A text for a terminal: control characters, and bytes that are no UTF-8, as \xHH. What comes from a device, a server
/// or somebody else's file must not command the terminal. `keeps_lines`: line ends and tabs stay.
std::string visible(std::string_view text, bool keeps_lines = false);
/// The bytes of the control character at the start of `text`, which is not empty; 0: it begins with none. U+0080 to
/// U+009F are some, too.
std::size_t control_size(std::string_view text) noexcept;

/// A text of a payload, in such a way that `unescaped` gives it back: as `readable` does, and a backslash as \x5c where
/// it would be taken for the beginning of one of these (\x00, \x5c, \x80 to \xff).
void append_escaped(std::string& out, std::string_view text);
/// Whether a text is its own escaped form, as nearly all are.
bool needs_escape(std::string_view text) noexcept;
std::string unescaped(std::string_view text);
/// Whether `unescaped` changes it.
bool has_escape(std::string_view text) noexcept;

/// The byte that is written as the four characters at the start of `text`; -1 when they are none.
int escaped_byte(std::string_view text) noexcept;

/// The content of a text in a payload, at its value.
inline std::string_view text_at(const Leaf& leaf, const std::byte* value) noexcept {
  const auto length = static_cast<std::size_t>(value[0]) | static_cast<std::size_t>(value[1]) << 8;
  return {reinterpret_cast<const char*>(value) + text_length_bytes, std::min(length, leaf.size - text_length_bytes)};
}

inline constexpr std::string_view byte_order_mark = "\xef\xbb\xbf";

}  // namespace rtdata::detail
