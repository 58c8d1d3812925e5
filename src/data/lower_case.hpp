// Texts without their case; names as SQLite compares them.
#pragma once

#include <string>
#include <string_view>

namespace rtdata::detail {

/// The letters of ASCII without their case: names that differ in it alone are one column, or one table, in a recording.
inline std::string lower_case(std::string_view text) {
  std::string name(text);
  for (char& c : name) c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  return name;
}

}  // namespace rtdata::detail
