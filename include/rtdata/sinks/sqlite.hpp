/// SqliteSink: records events in a SQLite file that describes itself and proves its completeness.
///
///     rtdata::SqliteSink recording(loop, {.path = "run.db"});
///
/// One table a topic, named as the topic, one column a field, plus run, time (ns since the epoch), origin and sequence. The
/// tables rtdata_run, _topic, _schedule, _ledger, _gap, _clock and _error hold what is needed to check it
/// (`rtdata verify`); docs/recording.md describes them. A file takes many runs. Readers may read while it records.
///
/// Set-up opens the file on the calling thread and throws SetupError: not-a-recording, newer-version, not-permitted, busy
/// (another process records into it: its pid is named), storage-full. A run that ended without closing is sealed by the
/// next start: what it lost is written down. While running, a failed commit is kept and tried again.
///
/// A recording that somebody deletes or moves while it is written ends: that is reported at the next commit, the sink is
/// faulted, and what comes is refused and counted. What was committed is in the file, wherever it is, if it is anywhere.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's; all SQL runs on the sink's lane.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "rtdata/sinks/sink.hpp"

namespace rtdata {

/// How much a power cut may cost. A killed program loses nothing that was committed, with any of them.
enum class SqliteProfile {
  normal,  ///< WAL, synchronous=NORMAL: a power cut may cost the last commits, never the file
  safe,    ///< WAL, synchronous=FULL: a power cut costs no commit
  fast,    ///< no sync, journal in memory: a power cut or a kill in a commit may destroy the file
};

struct SqliteConfig {
  std::string path;
  SqliteProfile profile = SqliteProfile::normal;
  std::uint64_t max_bytes = 0;  ///< the oldest rows are deleted above this size, and counted as pruned; 0: no limit
  Duration max_age{0};          ///< rows older than this are deleted, and counted as pruned; 0: no limit
  SinkConfig sink = {};         ///< what every sink has; its name is the path unless given
};

/// Of these, which a recording cannot have a table for: an error each, `where` its topic.
std::vector<Error> refused_topics(const SqliteConfig& config, std::span<const TopicToRecord> topics);

/// Whether what is at the path, if anything, is a recording, as far as its first bytes tell; the file is not changed.
/// Errors: not-a-recording, newer-version.
Result<void> check_recordable(const std::string& path);

class SqliteSink : public Sink {
 public:
  SqliteSink() noexcept = default;
  SqliteSink(Loop& loop, SqliteConfig config);
};

}  // namespace rtdata
