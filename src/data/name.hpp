// Names of sensors and tiers, shown to people and stored in recordings.
#pragma once

#include <algorithm>
#include <string>
#include <string_view>

#include "data/utf8.hpp"

namespace rtdata::detail {

inline constexpr const char* name_rule = "a name has 1 to 200 characters of UTF-8 and no control characters";

inline bool is_control(unsigned char c) noexcept { return c < ' ' || c == 0x7f; }
inline bool has_control(std::string_view text) noexcept {
  for (; !text.empty(); text.remove_prefix(1))
    if (control_size(text) > 0) return true;
  return false;
}

/// True if the name follows the rule.
inline bool is_name(std::string_view name) noexcept {
  return !name.empty() && name.size() <= 200 && !has_control(name) && is_utf8(name);
}

/// A possibly invalid name, in quotes, for one line of text.
inline std::string quoted_name(std::string_view name) {
  std::string text(name.substr(0, 200));
  std::replace_if(text.begin(), text.end(), is_control, '?');
  return "\"" + text + "\"";
}

}  // namespace rtdata::detail
