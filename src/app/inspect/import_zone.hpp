// Time zones by their names. Private to the program.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/time.hpp"

namespace rtdata::app {

/// Sets the zone of the process, before it has other threads. False: there is no zone of this name, such as
/// Europe/Berlin, on this machine.
bool use_zone(const std::string& name);

/// The zone in the heading of a time column, as for --zone: "-04:00" of "Date Time, GMT-04:00", "Z" of
/// "Time (UTC)". Empty: none.
std::string zone_in(std::string_view heading);

/// The times at which clocks in that zone show this time: one; two in the hour by which clocks are set back, the
/// earlier first; none in the hour by which they are put forward. `shown`: as if it was UTC.
std::vector<Time> instants_of(Time shown);

}  // namespace rtdata::app
