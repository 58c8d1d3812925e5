// Names in messages: lists of them, and the one that was probably meant.
#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

namespace rtdata::app {

/// "room/climate, room/door": if there are many, the first ones. "nothing": an empty list.
std::string list_of(const std::set<std::string>& names);

/// The fields that can be plotted, one line per topic, and an example: `command` and the first of them.
std::string list_of_fields(const std::map<std::string, std::vector<std::string>>& by_topic, const std::string& command);

/// "did you mean room/climate?", or the list. For "rom/climate.temperature" the topic may be similar.
std::string nearest_or_all(const std::string& name, const std::vector<std::string>& known);

}  // namespace rtdata::app
