// What waits in a recording for a sender that nobody runs any more, or whose peer is another now.
#pragma once

#include <string>
#include <vector>

#include "rtdata/config/system.hpp"
#include "rtdata/sinks/recording.hpp"

namespace rtdata::app {

/// Of a recording, what waits for sinks of other names than these: by sink, only where something waits.
Result<std::vector<RecordedBacklog>> backlogs_of_others(const Recording& recording,
                                                        const std::vector<std::string>& names);

/// Adds warnings for every recording of the plan that is there already: left-backlog, where events wait for a sink that
/// does not go through it in this plan; other-peer, where they wait for one that was recorded with another peer. Blocks
/// while it reads.
void warn_of_left_backlogs(SystemPlan& plan);

/// The name of a sink of a configuration: as written, or its path, or its type.
std::string sink_name(const ConfigItem& sink);

}  // namespace rtdata::app
