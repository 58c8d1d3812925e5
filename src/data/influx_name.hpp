// Checks names for InfluxDB lines.
#pragma once

#include <cstddef>
#include <string_view>

namespace rtdata::detail {

/// The protocol has no escape for a backslash: before an escaped character or another backslash it would be read as an
/// escape.
inline bool fits_influx_name(std::string_view text) noexcept {
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char next = i + 1 < text.size() ? text[i + 1] : ' ';
    if (text[i] == '\n' || (text[i] == '\\' && (next == ',' || next == ' ' || next == '=' || next == '\\')))
      return false;
  }
  return true;
}

}  // namespace rtdata::detail
