// What waits in a recording for a sender that nobody runs any more.
#pragma once

#include <string>
#include <vector>

#include "rtdata/config/system.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata::app {

/// Of a recording, what waits for sinks of other names than these: by sink, only where something waits.
Result<std::vector<RecordedBacklog>> backlogs_of_others(const Recording& recording,
                                                        const std::vector<std::string>& names);

/// Adds a warning (left-backlog) for every recording of the plan that is there already, where events wait for a sink
/// that does not go through it in this plan. Blocks while it reads.
void warn_of_left_backlogs(SystemPlan& plan);

/// A line for each recording with senders that is written `now`, and that none of `next` writes.
std::vector<std::string> recordings_left(const std::vector<const PartPlan*>& now, const SystemPlan& next);

/// The name of a sink of a configuration: as written, or its path, or its type.
std::string sink_name(const ConfigItem& sink);

}  // namespace rtdata::app
