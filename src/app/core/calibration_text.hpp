// The line of a calibration's points, for people.
#pragma once

#include <charconv>
#include <cmath>
#include <string>

#include "rtdata/process/processing.hpp"

namespace rtdata::app {

inline constexpr int digits_of_line = 6;

/// With so many significant digits at most.
inline std::string number_text(double number, int digits = digits_of_line) {
  char buffer[40];
  return {buffer, std::to_chars(buffer, buffer + sizeof buffer, number, std::chars_format::general, digits).ptr};
}

/// The nearest number of so many digits, which files and people can hold.
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
