// UTF-8 text without zero bytes, and the escapes for other bytes.
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

/// A text for display: each byte that is not UTF-8, and each zero byte, becomes \xHH. Cannot be undone.
std::string readable(std::string_view text);
/// True if `readable` does not change the text.
bool is_readable(std::string_view text) noexcept;

/// A text for a terminal: control characters, and bytes that are not UTF-8, become \xHH, because text from a device, a
/// server or another file must not control the terminal. `keeps_lines`: keeps line ends and tabs.
std::string visible(std::string_view text, bool keeps_lines = false);
/// The size of the control character at the start of `text`, which is not empty; 0: none. U+0080 to U+009F are control
/// characters too.
std::size_t control_size(std::string_view text) noexcept;

/// Appends a text of a payload so that `unescaped` restores it: like `readable`, and with \x5c for a backslash that
/// would look like the start of an escape (\x00, \x5c, \x80 to \xff).
void append_escaped(std::string& out, std::string_view text);
/// True if escaping changes the text, which is rare.
bool needs_escape(std::string_view text) noexcept;
std::string unescaped(std::string_view text);
/// True if `unescaped` changes the text.
bool has_escape(std::string_view text) noexcept;

/// The byte of the escape at the start of `text`; -1: no escape.
int escaped_byte(std::string_view text) noexcept;

/// The content of a text in a payload, at its value.
inline std::string_view text_at(const Leaf& leaf, const std::byte* value) noexcept {
  const auto length = static_cast<std::size_t>(value[0]) | static_cast<std::size_t>(value[1]) << 8;
  return {reinterpret_cast<const char*>(value) + text_length_bytes, std::min(length, leaf.size - text_length_bytes)};
}

inline constexpr std::string_view byte_order_mark = "\xef\xbb\xbf";

}  // namespace rtdata::detail
