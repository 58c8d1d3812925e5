// Which file the log of a run is.
#pragma once

#include <string>

#include "rtdata/config/system.hpp"

namespace rtdata::app {

/// `given`: on the command line; empty: as the configuration says, or its name with .log, in the working directory.
std::string log_file_of(const SystemPlan& plan, const std::string& given);
/// Adds a mistake to the plan when the file is the configuration's or a sink's, a warning when it cannot be written.
void check_log_file(const std::string& file, SystemPlan& plan);

}  // namespace rtdata::app
