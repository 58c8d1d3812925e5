/// SqliteSink: records events in a SQLite file that describes itself and can prove that it is complete.
///
///     rtdata::SqliteSink recording(loop, {.path = "run.db"});
///
/// One table per topic, named as the topic, one column per field, plus run, time (ns since the epoch), origin and
/// sequence. The tables rtdata_run, _topic, _schedule, _ledger, _gap, _clock and _error hold the data for checking it
/// (`rtdata verify`); docs/recording.md describes them. A file takes many runs. Readers may read while it records.
///
/// The file is opened on the sink's lane. While the loop does not run (loop.hpp), the constructor waits for that and
/// throws SetupError: not-a-recording, newer-version, not-permitted, busy (another process records into it; the error
/// has its pid), storage-full. In a callback it does not wait: it reports an error and tries again, while events wait
/// in the queue. If a run ended without closing, the next start seals it: it records the losses. A failed commit is
/// kept and tried again.
///
/// If the file is deleted or moved while it is being written, the recording ends: the next commit reports it, the sink
/// is faulted, and further events are refused and counted. Committed rows stay in the moved file.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's; all SQL runs on the sink's lane.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "rtdata/sinks/sink.hpp"

namespace rtdata {

/// How much a kill or a power failure may lose. Neither damages the file, except with `fast`.
///
/// A transaction holds the events of `batch_time` (1 s), so a killed program loses at most these, with every profile;
/// the next start reports how many.
enum class SqliteProfile {
  normal,  ///< WAL, synchronous=NORMAL; synced every 30 s: a power failure loses at most that
  safe,    ///< WAL, synchronous=FULL: a power failure loses as much as a kill
  fast,    ///< WAL, never synced: a power failure may destroy the file
  card,    ///< for SD cards: as `safe`, with a `batch_time` of at least 10 s: few writes, up to 10 s at risk
};

struct SqliteConfig {
  std::string path;
  SqliteProfile profile = SqliteProfile::normal;
  /// Maximum size of the recording with its WAL file: at the limit the oldest rows are deleted and counted as pruned.
  /// 0: no limit, otherwise at least `least_max_bytes`.
  std::uint64_t max_bytes = 0;
  Duration max_age{0};               ///< older rows are deleted and counted as pruned; 0: no limit
  bool steps = true;                 ///< also records a summary of each second and minute of a topic
  std::string permissions = "0640";  ///< of a new file, minus the umask; an existing file keeps its own
  SinkConfig sink = {};              ///< common settings; default name: the path

  static constexpr bool is_recording = true;  ///< sinks can use it for `through`
  static constexpr std::uint64_t least_max_bytes = std::uint64_t{4} << 20;
};

/// Returns an error for each topic for which a recording cannot have a table; `where` is the topic.
std::vector<Error> refused_topics(const SqliteConfig& config, std::span<const TopicToRecord> topics);

/// The time between commits, if no sink with `through` needs it shorter.
Duration batch_time(const SqliteConfig& config);

/// True if `other` belongs to the recording `file`: its WAL file, the WAL index, its journal or its lock.
bool is_companion_file(const SqliteConfig& config, const std::string& file, const std::string& other);

/// Checks that the path has no file, or a recording by its first bytes; does not change the file. Errors: bad-argument
/// (SQLite would not treat it as a file path, or it is too long), not-a-recording, newer-version.
Result<void> check_recordable(const std::string& path);

/// Checks that a sink could start recording into `file` now: it is recordable, and no other process records into it.
/// Creates and changes nothing. Any thread; blocks on the disk. Errors: those of `check_recordable`; busy (another
/// process records into it), not-permitted (its lock file cannot be made).
Result<void> check_openable(const SqliteConfig& config, const std::string& file);

class SqliteSink : public Sink {
 public:
  SqliteSink() noexcept = default;
  SqliteSink(Loop& loop, SqliteConfig config);
};

}  // namespace rtdata
