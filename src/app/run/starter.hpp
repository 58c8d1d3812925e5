// The text of a starter file. Private to the program.
#pragma once

#include <string>

#include "app/machine/machine_files.hpp"
#include "rtdata/config/registry.hpp"

namespace rtdata::app {

/// The JSON Schema for editors, written beside the starter file.
inline constexpr const char* schema_file = "rtdata.schema.json";
/// A configuration that runs on this machine without changes, also for months: existing sensors at low rates, and
/// available sinks with limits. `file` gives the names of its output files. `root`: of the machine's files.
std::string starter_file(const Registry& registry, const std::string& file, const std::string& root = "");

}  // namespace rtdata::app
