// The place of a part on a GPIO line. Private to the program.
#pragma once

#include <string>

#include "rtdata/config/parts.hpp"

namespace rtdata::app {

/// The line as written in the file; only one sensor of a configuration may use it.
inline PartPlan::Place place_of(std::string line, const std::string& chip) {
  if (!chip.empty()) line.insert(0, chip + ":");
  if (line.starts_with("/dev/")) line.erase(0, 5);
  return {"GPIO", "line " + line, ""};
}

}  // namespace rtdata::app
