// Time zones by their names. Private to the program.
#pragma once

#include <string>
#include <vector>

#include "rtdata/data/time.hpp"

namespace rtdata::app {

/// Makes the zone that of the process, before it has other threads. False: there is no zone of this name, such as
/// Europe/Berlin, on this machine.
bool use_zone(const std::string& name);

/// When clocks in that zone show this time: once; twice in the hour by which they are set back, the earlier first;
/// never in the hour by which they are put forward. `shown`: as if it was UTC.
std::vector<Time> instants_of(Time shown);

}  // namespace rtdata::app
