// Chooses a run of a recording, and a part of it, from the options of a command line.
#pragma once

#include <optional>
#include <string>

#include "app/core/recording_commands.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata::app {

/// ISO 8601, or ns since the epoch; none: an empty text. Throws SetupError.
std::optional<Time> parse_time(const std::string& text);

struct RecordedRange {
  RunInfo run;
  UtcLine line{{}};  ///< of that run
  Time from{}, until{};
  bool is_whole = true;  ///< all of the run
};

/// Recorded time: the end of a run; of one that is being recorded, or was not closed, behind its last row.
Time last_instant(const Recording& recording, const RunInfo& run);

/// The end of a run that is being recorded, or was not closed, is behind its last row. `command`: "cannot plot". Throws
/// SetupError: there is no such run, what is wrong with a time.
RecordedRange range_of(const Recording& recording, const PartOptions& options, const char* command);

}  // namespace rtdata::app
