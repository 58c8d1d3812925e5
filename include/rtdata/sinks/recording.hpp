/// Recording: reads back what a SqliteSink recorded, also while it records.
///
///     auto recording = rtdata::Recording::open("run.db").or_throw();
///     auto rows = recording.rows({.topic = "room/#"}).or_throw();
///     while (const rtdata::RecordedRow* row = rows.next().or_throw()) print(row->event().time(),
///     row->event().topic());
///
/// Every payload comes back equal: 64-bit unsigned bit for bit, NaN, absent optionals, enumerations by name. (-0.0
/// comes back as 0.0, which is equal: SQLite keeps no sign of zero.) A field that a later run added reads as absent,
/// NaN, zero or empty in the rows from before.
///
/// Owner: the holder; Rows may outlive the Recording. Thread: one at a time. Times are as they were recorded (a line
/// that never jumps); `Recording::utc_line` gives UTC. Errors: not-found, not-permitted, not-a-recording,
/// newer-version, damaged, busy.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "rtdata/data/event.hpp"
#include "rtdata/loop/ledger.hpp"

namespace rtdata {

enum class RunState {
  recording,  ///< it records now, or ended without closing and was not sealed yet
  closed,
  sealed,  ///< it ended without closing, and a later start wrote down what was lost; or a tier hung at its end: see
           ///< `remark`
};
std::string_view name_of(RunState state) noexcept;

struct RunInfo {
  std::int64_t run = 0;
  std::string uuid, name, notes, configuration, program, host, boot_id;
  std::int64_t pid = 0;
  Time started{};
  std::optional<Time> ended;  ///< the last account; none before the first
  Duration clock_offset{0};   ///< recorded time minus the monotonic line
  RunState state = RunState::recording;
  std::optional<std::uint64_t> lost;  ///< of a sealed run: published and not stored; none: not known
  std::string remark;
  /// The version of this layout in which it was written (rtdata_run.format). Before 5, reads and data have one account:
  /// with a schedule taken = published + repeated + filtered, received 0; without one received = published + repeated +
  /// filtered + failed. Before 4, accounts count from the beginning of the sensor instead of that of the recording.
  std::int64_t format = 0;
};

/// One description of a topic; a topic whose fields changed in kind or unit has several.
struct RecordedTopic {
  std::string topic;
  std::int64_t version = 1;
  std::string table;
  std::shared_ptr<const Description> description;
  std::int64_t first_run = 0;
};

/// The account of one origin on one topic in one run: scheduled + carried = taken + missed + failed + in_flight, and
/// received = published + repeated + filtered + unreadable (see RunInfo::format for older ones).
struct LedgerEntry {
  std::string topic, origin;
  SensorCounts sensor;        ///< since the recording began
  std::uint64_t carried = 0;  ///< reads that were under way when it began: 0 or 1
  std::uint64_t offered = 0, stored = 0;
  std::uint64_t dropped_newest = 0, dropped_oldest = 0, dropped_refused = 0, dropped_unsaved = 0;
  std::uint64_t first_sequence = 0, last_sequence = 0;  ///< offered; 0: none
  std::uint64_t pruned = 0;
  std::int64_t rows_up_to = 0;  ///< rows after this rowid came after the account
  std::uint64_t dropped() const noexcept { return dropped_newest + dropped_oldest + dropped_refused + dropped_unsaved; }
};

struct RecordedGap {
  std::string topic, origin;
  std::string kind;  ///< as name_of(Gap::Kind)
  std::string reason;
  Time first{}, last{};
  std::uint64_t count = 0;  ///< as Gap::count
};

struct RecordedSegment {
  std::string origin, topic;
  Segment segment;
};

/// See ClockPair.
struct RecordedClock {
  MonotonicTime monotonic{};
  Time realtime{};
  std::string source = {};
  std::optional<Duration> accuracy = {};
  std::string occasion = {};
};

/// The UTC of the monotonic line of one boot, bound late: by all pairs of monotonic time and time of day in the
/// recordings of that boot.
///
/// A pair says the time of day at its instant to within its accuracy, and less well away from it: worse by 1 us for
/// each second (1 ppm). A pair is used if no other pair has a smaller error at its instant. From one such pair to the
/// next the line is straight; before the first and after the last it is parallel to the monotonic one. It never goes
/// back.
///
/// Pairs of unknown accuracy are used only when there are no others. Then a clock was set because it was wrong, so the
/// last one holds for the whole boot: an hour's step leaves neither a hole nor an hour twice. (One before 2020 was
/// never set, and overrules none that was.)
class UtcLine {
 public:
  /// From `since` on: UTC = monotonic + offset + (monotonic - since) * rate.
  struct Stretch {
    MonotonicTime since{};
    Duration offset{0};
    double rate = 0;
    bool operator==(const Stretch&) const = default;
  };
  /// `pairs`: of the boot, in any order. `clock_offset`: of the run whose times are asked for.
  explicit UtcLine(std::span<const RecordedClock> pairs, Duration clock_offset = Duration{0});
  /// The UTC of a time as recorded in that run. One from before the boot (a source with times of its own) stays.
  Time utc(Time recorded) const noexcept;
  /// In order; the first begins at 0. None when there are no pairs.
  const std::vector<Stretch>& stretches() const noexcept { return stretches_; }

 private:
  Duration clock_offset_;
  std::vector<Stretch> stretches_;
};

struct RecordedError {
  Time time{};
  std::string object, id, text;
  std::uint64_t count = 0;
  Time last{};  ///< of those that are joined; `time` is that of the first
};

struct RecordedEscapes {
  std::string topic, origin;
  std::uint64_t texts = 0;
};

/// A change of the configuration since RunInfo::configuration.
struct RecordedConfiguration {
  Time time{};
  std::string object;       ///< "sensor chamber": the part that was added, changed or removed; empty: the whole
  std::string text;         ///< of the part or of the whole; empty: the part was removed
  std::uint64_t count = 0;  ///< changes of the object up to this one, joined since there were too many
};

/// See health.hpp.
struct RecordedHealth {
  Time time{};
  std::string kind, name, state, reason;
  std::uint64_t count = 1;  ///< changes of this object that are joined; the state is that after the last
  Time last{};              ///< when that was; `time` is when the first was
};

/// Which rows. Everything is taken that is not left out.
struct RowFilter {
  std::string topic = "#";               ///< a pattern; topics of "$rtdata/" only when it begins with "$"
  std::optional<std::int64_t> run = {};  ///< number of the run; all of them unless given
  std::optional<std::string> origin = {};
  std::optional<Time> from = {};   ///< first time taken, as recorded
  std::optional<Time> until = {};  ///< first time not taken any more
  std::uint64_t limit = 0;         ///< at most so many rows; 0: no limit
  /// Thins out: only the events 1, 1 + every, 1 + 2 * every and so on of each origin.
  std::uint64_t every = 1;
};

/// One row: an event and the run it belongs to. Valid until the next call of `next`.
class RecordedRow {
 public:
  std::int64_t run() const noexcept { return run_; }
  const RecordedTopic& topic() const noexcept { return *topic_; }
  const EventHeader& header() const noexcept { return header_; }
  EventView event() const noexcept { return EventView(topic_->topic, header_, *topic_->description, payload_); }

 private:
  friend class Rows;
  std::int64_t run_ = 0;
  EventHeader header_;
  std::string origin_;
  const RecordedTopic* topic_ = nullptr;
  std::vector<std::byte> payload_;
};

namespace detail {
struct RecordingFile;
struct RowsMerge;
}  // namespace detail

/// Rows run by run, in each in order of time across all topics; at one time in order of the topics' names. Memory: a
/// row a topic. While it lives it sees the recording as it was when it was made.
class Rows {
 public:
  Rows(Rows&&) noexcept;
  Rows& operator=(Rows&&) noexcept;
  ~Rows();
  /// Null after the last. Errors: damaged (a value that does not fit its field is named with topic, run and sequence).
  Result<const RecordedRow*> next();

 private:
  friend class Recording;
  explicit Rows(std::unique_ptr<detail::RowsMerge> merge);
  std::unique_ptr<detail::RowsMerge> merge_;
};

class Recording {
 public:
  static Result<Recording> open(const std::string& path);
  Recording(Recording&&) noexcept;
  Recording& operator=(Recording&&) noexcept;
  ~Recording();

  const std::string& path() const noexcept;
  Result<std::vector<RunInfo>> runs() const;
  /// In order of name and version.
  Result<std::vector<RecordedTopic>> topics() const;
  Result<std::vector<LedgerEntry>> ledger(std::int64_t run) const;
  /// In order of time.
  Result<std::vector<RecordedGap>> gaps(std::int64_t run) const;
  Result<std::vector<RecordedSegment>> schedule(std::int64_t run) const;
  Result<std::vector<RecordedClock>> clock(std::int64_t run) const;
  /// The line of the run's boot; other runs of that boot in this recording help to find it. Error: not-found.
  Result<UtcLine> utc_line(std::int64_t run) const;
  /// The origins with texts that were no UTF-8 and were stored with escapes. Formats before 5 have none.
  Result<std::vector<RecordedEscapes>> escaped(std::int64_t run) const;
  Result<std::vector<RecordedConfiguration>> configurations(std::int64_t run) const;
  Result<std::vector<RecordedError>> errors(std::int64_t run) const;
  /// Every change of health, in order of time. Formats before 3 have none.
  Result<std::vector<RecordedHealth>> health(std::int64_t run) const;
  /// Errors: bad-name (a pattern that is none), bad-argument (every 0).
  Result<Rows> rows(const RowFilter& filter) const;

  /// For the other parts of this library.
  const std::shared_ptr<detail::RecordingFile>& file() const noexcept { return file_; }

 private:
  explicit Recording(std::shared_ptr<detail::RecordingFile> file);
  std::shared_ptr<detail::RecordingFile> file_;
};

/// What a topic of a run came to.
struct TopicSummary {
  std::string topic;
  std::size_t origins = 0;
  std::uint64_t rows = 0;
  double wanted_hertz = 0;  ///< from the schedule, summed over the origins; 0: no schedule
  /// Rows in the scheduled time, as far as it is accounted for; without a schedule, in the run. 0: not known.
  double reached_hertz = 0;
  /// Row time minus the tick that it belongs to, modulo the period; of scheduled origins. Percentiles to 2 %.
  bool has_lateness = false;
  Duration lateness_p50{0}, lateness_p99{0}, lateness_max{0};
  std::uint64_t missed = 0, failed = 0, unreadable = 0, dropped = 0, late = 0;
  std::uint64_t pruned = 0;  ///< stored, and deleted again by `max_age` or `max_bytes`; reached_hertz counts them
  Outages outages;           ///< of origins without a schedule
  bool is_complete = false;  ///< those counts are of the whole run; else up to its last account
  std::optional<std::uint64_t> lost;  ///< none: the sources number nothing
  std::optional<Time> first, last;    ///< none without rows
};

/// One entry a topic that has an account or rows in the run, in order of name. Reads every row's time once.
Result<std::vector<TopicSummary>> summary(const Recording& recording, std::int64_t run);

}  // namespace rtdata
