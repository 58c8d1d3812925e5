/// Replay: publishes the events of a recording again to the loop's handlers and sinks, in their recorded order and
/// timing.
///
///     rtdata::Loop loop{rtdata::Loop::Manual{}};  // virtual time: as fast as it goes
///     auto climate = loop.subscribe<Climate>("room/climate", [](const rtdata::Event<Climate>& e) { use(*e); });
///     rtdata::Replay replay(loop, {.file = "run.db"});
///     while (!replay.is_done()) loop.advance(1min);
///
/// Each event has its recorded time, origin, sequence and payload. The events of all topics come in order of time, with
/// the recorded distances divided by `speed`. Gaps, segments of schedules and changes of health also go to recordings.
/// The account is replayed too if the run was closed, all of it is replayed at speed 1, and the loop has the time of
/// the run, as in `rtdata replay` (a runtime whose clock starts at `RunInfo::started` or at most 10 s earlier); a new
/// recording then verifies like the first. Otherwise the origins are recorded as sources without a schedule, with
/// `silent` gaps; this is logged. Events dropped by the recording count as dropped again.
///
/// On a manual loop the same recording gives the same deliveries every time. In real time a lane reads the file, and
/// late events are published at once; they always have their recorded times and sequences.
///
/// Errors: SetupError for a file that is not a recording, a topic that exists with other fields, a name that a sensor
/// already has, and a recording into which this program records. Damage found while reading is reported and ends the
/// replay as `faulted`. Events out of order are reported and counted in `refused`.
///
/// It replays one run, by default the last one. A second `Replay` of another run needs other names for its origins
/// (`prefix`) or its own Runtime, as `rtdata replay` makes for each run.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's. The constructor opens the file and reads
/// the data of the run, which blocks. It sees the recording as it was at that time.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "rtdata/data/describe.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/data/problem.hpp"
#include "rtdata/loop/callback.hpp"
#include "rtdata/loop/handle.hpp"
#include "rtdata/loop/loop.hpp"

namespace rtdata {

struct ReplayConfig {
  std::string name = "replay";              ///< in reports; empty: "replay"
  std::string file = {};                    ///< the recording
  std::int64_t run = 0;                     ///< number of the run; 0: the last one
  std::vector<std::string> topics = {"#"};  ///< patterns
  /// "OLD=NEW": the topic OLD, and those below it, are replayed as NEW. The first match is used.
  std::vector<std::string> rename = {};
  std::string prefix = {};  ///< added to the names of the origins, so that they differ from the sensors' names
  std::string from = {};    ///< UTC as 2026-03-01T12:00:00Z, or recorded ns; empty: from the start
  std::string until = {};   ///< the first time not replayed; empty: to the end
  double speed = 1;         ///< 2: twice as fast

  friend constexpr auto parameters(type_tag<ReplayConfig>) {
    return parameter_list(
        parameter("name", &ReplayConfig::name, "name in reports", TextIs::name),
        parameter("file", &ReplayConfig::file, "the recording", required),
        parameter("run", &ReplayConfig::run, "number of the run; 0: the last one", range(0, 9.0e15)),
        parameter("topics", &ReplayConfig::topics, "which topics: names or patterns, + for one level, # for all below",
                  TextIs::topic_pattern),
        parameter("rename", &ReplayConfig::rename, "\"OLD=NEW\": the topic OLD, and those below it, become NEW"),
        parameter("prefix", &ReplayConfig::prefix, "prefix of the names of the origins"),
        parameter("from", &ReplayConfig::from, "first time, in UTC as 2026-03-01T12:00:00Z or as recorded in ns"),
        parameter("until", &ReplayConfig::until, "end time, not included"),
        parameter("speed", &ReplayConfig::speed, "2: twice as fast as it was recorded", range(1e-6, 1e6)));
  }
};
/// Checks that the recording exists and has the run, with events on those topics. Blocks.
Result<void> check_replayable(const ReplayConfig& config);
/// Checks rules over several parameters: renamings and times.
void check_config(const ReplayConfig& config, const ConfigItem& item, Problems& problems);

struct ReplayCounts {
  std::uint64_t events = 0;   ///< published
  std::uint64_t gaps = 0;     ///< the same
  std::uint64_t dropped = 0;  ///< events dropped or deleted by the recording; new recordings count them as dropped
  std::uint64_t refused = 0;  ///< events out of order, or of an origin or topic that cannot be replayed; not published
};

/// Published on "$rtdata/replay" when a replay has ended.
struct ReplayEnd {
  std::int64_t of_run = 0;  ///< the replayed run
  std::uint64_t events = 0, gaps = 0, dropped = 0, refused = 0;
  bool is_complete = false;  ///< false: it was stopped, or the recording is damaged
  RTDATA_FIELDS(ReplayEnd, (of_run), (events), (gaps), (dropped), (refused), (is_complete))
};
inline constexpr const char* replay_topic = "$rtdata/replay";

class Replay : public Handle {
 public:
  Replay() noexcept = default;
  /// SetupError: bad-argument (configuration; a recording into which this program records), bad-name, not-found (file,
  /// run, no topic that matches), not-a-recording, damaged, description-differs, busy (a name that is taken).
  Replay(Loop& loop, ReplayConfig config);

  /// True if everything was published, an error stopped it, or it is closed.
  bool is_done() const noexcept;
  ReplayCounts counts() const noexcept;
  /// The replayed run; 0 if closed.
  std::int64_t run() const noexcept;
  /// Called once at the end; with an error if the recording is damaged.
  void on_done(Callback<void(const Result<void>&)> handler);
};

}  // namespace rtdata
