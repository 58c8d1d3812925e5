// Texts without their case; names as SQLite compares them.
#pragma once

#include <string>
#include <string_view>

namespace rtdata::detail {

/// Converts ASCII letters to lower case: names that differ only in case are the same column or table in a recording.
inline std::string lower_case(std::string_view text) {
  std::string name(text);
  for (char& c : name) c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  return name;
}

}  // namespace rtdata::detail
