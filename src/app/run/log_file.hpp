// Which file the log of a run is.
#pragma once

#include <string>

#include "rtdata/config/system.hpp"

namespace rtdata::app {

/// `given`: on the command line; empty: as the configuration says, or its name with .log, in the working directory.
std::string log_file_of(const SystemPlan& plan, const std::string& given);
/// False, and a mistake in the plan, when the file is in the way of the configuration or of a sink's files, or they of
/// it; a warning when it cannot be written.
bool check_log_file(const std::string& file, SystemPlan& plan);

}  // namespace rtdata::app
