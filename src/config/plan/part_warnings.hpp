// Warnings about combinations of valid parts. Private to src/config.
#pragma once

#include <string>
#include <vector>

#include "config/plan/neighbours.hpp"

namespace rtdata::config_detail {

/// Patterns of sinks that match no topic.
void warn_of_patterns(const std::vector<PartPlan>& parts, const Neighbours& neighbours, Problems& warnings);
/// Temperatures in C or F, which are coulomb and farad in UCUM.
void warn_of_units(const std::vector<PartPlan>& parts, Problems& warnings);
/// Recordings in memory that other sinks use for `through`.
void warn_of_recordings(const std::vector<PartPlan>& parts, Problems& warnings);
/// Two sinks that send events of one topic to one server.
void warn_of_senders(const std::vector<PartPlan>& parts, const Neighbours& neighbours, Problems& warnings);
/// Tiers on which nothing runs.
void warn_of_tiers(const std::vector<PartPlan>& parts, Problems& warnings);
/// Overloaded loops and lanes. `main_loop`: its name.
void warn_of_load(const std::vector<PartPlan>& parts, const std::string& main_loop, Problems& warnings);
/// The load of each loop that has sensors: the main loop, then the tiers in the order of their names.
std::vector<LoopLoad> loads_of(const std::vector<PartPlan>& parts, const std::string& main_loop);

}  // namespace rtdata::config_detail
