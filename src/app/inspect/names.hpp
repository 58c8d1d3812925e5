// Names in messages: lists of them, and which was probably meant.
#pragma once

#include <set>
#include <string>
#include <vector>

namespace rtdata::app {

/// "room/climate, room/door": of many the first. "nothing": of none.
std::string list_of(const std::set<std::string>& names);

/// "did you mean room/climate?", or which there are. Of "rom/climate.temperature" the topic may be near.
std::string nearest_or_all(const std::string& name, const std::vector<std::string>& known);

}  // namespace rtdata::app
