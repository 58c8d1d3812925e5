// The text of a starter file. Private to the program.
#pragma once

#include <string>

#include "rtdata/config/parts.hpp"

namespace rtdata::app {

/// A configuration that runs on this machine as it is: sensors that exist here, sinks of the types there are. `file`
/// names its outputs.
std::string starter_file(const Registry& registry, const std::string& file);

}  // namespace rtdata::app
