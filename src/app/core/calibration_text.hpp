// The line of a calibration's points, as readable text.
#pragma once

#include <charconv>
#include <cmath>
#include <string>

#include "rtdata/process/processing.hpp"

namespace rtdata::app {

inline constexpr int digits_of_line = 6;

/// The number with at most this many significant digits.
inline std::string number_text(double number, int digits = digits_of_line) {
  char buffer[40];
  return {buffer, std::to_chars(buffer, buffer + sizeof buffer, number, std::chars_format::general, digits).ptr};
}

/// The nearest number with this many digits, short enough for files and people.
inline double rounded(double number, int digits) {
  const std::string text = number_text(number, digits);
  double result = number;
  std::from_chars(text.data(), text.data() + text.size(), result);
  return result;
}

/// "0.1962 * raw - 24.2111"
inline std::string line_text(const CalibrationLine& line) {
  const double offset = line.value(0);
  return number_text(line.slope) + " * raw " + (offset < 0 ? "- " : "+ ") + number_text(std::abs(offset));
}

}  // namespace rtdata::app
