// The text of a starter file. Private to the program.
#pragma once

#include <string>

#include "app/machine/machine_files.hpp"
#include "rtdata/config/registry.hpp"

namespace rtdata::app {

/// The JSON Schema that editors read, beside the starter file.
inline constexpr const char* schema_file = "rtdata.schema.json";
/// A configuration that runs on this machine as it is, also for months: sensors that exist here, at gentle rates, sinks
/// of the types there are, with limits. `file` names its outputs. `root`: of the machine's files.
std::string starter_file(const Registry& registry, const std::string& file, const std::string& root = "");

}  // namespace rtdata::app
