// Finds a GPIO line without opening it.
#pragma once

#include <string>
#include <vector>

#include "rtdata/io/gpio.hpp"

namespace rtdata::detail {

struct FoundLine {
  std::string text;  ///< "gpiochip0:17 (GPIO17)"
  GpioLineInfo line;
};

/// Errors: those of opening it, as far as known before (not-found, bad-argument, not-permitted).
Result<FoundLine> find_gpio_line(std::vector<GpioChipInfo> chips, const GpioLineName& line, const std::string& chip);

}  // namespace rtdata::detail
