// Where a GPIO line is, without taking it.
#pragma once

#include <string>
#include <vector>

#include "rtdata/io/gpio.hpp"

namespace rtdata::detail {

struct FoundLine {
  std::string text;  ///< "gpiochip0:17 (GPIO17)"
  GpioLineInfo line;
};

/// Errors: those of taking it, as far as they are seen before (not-found, bad-argument, not-permitted).
Result<FoundLine> find_gpio_line(std::vector<GpioChipInfo> chips, const GpioLineName& line, const std::string& chip);

}  // namespace rtdata::detail
