// The recorded values of fields over a span of time, for a page.
#pragma once

#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/recording/recording.hpp"

namespace rtdata::app {

struct PageRecording {
  std::string sink, path;
  std::vector<std::string> topics = {"#"};  ///< patterns that it takes
};

/// Answers a request of a page: {"topics": {"room/air": ["temperature"], ...}, "from": ms, "until": ms, "step": ms,
/// "marks": true}. No fields of a topic means all of its numbers. Times are recorded times in ms since 1970.
///
/// The answer has the newest steps: as many as are read in 0.4 s, from `reached` on; the page requests earlier ones
/// next. {"run": {...}, "reached": ms, "series": [{"topic", "origin", "path", "unit", "time": [ms],
/// "least": [], "mean": [], "most": []}], "gaps": [{"topic", "origin", "kind", "reason", "first", "last", "count"}],
/// "marks": [events]}, or {"error": why}.
///
/// `run`: its number; none: the last one that this process records. Blocks on the disk. Any thread.
std::string page_history(const std::vector<PageRecording>& recordings, std::optional<std::int64_t> run,
                         std::string_view request);

/// A run as the answer names it, without its sink. Throws SetupError.
nlohmann::ordered_json page_run(const Recording& recording, const RunInfo& run);

/// True if a page gets each event of this payload: those of the course of a run, and of outputs.
bool is_change(const Description& description);

}  // namespace rtdata::app
