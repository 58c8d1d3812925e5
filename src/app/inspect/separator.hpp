// The option --separator of import and export.
#pragma once

#include <string>

namespace rtdata::app {

/// Reads a character, or "tab"; 0: neither.
inline char separator_of(const std::string& said) {
  if (said == "tab" || said == "\\t") return '\t';
  return said.size() == 1 ? said[0] : '\0';
}

}  // namespace rtdata::app
