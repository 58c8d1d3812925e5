// One item of a configuration, planned by its registry. Private to src/config.
#pragma once

#include "rtdata/config/parts.hpp"

namespace rtdata::config_detail {

/// The plan of one item; what is wrong with it by itself is added to `problems`. False when there is no plan.
bool plan_sensor(const Registry& registry, const ConfigItem& item, SensorPlan& plan, Problems& problems);
bool plan_sink(const Registry& registry, const ConfigItem& item, SinkPlan& plan, Problems& problems);

}  // namespace rtdata::config_detail
