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

/// The files of recordings that are written `now`, and that none of `next` writes.
std::vector<std::string> recordings_left(const std::vector<const PartPlan*>& now, const SystemPlan& next);

/// A line for each sink for which something waits in such a file, with how it can be sent: with the senders of `next`,
/// which `file` says, or with another configuration. Blocks while it reads.
std::vector<std::string> left_behind(const std::string& recording, const SystemPlan& next, const std::string& file);

/// The name of a sink of a configuration: as written, or its path, or its type.
std::string sink_name(const ConfigItem& sink);

}  // namespace rtdata::app
