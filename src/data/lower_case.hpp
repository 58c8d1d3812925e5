// Names as SQLite compares them.
#pragma once

#include <string>

namespace rtdata::detail {

/// The letters of ASCII without their case: names that differ in it alone are one column, or one table, in a recording.
inline std::string lower_case(std::string name) {
  for (char& c : name) c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  return name;
}

}  // namespace rtdata::detail
