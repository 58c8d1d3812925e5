// Figures of a report that are computed from the account of a run.
#pragma once

#include <optional>
#include <vector>

#include "app/inspect/curve.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata::app {

/// The share of the time, or of the values, that a mean covers: 0 to 1. 1: all that should have been measured.
/// What was held back on purpose counts as covered.
double coverage_of(const Curve& curve, const LedgerEntry& account, Duration outages, Duration run);

/// The largest error of UTC in a run of this length, if each second away from a reading of the time of day adds 1 us.
/// None: the accuracy of the clock was never known.
std::optional<Duration> clock_error(const RunInfo& run, const std::vector<RecordedClock>& clock, Duration length);

}  // namespace rtdata::app
