// Settings that lose data, or hide that it is lost, found before anything runs. Private to the program.
#pragma once

#include <string>
#include <vector>

#include "rtdata/config/system.hpp"

namespace rtdata::app {

/// Adds a warning, loses-data, for every sensor that is read too seldom for what its chip keeps, or more often than a
/// reading takes.
void warn_of_losses(SystemPlan& plan);

/// Of each recording that sinks go through, a line: within which time it commits what came, and because of which sink.
std::vector<std::string> latencies(const SystemPlan& plan);

/// Which sinks with a peer across a network go through no recording, and what that means; empty: none. A note: for
/// views of what happens now, that is right.
std::string only_in_memory(const SystemPlan& plan);

/// Which sensors without a schedule have no `silence`, so that it is not noticed when they go quiet; empty: none. A
/// note: where the source may be silent for long, that is right.
std::string unnoticed_silence(const Registry& registry, const SystemPlan& plan);

}  // namespace rtdata::app
