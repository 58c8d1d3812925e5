// The parts of a configuration that a page needs.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "rtdata/config/system.hpp"

namespace rtdata::app {

/// Without the page, in a program that was built without it or on a machine that lacks its library, a file that
/// requires it has a mistake.
void check_page(SystemPlan& plan);

/// The topics of changes (machines, limits, outputs, commands), of which a page gets each event.
std::vector<std::string> topics_of_changes(const SystemPlan& plan);

/// An object of JSON: name, notes, the parts that the page draws in a special way (machines, limits, outputs) as
/// written, and the names of the sensors.
std::string page_setup(const SystemPlan& plan);

}  // namespace rtdata::app
