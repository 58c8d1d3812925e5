// Settings that lose data, or hide that it is lost, found before anything runs. Private to the program.
#pragma once

#include <string>

#include "rtdata/config/system.hpp"

namespace rtdata::app {

/// Adds a warning, loses-data, for every sensor that is read too seldom for what its chip keeps, or more often than a
/// reading takes.
void warn_of_losses(SystemPlan& plan);

/// Which sensors without a schedule have no `silence`, so that it is not noticed when they go quiet; empty: none. A
/// note: where the source may be silent for long, that is right.
std::string unnoticed_silence(const Registry& registry, const SystemPlan& plan);

}  // namespace rtdata::app
