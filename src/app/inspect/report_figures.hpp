// Figures of a report that are computed from the account of a run.
#pragma once

#include <optional>
#include <vector>

#include "app/inspect/curve.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata::app {

/// How much of the time, or of its values, a mean is of: 0 to 1. 1: of all that was to be measured.
double coverage_of(const Curve& curve, const LedgerEntry& account, Duration outages, Duration run);

/// The largest error of UTC in a run of this length, if each second away from a reading of the time of day adds 1 us.
/// None: the machine never said how well its clock was set.
std::optional<Duration> clock_error(const RunInfo& run, const std::vector<RecordedClock>& clock, Duration length);

}  // namespace rtdata::app
