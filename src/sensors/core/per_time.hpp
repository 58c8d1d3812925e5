// Speeds in units and times that the user chooses: "L" per "min".
#pragma once

#include <string>

namespace rtdata::detail {

/// `per`: "s", "min", "h".
inline double seconds_of(const std::string& per) { return per == "h" ? 3600 : per == "min" ? 60 : 1; }

/// UCUM.
inline std::string unit_of_speed(const std::string& unit, const std::string& per) {
  const bool is_simple = unit.find_first_of("./") == std::string::npos;
  return (is_simple ? unit : "(" + unit + ")") + "/" + per;
}

}  // namespace rtdata::detail
