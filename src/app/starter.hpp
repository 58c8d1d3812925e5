// The text of a starter file. Private to the program.
#pragma once

#include <string>

#include "rtdata/config/parts.hpp"

namespace rtdata::app {

/// The JSON Schema that editors read, beside the starter file.
inline constexpr const char* schema_file = "rtdata.schema.json";
/// A configuration that runs on this machine as it is: sensors that exist here, sinks of the types there are. `file`
/// names its outputs.
std::string starter_file(const Registry& registry, const std::string& file);

}  // namespace rtdata::app
