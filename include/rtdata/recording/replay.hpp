/// Replay: gives the events of a recording to the loop's handlers and sinks again, as they came when it was recorded.
///
///     rtdata::Loop loop{rtdata::Loop::Manual{}};  // virtual time: as fast as it goes
///     auto climate = loop.subscribe<Climate>("room/climate", [](const rtdata::Event<Climate>& e) { use(*e); });
///     rtdata::Replay replay(loop, {.file = "run.db"});
///     while (!replay.is_done()) loop.advance(1min);
///
/// Each event has its recorded time, origin, sequence and payload, and comes after the ones before it as far as it did
/// then, divided by `speed`, over all topics in the order of time. Gaps, stretches of schedule and changes of health go
/// to recordings in the same way. When the run was closed, all of it is replayed, at speed 1, and the loop's time is
/// that of the run, as `rtdata replay` makes it (a runtime whose clock begins at `RunInfo::started`, or at most 10 s
/// before), the account comes, too: then what is recorded again verifies as a copy of the first. Otherwise its origins
/// are recorded as sources without a schedule, whose gaps are `silent`; this is logged. Events that the recording
/// dropped are counted as dropped again.
///
/// On a manual loop the same recording gives the same deliveries every time. In real time, reading is on a lane of its
/// own, and what comes later than due comes at once; times and sequences are the recorded ones in any case.
///
/// What cannot be replayed is told: a file that is none, a topic that exists with other fields, a name that a sensor
/// has, a recording into which this program records (SetupError); damage that reading meets (reported; the replay ends
/// there, `faulted`); events that are not in order (reported, counted in `refused`).
///
/// A run is replayed, by default the last one: another `Replay` of another run needs other names of origins (`prefix`),
/// or a Runtime of its own, as `rtdata replay` makes for each run.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's. Making it opens the file and reads what is
/// known of the run, which blocks for that long. While it lives it sees the recording as it was.
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
  /// "OLD=NEW": the topic OLD, and those below it, are replayed as NEW. The first that fits counts.
  std::vector<std::string> rename = {};
  std::string prefix = {};  ///< put before the names of the origins, so that they differ from those of sensors
  std::string from = {};    ///< UTC as 2026-03-01T12:00:00Z, or recorded ns; empty: from the start
  std::string until = {};   ///< the first time that is left out; empty: to the end
  double speed = 1;         ///< 2: twice as fast

  friend constexpr auto parameters(type_tag<ReplayConfig>) {
    return parameter_list(
        parameter("name", &ReplayConfig::name, "in reports", TextIs::name),
        parameter("file", &ReplayConfig::file, "the recording", required),
        parameter("run", &ReplayConfig::run, "number of the run; 0: the last one", range(0, 9.0e15)),
        parameter("topics", &ReplayConfig::topics, "which topics: names or patterns, + for one level, # for all below",
                  TextIs::topic_pattern),
        parameter("rename", &ReplayConfig::rename, "\"OLD=NEW\": the topic OLD, and those below it, become NEW"),
        parameter("prefix", &ReplayConfig::prefix, "put before the names of the origins"),
        parameter("from", &ReplayConfig::from, "first time, in UTC as 2026-03-01T12:00:00Z or as recorded in ns"),
        parameter("until", &ReplayConfig::until, "first time that is left out"),
        parameter("speed", &ReplayConfig::speed, "2: twice as fast as it was recorded", range(1e-6, 1e6)));
  }
};
/// Whether there is such a recording, with that run and events on those topics. Blocks while it looks.
Result<void> check_replayable(const ReplayConfig& config);
/// What no parameter says by itself: renamings and times that are none; the same.
void check_config(const ReplayConfig& config, const ConfigItem& item, Problems& problems);

struct ReplayCounts {
  std::uint64_t events = 0;   ///< given to handlers and sinks
  std::uint64_t gaps = 0;     ///< the same
  std::uint64_t dropped = 0;  ///< that the recording dropped, or deleted again: counted as dropped where it is recorded
  std::uint64_t refused = 0;  ///< not in order, or of an origin or topic that cannot be replayed: not given to anybody
};

/// Published on "$rtdata/replay" when a replay has ended.
struct ReplayEnd {
  std::int64_t of_run = 0;  ///< that was replayed
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

  /// All was given to handlers and sinks, or it was stopped by an error. True of a closed one.
  bool is_done() const noexcept;
  ReplayCounts counts() const noexcept;
  /// The run that is replayed; 0 of a closed one.
  std::int64_t run() const noexcept;
  /// Called once, when it has ended; with an error when the recording is damaged.
  void on_done(Callback<void(const Result<void>&)> handler);
};

}  // namespace rtdata
