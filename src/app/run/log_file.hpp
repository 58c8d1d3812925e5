// Chooses the log file of a run.
#pragma once

#include <string>

#include "rtdata/config/system.hpp"

namespace rtdata::app {

/// `given`: on the command line; empty: as the configuration says, or its name with .log, in the working directory.
std::string log_file_of(const SystemPlan& plan, const std::string& given);
/// Returns false and adds a mistake to the plan if the log file conflicts with the configuration file or a sink's
/// files; adds a warning if it cannot be written.
bool check_log_file(const std::string& file, SystemPlan& plan);

}  // namespace rtdata::app
