// Events in a recording that wait for a sender that is no longer configured.
#pragma once

#include <string>
#include <vector>

#include "rtdata/config/system.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata::app {

/// The backlogs of a recording for sinks with other names than these, without empty ones.
Result<std::vector<RecordedBacklog>> backlogs_of_others(const Recording& recording,
                                                        const std::vector<std::string>& names);

/// Adds the warning left-backlog for every existing recording of the plan in which events wait for a sink that does not
/// use it in this plan. Blocks while it reads.
void warn_of_left_backlogs(SystemPlan& plan);

/// One line for each recording with senders that is written `now` but not in `next`.
std::vector<std::string> recordings_left(const std::vector<const PartPlan*>& now, const SystemPlan& next);

/// The name of a sink of a configuration: as written, or its path, or its type.
std::string sink_name(const ConfigItem& sink);

}  // namespace rtdata::app
