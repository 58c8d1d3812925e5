/// RecordingWriter: a writer that also stores the account of its events, as SqliteSink does. Most writers do not need
/// this and derive from Writer (sink.hpp).
///
/// Besides storing records it may refuse topics before their first event, set the pace of batches and accounts, warn,
/// and keep the loop's counts in memory that survives a kill.
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

/// An origin's account at the end of a batch.
struct OriginAccount {
  std::uint32_t slot = 0;
  SensorCounts sensor;        ///< since the sink was attached
  std::uint64_t carried = 0;  ///< reads that were under way then: 0 or 1
  std::uint64_t offered = 0;
  std::uint64_t dropped_newest = 0;
  std::uint64_t dropped_oldest = 0;
  std::uint64_t first_sequence = 0;  ///< of the first event offered to this sink; 0: none yet
  std::uint64_t last_sequence = 0;
  Segment segment;  ///< the current one, from the first tick since then; `scheduled` 0: none
  Gap gap;          ///< the current one, if `has_gap`
  bool has_gap = false;
};

/// Everything in a recording besides events. A writer without an account ignores it.
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
    std::string topics;  ///< topics from which its events are made, separated by spaces
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
  bool is_last = false;                ///< the sink closes: this is the last account
  std::string unknown = {};            ///< data missing from this account, and why; empty: none
  std::vector<OriginAccount> origins;  ///< changed accounts; if there are many, a part of them
  std::vector<GapEntry> gaps;          ///< closed since the last account
  std::vector<SegmentEntry> segments;  ///< ended since the last account
  std::vector<MadeOfEntry> made_of;    ///< new since the last account
  std::vector<ErrorEntry> errors;
  std::vector<ClockPair> clock;
  std::vector<HealthEntry> health;  ///< changes since the last account
  std::vector<ConfigurationChange> configurations;

  bool is_empty() const noexcept {
    return origins.empty() && gaps.empty() && segments.empty() && errors.empty() && clock.empty() && health.empty() &&
           configurations.empty() && made_of.empty() && !is_last;
  }
};

/// The counts of a slot, in memory that survives a kill.
struct LiveCounts {
  std::uint64_t offered = 0;
  std::uint64_t dropped = 0;
};

/// The pace of batches, for writers where each batch has a fixed cost.
struct StorePace {
  /// 0: a batch is stored as soon as `batch_rows` events wait. Other values: a batch holds all events of `batch_time`,
  /// and is stored earlier when it uses this much memory of the queue.
  std::size_t bytes = 0;
  /// The longest wait before an account with only new counts is stored; earlier after `account_events` events.
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

/// All calls, also those on the loop's thread, may only use `post` and `stop` of the loop.
class RecordingWriter : public Writer {
 public:
  RecordingWriter* as_recording() noexcept final { return this; }

  /// When to open the sink.
  enum class Opening {
    with_first_batch,  ///< a failure is tried again, like storing
    at_set_up,         ///< by the sink's constructor. While the loop does not run, it waits and throws
                       ///< what went wrong (SetupError); in a callback it does not wait, and what fails is reported and
                       ///< tried again. Events published meanwhile are queued.
  };

  // ---- on the loop's thread
  /// Once, before all other calls.
  virtual Opening opening() const { return Opening::with_first_batch; }
  /// Once, before the first batch.
  virtual StorePace pace() const { return {}; }
  /// Before the first event of a topic: from the sink's constructor, or later, while the lane may be at work. `number`
  /// is that of the slots to come. On an error all events of the topic count as refused, and the sink is faulted; the
  /// constructor throws the error.
  virtual Result<void> add_topic(std::uint32_t number, std::string_view topic, const Description& description);
  /// Returns the memory where the sink counts the events offered to a slot; null: its own memory. Called once for each
  /// new slot, in order, also before `open` and while the lane is at work.
  virtual LiveCounts* live_counts(std::uint32_t slot);
  /// Passes an origin's current account when it changes without an event: a tick without a sample, a changed schedule.
  /// A writer may store it in memory that survives a kill. Not called after the last account. `closed`: ended gaps that
  /// may be missing from the stored accounts, joined into one; null: none.
  virtual void keep(const OriginAccount& now, const Gap* closed);
  /// True if other sinks can use it for `through`.
  virtual bool is_recording() const noexcept { return false; }
  /// The uuid of a recording's run, from the start. Any thread.
  virtual std::string run() const { return {}; }
  /// Makes the row source for a sink with `through` on this recording; null: not possible. Once for each such sink.
  virtual std::unique_ptr<detail::RowFeed> feed(const detail::RowFeedConfig& config);
  /// After closing: the recording's report of the run. Null: unknown.
  virtual std::shared_ptr<const RunReport> recorded() const { return nullptr; }

  // ---- on the lane
  /// Makes stored data survive a power failure; called according to `StorePace::sync_time`.
  virtual Result<void> sync() { return {}; }
  /// A warning for the user although nothing failed (space runs out). Called after each job.
  virtual std::optional<Error> take_warning() { return std::nullopt; }
  /// Lines for the log. Called after each job.
  virtual std::vector<std::string> take_remarks() { return {}; }
};

}  // namespace rtdata
