// Finds settings that lose data or hide losses, before anything runs. Private to the program.
#pragma once

#include <string>
#include <vector>

#include "rtdata/config/system.hpp"

namespace rtdata::app {

/// Adds the warning loses-data for every sensor that is read too seldom for its FIFO, or more often than a reading
/// takes, and unlikely-address for those of a Modbus unit that may never answer.
void warn_of_losses(SystemPlan& plan);

/// One line for each recording used by `through`: its time between commits, and the sink that requires it.
std::vector<std::string> latencies(const SystemPlan& plan);

/// A note about network sinks without `through`, with the consequence; empty: none. It is only a note, because live
/// views need no recording.
std::string only_in_memory(const SystemPlan& plan);

/// A note about sensors without a schedule and without `silence`, for which silence is not detected; empty: none. It is
/// only a note, because some sources may be silent for long.
std::string unnoticed_silence(const Registry& registry, const SystemPlan& plan);

}  // namespace rtdata::app
