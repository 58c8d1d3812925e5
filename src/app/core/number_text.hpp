// Numbers as JSON has them.
#pragma once

#include <array>
#include <charconv>
#include <string>

namespace rtdata::app {

/// The shortest text that reads back as the same number. It must be finite.
template <class Number>
void append_number(std::string& text, Number number) {
  std::array<char, 32> digits;
  text.append(digits.data(), std::to_chars(digits.data(), digits.data() + digits.size(), number).ptr);
}

}  // namespace rtdata::app
