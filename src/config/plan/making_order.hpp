// The order in which parts are made. Private to src/config.
#pragma once

#include <vector>

#include "config/plan/neighbours.hpp"

namespace rtdata::config_detail {

/// Sorts the parts topologically: each comes after the parts that it uses, otherwise they keep their order. Parts that
/// use each other in a cycle are a mistake, which is reported. All parts must have been added to `neighbours`.
void put_in_making_order(std::vector<PartPlan>& parts, const Neighbours& neighbours, Problems& problems);

}  // namespace rtdata::config_detail
