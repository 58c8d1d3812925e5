/// RecordingWriter: a writer that keeps an account of what it stores, as SqliteSink does; most writers need none of
/// this and derive from Writer (sink.hpp).
///
/// Beside storing records it may refuse topics before their first event, set the pace at which it is given batches and
/// accounts, warn, and keep the counts of the loop where they survive a kill.
///
/// Owner: its sink. Thread: said at each call.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/loop/runtime.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata {

/// What an origin's account says at the end of a batch.
struct OriginAccount {
  std::uint32_t slot = 0;
  SensorCounts sensor;        ///< since the sink was attached
  std::uint64_t carried = 0;  ///< reads that were under way then: 0 or 1
  std::uint64_t offered = 0;
  std::uint64_t dropped_newest = 0;
  std::uint64_t dropped_oldest = 0;
  std::uint64_t first_sequence = 0;  ///< of the first event offered to this sink; 0: none yet
  std::uint64_t last_sequence = 0;
  Segment segment;  ///< under way, from the first tick since then; `scheduled` 0: none
  Gap gap;          ///< under way, if `has_gap`
  bool has_gap = false;
};

/// All that a recording holds besides events. A writer that keeps no account ignores it.
struct Account {
  struct GapEntry {
    std::uint32_t slot;
    Gap gap;
  };
  struct SegmentEntry {
    std::uint32_t slot;
    Segment segment;
  };
  struct MadeOfEntry {
    std::uint32_t slot;
    std::string topics;  ///< of whose events its own are made, with spaces between
  };
  struct ErrorEntry {
    Time time;
    std::string object;
    std::string id;
    std::string text;
    std::uint64_t count;
    Time last;  ///< of those that are joined; `time` is that of the first
  };
  struct HealthEntry {
    Time time;
    HealthChange change;      ///< the last one
    std::uint64_t count = 1;  ///< changes of this object, joined when there are too many
    Time last{};              ///< of those; `time` is that of the first
  };
  Time at{};
  bool is_last = false;                ///< the sink closes: nothing follows
  std::string unknown = {};            ///< what no account of this sink has, and why; empty: nothing
  std::vector<OriginAccount> origins;  ///< those that changed; of many, a part
  std::vector<GapEntry> gaps;          ///< closed since the last account
  std::vector<SegmentEntry> segments;  ///< ended since the last account
  std::vector<MadeOfEntry> made_of;    ///< that became known since the last account
  std::vector<ErrorEntry> errors;
  std::vector<ClockPair> clock;
  std::vector<HealthEntry> health;  ///< changes since the last account
  std::vector<ConfigurationChange> configurations;

  bool is_empty() const noexcept {
    return origins.empty() && gaps.empty() && segments.empty() && errors.empty() && clock.empty() && health.empty() &&
           configurations.empty() && made_of.empty() && !is_last;
  }
};

/// What was counted of a slot, where it survives a kill.
struct LiveCounts {
  std::uint64_t offered = 0;
  std::uint64_t dropped = 0;
};

/// How a writer wants its batches, when each costs something however small it is.
struct StorePace {
  /// 0: a batch is stored as soon as `batch_rows` wait. Otherwise all that came within `batch_time` is one batch,
  /// stored sooner when it takes this much of the queue's memory.
  std::size_t bytes = 0;
  /// The longest wait before an account in which only counts have changed is stored; sooner, once `account_events` have
  /// come since the last one.
  Duration account_time{0};
  std::uint64_t account_events = 0;
  /// `RecordingWriter::sync` is called this long after the first batch that was stored since its last call; 0: never.
  Duration sync_time{0};
};

struct RunReport;

namespace detail {
struct RowFeedConfig;
class RowFeed;
}  // namespace detail

/// A call on the loop's thread may use nothing of the loop but `post` and `stop`, as those on the lane.
class RecordingWriter : public Writer {
 public:
  RecordingWriter* as_recording() noexcept final { return this; }

  /// When the sink is to be opened.
  enum class Opening {
    with_first_batch,  ///< what fails is tried again, as storing is
    at_set_up,  ///< the constructor of the sink begins it. While the loop does not run it waits for it, and throws
                ///< what went wrong (SetupError); in a callback it does not wait, and what fails is reported and
                ///< tried again. Events published meanwhile are queued.
  };

  // ---- on the loop's thread
  /// Once, before all other calls.
  virtual Opening opening() const { return Opening::with_first_batch; }
  /// Once, before the first batch.
  virtual StorePace pace() const { return {}; }
  /// Before the first event of a topic: from the sink's constructor, or later, while the lane may be at work. `number`
  /// is that of the slots to come. An error: no event of the topic comes here, each is counted as refused, and the sink
  /// is faulted; the constructor throws it.
  virtual Result<void> add_topic(std::uint32_t number, std::string_view topic, const Description& description);
  /// Returns where the sink counts the events offered to a slot, or null: then it counts in its own memory. Called once
  /// for each slot when the slot is made; with `Opening::at_set_up` not before `open` has returned, and then for all
  /// slots made so far, in order.
  virtual LiveCounts* live_counts(std::uint32_t slot);
  /// Gives an origin's account as it is now, whenever it changes without an event being written: a tick that brought
  /// none, a changed schedule. A writer may store it where it survives a kill. Not called after the last account was
  /// handed over. `closed`: the gaps that have ended and may be missing from the stored accounts, joined into one;
  /// null: none.
  virtual void keep(const OriginAccount& now, const Gap* closed);
  /// With `Opening::at_set_up`, called after `open`, when all counts from before it have been moved to where
  /// `live_counts` and `keep` put them: from here on they are up to date there.
  virtual void begin_counting() {}
  /// Whether other sinks can go through it.
  virtual bool is_recording() const noexcept { return false; }
  /// Of a recording: the uuid of its run, from the beginning on. Any thread.
  virtual std::string run() const { return {}; }
  /// For a sink that goes through this recording; null: none can. Once for each of these sinks.
  virtual std::unique_ptr<detail::RowFeed> feed(const detail::RowFeedConfig& config);
  /// Once it was closed: what the recording says of the run. Null: that is not known.
  virtual std::shared_ptr<const RunReport> recorded() const { return nullptr; }

  // ---- on the lane
  /// What was stored is to survive a power cut from now on: called by time, `StorePace::sync_time`.
  virtual Result<void> sync() { return {}; }
  /// What the user should hear of although nothing failed (space runs out). Asked after each turn of work.
  virtual std::optional<Error> take_warning() { return std::nullopt; }
  /// What the log should have. Asked after each turn of work.
  virtual std::vector<std::string> take_remarks() { return {}; }
};

}  // namespace rtdata
