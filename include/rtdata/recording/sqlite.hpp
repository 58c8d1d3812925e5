/// SqliteSink: records events in a SQLite file that describes itself and proves its completeness.
///
///     rtdata::SqliteSink recording(loop, {.path = "run.db"});
///
/// One table a topic, named as the topic, one column a field, plus run, time (ns since the epoch), origin and sequence.
/// The tables rtdata_run, _topic, _schedule, _ledger, _gap, _clock and _error hold what is needed to check it
/// (`rtdata verify`); docs/recording.md describes them. A file takes many runs. Readers may read while it records.
///
/// The file is opened on the sink's lane. While the loop does not run (loop.hpp), the constructor waits for that and
/// throws SetupError: not-a-recording, newer-version, not-permitted, busy (another process records into it: its pid is
/// named), storage-full. In a callback it does not wait: an error is reported, and it is tried again; events wait in
/// the queue. A run that ended without closing is sealed by the next start: what it lost is written down. While
/// running, a failed commit is kept and tried again.
///
/// A recording whose file is deleted or moved while it is written ends: that is reported at the next commit, the sink
/// is faulted, and what comes is refused and counted. What was committed is in the file, wherever it is, if it is
/// anywhere.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's; all SQL runs on the sink's lane.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "rtdata/sinks/sink.hpp"

namespace rtdata {

/// What a kill and a power cut may cost. The file itself is damaged by neither, but for `fast`.
///
/// A transaction holds what came within `batch_time` (1 s), so that a killed program loses that much at most, whatever
/// the profile; the next start says how much it was.
enum class SqliteProfile {
  normal,  ///< WAL, synchronous=NORMAL; the log is synced each 30 s: a power cut costs as much at most
  safe,    ///< WAL, synchronous=FULL: a power cut costs what a kill costs
  fast,    ///< WAL, never synced: a power cut may destroy the file
  card,    ///< for SD cards: as `safe`, with a `batch_time` of 10 s at least: ten seconds at risk, few bytes written
};

struct SqliteConfig {
  std::string path;
  SqliteProfile profile = SqliteProfile::normal;
  /// The recording as a whole, with its log: the oldest rows are deleted when it takes more, and counted as pruned; 0:
  /// no limit, otherwise at least `least_max_bytes`.
  std::uint64_t max_bytes = 0;
  Duration max_age{0};               ///< rows older than this are deleted, and counted as pruned; 0: no limit
  bool steps = true;                 ///< records each second and minute of a topic, reduced, beside its rows
  std::string permissions = "0640";  ///< of a file that is made, less the umask; one that is there keeps its own
  SinkConfig sink = {};              ///< what every sink has; its name is the path unless given

  static constexpr bool is_recording = true;  ///< sinks can go through it
  static constexpr std::uint64_t least_max_bytes = std::uint64_t{4} << 20;
};

/// Returns an error, `where` its topic, for each topic that a recording cannot have a table for.
std::vector<Error> refused_topics(const SqliteConfig& config, std::span<const TopicToRecord> topics);

/// After which time it commits what came, while no sink that goes through it wants it sooner.
Duration batch_time(const SqliteConfig& config);

/// Whether `other` goes with the recording `file`: its log, the log's index, its journal or its lock.
bool is_companion_file(const SqliteConfig& config, const std::string& file, const std::string& other);

/// Whether what is at the path, if anything, is a recording, as far as its first bytes tell; the file is not changed.
/// Errors: bad-argument (SQLite would take it for something else than the path of a file, or it is too long),
/// not-a-recording, newer-version.
Result<void> check_recordable(const std::string& path);

/// Whether a sink can begin now to record into `file`: it is recordable, and no other process records into it. Makes
/// and changes nothing. Any thread; blocks on the disk. Errors: those of `check_recordable`; busy (another process
/// records into it), not-permitted (its lock cannot be made).
Result<void> check_openable(const SqliteConfig& config, const std::string& file);

class SqliteSink : public Sink {
 public:
  SqliteSink() noexcept = default;
  SqliteSink(Loop& loop, SqliteConfig config);
};

}  // namespace rtdata
