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

/// The recorded time of the end of a run. A run that is recorded, or was not closed, ends after its last row.
Time last_instant(const Recording& recording, const RunInfo& run);

/// A run that is being recorded, or was not closed, ends after its last row. `command`: "cannot plot". Throws
/// SetupError: there is no such run, or a time is invalid.
RecordedRange range_of(const Recording& recording, const PartOptions& options, const char* command);

}  // namespace rtdata::app
