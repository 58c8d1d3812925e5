// Durations as readable text: two digits, or all digits of a whole number.
#pragma once

#include <array>
#include <cmath>
#include <cstdio>
#include <string>

namespace rtdata::detail {

/// "1.4 ms", "2 ms", "333 us".
inline std::string rounded_time(double nanoseconds) {
  double value = nanoseconds;
  const char* unit = "ns";
  for (const char* larger : {"us", "ms", "s"}) {
    if (value < 1000) break;
    value /= 1000;
    unit = larger;
  }
  std::array<char, 32> text{};
  const bool has_tenths = value < 10 && *unit != 'n' && std::lround(10 * value) % 10 != 0;
  std::snprintf(text.data(), text.size(), has_tenths ? "%.1f %s" : "%.0f %s", value, unit);
  return text.data();
}

}  // namespace rtdata::detail
