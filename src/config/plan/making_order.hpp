// In which order parts are made. Private to src/config.
#pragma once

#include <vector>

#include "config/plan/neighbours.hpp"

namespace rtdata::config_detail {

/// Brings each part behind those that it uses, and leaves the others in their order. Parts that use each other in a
/// circle are a mistake. `neighbours` knows all of them.
void put_in_making_order(std::vector<PartPlan>& parts, const Neighbours& neighbours, Problems& problems);

}  // namespace rtdata::config_detail
