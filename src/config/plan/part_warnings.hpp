// What is worth saying of parts beside each other that have no mistake. Private to src/config.
#pragma once

#include <string>
#include <vector>

#include "config/plan/neighbours.hpp"

namespace rtdata::config_detail {

/// Patterns of sinks that match no topic.
void warn_of_patterns(const std::vector<PartPlan>& parts, const Neighbours& neighbours, Problems& warnings);
/// C and F are coulomb and farad, which no temperature has.
void warn_of_units(const std::vector<PartPlan>& parts, Problems& warnings);
/// Recordings in memory that others go through.
void warn_of_recordings(const std::vector<PartPlan>& parts, Problems& warnings);
/// Two sinks that send events of one topic to one server.
void warn_of_senders(const std::vector<PartPlan>& parts, const Neighbours& neighbours, Problems& warnings);
/// Tiers on which nothing runs.
void warn_of_tiers(const std::vector<PartPlan>& parts, Problems& warnings);
/// Loops and lanes that have too much to do. `main_loop`: its name.
void warn_of_load(const std::vector<PartPlan>& parts, const std::string& main_loop, Problems& warnings);
/// The load of each loop that has sensors: the main loop, then the tiers in the order of their names.
std::vector<LoopLoad> loads_of(const std::vector<PartPlan>& parts, const std::string& main_loop);

}  // namespace rtdata::config_detail
