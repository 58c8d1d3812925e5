// Selects the run, topics and times of a replay. Private to the replay.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/replay.hpp"

namespace rtdata::detail {

Error replay_refused(std::string where, std::string why, std::string advice);

struct GivenTime {
  Time time;
  RowFilter::Times line;
};
/// UTC, or ns as recorded. None: the text is empty. Errors: bad-argument. `key`: for these.
Result<std::optional<GivenTime>> given_time(const char* key, const std::string& text);

/// Parses "OLD=NEW". Errors: bad-argument.
Result<std::pair<std::string, std::string>> renaming_of(const std::string& text);

/// The run to replay; by default the last one. Errors: not-found, bad-argument (it records in this program), those of
/// reading.
RunInfo chosen_run(const Recording& recording, const ReplayConfig& config);

/// The begin of the requested part in the run's time, not before the run's start. Errors: bad-argument, those of
/// reading.
Time beginning_of(const Recording& recording, const RunInfo& run, const ReplayConfig& config);

/// The chosen topics that have rows in the run. Errors: not-found (none), bad-name, bad-description, those of reading.
std::vector<RecordedTopic> chosen_topics(const Recording& recording, const ReplayConfig& config, std::int64_t run);

}  // namespace rtdata::detail
