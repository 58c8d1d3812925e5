// Curves of a recording.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "app/inspect/chosen_fields.hpp"
#include "app/inspect/curve.hpp"
#include "app/inspect/recorded_range.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/verify.hpp"

namespace rtdata::app {

/// "missed: loop held"
std::string reason_of(const RecordedGap& gap);

/// One for each field and origin, in the order of the fields; with the verdict of the run's account beside each. Reads
/// each event in the range once. `origin`: only this one. Throws SetupError.
Plot curves_of(const Recording& recording, const RecordedRange& range, const std::vector<ChosenField>& fields,
               const std::optional<std::string>& origin, Duration step);

/// All numbers of a run, except those of its course.
std::vector<ChosenField> fields_of_run(const Recording& recording, const RunInfo& run);

/// The same for all numbers of a run, except those of its course, from the recorded steps if these are fine enough: at
/// most about `columns` steps in each; fewer, but at least 120, if there are more than 200 curves.
/// `account`: of the run.
Plot curves_of_run(const Recording& recording, const RecordedRange& range, const RunReport& account,
                   std::size_t columns);

}  // namespace rtdata::app
