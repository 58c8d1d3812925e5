// The place of what is on a GPIO line. Private to the program.
#pragma once

#include <string>

#include "rtdata/config/parts.hpp"

namespace rtdata::app {

/// The line as it is written, which no two sensors of a configuration may have.
inline PartPlan::Place place_of(std::string line, const std::string& chip) {
  if (!chip.empty()) line.insert(0, chip + ":");
  if (line.starts_with("/dev/")) line.erase(0, 5);
  return {"GPIO", "line " + line, ""};
}

}  // namespace rtdata::app
