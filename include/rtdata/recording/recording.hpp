/// Recording: reads the recording of a SqliteSink, also while the sink still writes it.
///
///     auto recording = rtdata::Recording::open("run.db").or_throw();
///     auto events = recording.events<Climate>("room/climate").or_throw();
///     while (const auto* event = events.next().or_throw()) print(event->time, event->data.temperature);
///
/// Events of any type from several topics, in order of time, with the gaps in their places:
///
///     auto rows = recording.rows({.topic = "room/#", .gaps = rtdata::RowFilter::Gaps::in_place}).or_throw();
///     while (const rtdata::RecordedRow* row = rows.next().or_throw()) {
///       if (const rtdata::RecordedGap* gap = row->gap()) print(gap->origin, gap->reason, gap->last - gap->first);
///       else print(row->event().time(), row->event().topic());
///     }
///
/// For a picture, in steps: `recording.steps({.topic = "room/climate"}, 10min)` gives one row for each origin and step
/// in which it has events, whose fields are "events" and of each number in the topic "temperature.count",
/// "temperature.min", "temperature.max" and "temperature.mean".
///
/// Every payload reads back equal: 64-bit unsigned bit for bit, NaN, absent optionals, enumerations by name. (-0.0
/// reads back as 0.0: SQLite keeps no sign of zero.) A field that a later run added reads as absent, NaN, zero or empty
/// in older rows.
///
/// Owner: the holder; Rows may outlive the Recording. Thread: one at a time. Times are recorded times, on a clock that
/// never jumps; `Recording::utc_line` gives UTC. Errors: not-found, not-permitted, not-a-recording, newer-version,
/// damaged, busy.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "rtdata/data/describe.hpp"
#include "rtdata/data/event.hpp"
#include "rtdata/loop/ledger.hpp"

namespace rtdata {

enum class RunState {
  recording,  ///< still being recorded, or ended without closing and not sealed yet
  closed,
  sealed,  ///< ended without closing, and a later start recorded the losses; or a tier hung at its end: see
           ///< `remark`
};
std::string_view name_of(RunState state) noexcept;

struct RunInfo {
  std::int64_t run = 0;
  std::string uuid, name, notes, configuration, program, host, boot_id;
  std::int64_t pid = 0;
  Time started{};
  std::optional<Time> ended;  ///< time of the last account; empty before the first
  Duration clock_offset{0};   ///< recorded time minus the monotonic clock
  RunState state = RunState::recording;
  std::optional<std::uint64_t> lost;  ///< of a sealed run: published but not stored; empty: unknown
  std::string remark;
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
/// received = published + repeated + filtered + unreadable.
struct LedgerEntry {
  std::string topic, origin;
  SensorCounts sensor;        ///< since the recording began
  std::uint64_t carried = 0;  ///< reads that were under way when it began: 0 or 1
  std::uint64_t offered = 0, stored = 0;
  std::uint64_t dropped_newest = 0, dropped_oldest = 0, dropped_refused = 0, dropped_unsaved = 0;
  std::uint64_t first_sequence = 0, last_sequence = 0;  ///< offered; 0: none
  std::uint64_t pruned = 0;
  std::int64_t rows_up_to = 0;            ///< rows after this rowid are newer than the account
  std::vector<std::string> made_of = {};  ///< topics from which its events are made
  /// The first sequence from which all rows are in recorded steps of a second, and of a minute; 0: none are.
  std::uint64_t seconds_from = 0, minutes_from = 0;
  std::uint64_t dropped() const noexcept { return dropped_newest + dropped_oldest + dropped_refused + dropped_unsaved; }
};

/// The total account of an origin over all deleted runs, and its outages (without a schedule).
struct DeletedOrigin {
  LedgerEntry account;  ///< only sums, no sequences; lost_is_known: for all runs
  Outages outages;
};

/// The totals of runs whose rows and account were deleted by `max_bytes` or `max_age`.
struct DeletedRuns {
  std::uint64_t runs = 0;  ///< 0: none was deleted, and nothing else is set
  std::int64_t first_run = 0, last_run = 0;
  Time started{}, ended{};    ///< of the first, of the last
  std::uint64_t sealed = 0;   ///< how many of them were not closed
  std::uint64_t unsaved = 0;  ///< events of new sensors whose run was killed before its first account
  std::vector<DeletedOrigin> origins;
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
  Duration suspended{0};
};

/// Converts recorded times of one boot to UTC, from all pairs of monotonic time and time of day in the recording for
/// that boot.
///
/// A pair gives the time of day at its instant within its accuracy; the error grows by 1 us for each second of distance
/// (1 ppm). A pair is used if no other pair has a smaller error at its instant. Between two such pairs UTC is linear;
/// before the first and after the last it runs parallel to the monotonic clock. It never goes back.
///
/// Pairs of unknown accuracy are used only if there are no others. Then the last one applies to the whole boot, because
/// a clock is set when it was wrong: a step of an hour leaves no gap and no double hour. (A pair before 2020 is from a
/// clock that was never set; it does not replace later ones.)
///
/// Time during which the machine was suspended counts as well, so a suspension is no step. Times from the first pair
/// that includes it on are after the suspension, earlier ones before.
class UtcLine {
 public:
  /// From `since` on: UTC = monotonic + offset + (monotonic - since) * rate.
  struct Stretch {
    MonotonicTime since{};
    Duration offset{0};
    double rate = 0;
    bool operator==(const Stretch&) const = default;
  };
  /// `pairs`: all of the boot, in any order. `clock_offset`: of the run to convert.
  explicit UtcLine(std::span<const RecordedClock> pairs, Duration clock_offset = Duration{0});
  /// The UTC of a recorded time of that run. A time before the boot (from a source with its own times) does not change.
  Time utc(Time recorded) const noexcept;
  /// The inverse: the first recorded time of that run whose UTC is not before `utc`.
  Time recorded(Time utc) const noexcept;
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

/// A change of the configuration since RunInfo::configuration.
struct RecordedConfiguration {
  Time time{};
  std::string object;       ///< "sensor chamber": the part that was added, changed or removed; empty: the whole
  std::string text;         ///< of the part or of the whole; empty: the part was removed
  std::uint64_t count = 0;  ///< number of changes of the object joined into this one
};

/// See HealthChange (runtime.hpp).
struct RecordedHealth {
  Time time{};
  std::string kind, name, state, reason;
  std::uint64_t count = 1;  ///< changes of this object that are joined; the state is that after the last
  Time last{};              ///< when that was; `time` is when the first was
};

/// The events that a sink with SinkConfig::through still has to send.
struct RecordedBacklog {
  std::string sink;
  std::string host;                 ///< the machine of the sink
  std::uint64_t events = 0;         ///< that wait
  std::uint64_t bytes = 0;          ///< of those, their payloads
  std::optional<Time> oldest = {};  ///< of those, UTC; none: nothing waits
  std::uint64_t refused = 0;        ///< events that its peer refused; dropped
  std::uint64_t refused_keys = 0;   ///< how many of these have keys and reasons in the recording (the newest)
  std::uint64_t unsent = 0;         ///< events deleted by a limit of the recording before they were sent
};

/// Selects rows. The default selects all.
struct RowFilter {
  std::string topic = "#";               ///< a pattern; topics of "$rtdata/" only when it begins with "$"
  std::optional<std::int64_t> run = {};  ///< number of the run; all of them unless given
  std::optional<std::string> origin = {};
  std::optional<Time> from = {};   ///< first time selected; gaps that end later are included
  std::optional<Time> until = {};  ///< first time not selected
  std::uint64_t limit = 0;         ///< maximum number of rows, not counting gaps; 0: no limit
  /// Thins out: only the events 1, 1 + every, 1 + 2 * every and so on of each origin.
  std::uint64_t every = 1;
  enum class Gaps {
    left_out,
    in_place,  ///< each at its beginning, before events of the same time
  };
  Gaps gaps = Gaps::left_out;
  enum class Times {
    recorded,  ///< the run's clock, which never jumps
    utc,       ///< see UtcLine
  };
  Times times = Times::recorded;  ///< clock of `from` and `until`, and of the steps in `steps`
};

namespace detail {
struct RecordingFile;
struct RowsMerge;
struct RowCursor;
}  // namespace detail

/// One row: an event, or a gap, and the run it belongs to. Valid until the next call of `next`.
class RecordedRow {
 public:
  std::int64_t run() const noexcept { return run_; }
  /// Not null: this row is a gap of that origin, not an event. Only with `RowFilter::Gaps::in_place`.
  const RecordedGap* gap() const noexcept { return gap_; }
  /// For a gap only the name is set.
  const RecordedTopic& topic() const noexcept { return *topic_; }
  /// For a gap: its beginning, and sequence 0.
  const EventHeader& header() const noexcept { return header_; }
  /// Not for a gap.
  EventView event() const noexcept { return EventView(topic_->topic, header_, *topic_->description, payload_); }
  /// For a step: the sequences of its first and its last event. What is missing between them, or between the last of
  /// one step and the first of the next of that origin, was not stored. Of an event both are its own, of a gap 0.
  std::uint64_t first_sequence() const noexcept { return first_sequence_; }
  std::uint64_t last_sequence() const noexcept { return last_sequence_; }

 private:
  friend class Rows;
  friend struct detail::RowCursor;
  std::int64_t run_ = 0;
  std::uint64_t first_sequence_ = 0, last_sequence_ = 0;
  EventHeader header_;
  std::string origin_;
  const RecordedTopic* topic_ = nullptr;
  const RecordedGap* gap_ = nullptr;
  std::vector<std::byte> payload_;
};

/// Rows run by run, in order of time across all topics; at equal times in order of topics. Rows stored in another
/// order, and all rows of `steps`, are first sorted by SQLite, if necessary in a temporary file. It sees the recording
/// as it was when it was made, even if another process writes to it; during that time the WAL file of the recording
/// grows.
class Rows {
 public:
  Rows(Rows&&) noexcept;
  Rows& operator=(Rows&&) noexcept;
  ~Rows();
  /// The next row; null after the last. Errors: damaged (a value does not fit its field; names topic, run and
  /// sequence).
  Result<const RecordedRow*> next();

 private:
  friend class Recording;
  explicit Rows(std::unique_ptr<detail::RowsMerge> merge);
  std::unique_ptr<detail::RowsMerge> merge_;
};

/// A recorded event as a T. Valid until the next call of `next`.
template <Described T>
struct RecordedEvent : Event<T> {
  std::int64_t run = 0;
  const RecordedGap* gap = nullptr;  ///< not null: a gap, not an event; `data` is unused
};

namespace detail {
/// How payloads of a recorded topic become a T. Errors: description-differs, which names the fields.
Result<std::shared_ptr<const void>> make_recorded_map(const RecordedTopic& topic, const Description& wanted);
void apply_recorded_map(const void* map, const std::byte* from, std::byte* to) noexcept;
}  // namespace detail

/// `Rows` of one type. The fields of T are found by name in each topic and each of its descriptions; T may omit fields.
template <Described T>
class RecordedEvents {
 public:
  /// Null after the last. Errors: those of `Rows::next`; description-differs.
  Result<const RecordedEvent<T>*> next() {
    auto row = rows_.next();
    if (!row) return std::move(row).error();
    if (*row == nullptr) return nullptr;
    static_cast<EventHeader&>(event_) = (*row)->header();
    event_.run = (*row)->run();
    event_.gap = (*row)->gap();
    if (event_.gap != nullptr) return &event_;
    const RecordedTopic& topic = (*row)->topic();
    if (&topic != topic_) {  // another table than that of the last row
      auto map = detail::make_recorded_map(topic, *description_of<T>());
      if (!map) return std::move(map).error();
      map_ = *std::move(map);
      topic_ = &topic;
    }
    detail::apply_recorded_map(map_.get(), (*row)->event().payload().data(),
                               reinterpret_cast<std::byte*>(&event_.data));
    return &event_;
  }

 private:
  friend class Recording;
  explicit RecordedEvents(Rows rows) : rows_(std::move(rows)) {}
  Rows rows_;
  const RecordedTopic* topic_ = nullptr;
  std::shared_ptr<const void> map_;
  RecordedEvent<T> event_;
};

class Recording {
 public:
  static Result<Recording> open(const std::string& path);
  Recording(Recording&&) noexcept;
  Recording& operator=(Recording&&) noexcept;
  ~Recording();

  const std::string& path() const noexcept;
  Result<std::vector<RunInfo>> runs() const;
  /// The totals of runs that were deleted.
  Result<DeletedRuns> deleted_runs() const;
  /// In order of name and version.
  Result<std::vector<RecordedTopic>> topics() const;
  Result<std::vector<LedgerEntry>> ledger(std::int64_t run) const;
  /// In order of time.
  Result<std::vector<RecordedGap>> gaps(std::int64_t run) const;
  Result<std::vector<RecordedSegment>> schedule(std::int64_t run) const;
  Result<std::vector<RecordedClock>> clock(std::int64_t run) const;
  /// The UTC conversion for the run's boot, from all runs of that boot in this recording. Error: not-found.
  Result<UtcLine> utc_line(std::int64_t run) const;
  Result<std::vector<RecordedConfiguration>> configurations(std::int64_t run) const;
  /// One entry for each sink with `through`, by name, as of the last committed position.
  Result<std::vector<RecordedBacklog>> backlogs() const;
  Result<std::vector<RecordedError>> errors(std::int64_t run) const;
  /// Every change of health, in order of time.
  Result<std::vector<RecordedHealth>> health(std::int64_t run) const;
  /// Errors: bad-name (an invalid pattern), bad-argument (`every` is 0).
  Result<Rows> rows(const RowFilter& filter) const;
  /// The same as payloads of a type. Errors: also not-found (no such topic in the recording), description-differs (a
  /// field that is missing or of another kind or unit, named, in a topic that has rows).
  template <Described T>
  Result<RecordedEvents<T>> events(const RowFilter& filter) const {
    if (auto fits = check_type(filter, *description_of<T>()); !fits) return std::move(fits).error();
    auto found = rows(filter);
    if (!found) return std::move(found).error();
    return RecordedEvents<T>(*std::move(found));
  }
  template <Described T>
  Result<RecordedEvents<T>> events(std::string_view topic) const {
    RowFilter filter;
    filter.topic = topic;
    return events<T>(filter);
  }
  /// Reduces events to steps: one row for each origin and each step with events. The time of a row is the beginning of
  /// the step, a multiple of its length since the epoch; the sequence counts the steps of the origin. The description
  /// has the field "events" and, for each number and bool of the topic, a record of `count`, `min`, `max` and `mean`
  /// over the values that are present and not NaN (the last three are absent if there are none): `min` and `max` in the
  /// number's own kind, for a bool as u8, `mean` a double. Steps without events have no row; with `Gaps::in_place` the
  /// gaps show the reason. Reads each event once, or the recorded steps if `step`, `from` and `until` are whole seconds
  /// or minutes of recorded time. `fields`: paths of the only numbers that are read, which takes less time; the `count`
  /// of any other is 0. Errors: bad-name, bad-argument (a step below 1 ns).
  Result<Rows> steps(const RowFilter& filter, Duration step, std::span<const std::string> fields = {}) const;

  /// For the other parts of this library.
  const std::shared_ptr<detail::RecordingFile>& file() const noexcept { return file_; }

 private:
  explicit Recording(std::shared_ptr<detail::RecordingFile> file);
  Result<void> check_type(const RowFilter& filter, const Description& wanted) const;
  std::shared_ptr<detail::RecordingFile> file_;
};

/// The summary of one topic in a run.
struct TopicSummary {
  std::string topic;
  std::size_t origins = 0;
  std::uint64_t rows = 0;
  double wanted_hertz = 0;  ///< scheduled rate, summed over the origins; 0: no schedule
  /// Rows per second of scheduled time in the account; without a schedule, of the run. 0: unknown.
  double reached_hertz = 0;
  /// Row time minus the time of its tick, modulo the period, for scheduled origins. Percentiles within 2 %.
  bool has_lateness = false;
  Duration lateness_p50{0}, lateness_p99{0}, lateness_max{0};
  std::uint64_t published = 0, missed = 0, failed = 0, unreadable = 0, dropped = 0, late = 0;
  std::uint64_t repeated = 0;     ///< the source had nothing new; not a loss
  std::uint64_t first_lines = 0;  ///< not a loss; see SensorCounts
  std::uint64_t pruned = 0;       ///< stored, later deleted by `max_age` or `max_bytes`; included in reached_hertz
  Outages outages;                ///< of origins without a schedule
  std::vector<std::string> made_of_it;  ///< recorded topics made from this one, if it is not recorded itself
  bool is_complete = false;             ///< the counts cover the whole run; otherwise up to the last account
  std::optional<std::uint64_t> lost;    ///< empty: no source numbers its data
  std::optional<Time> first, last;      ///< empty without rows
};

/// One entry for each topic with an account or rows in the run, in order of name. Reads every row's time once.
Result<std::vector<TopicSummary>> summary(const Recording& recording, std::int64_t run);

}  // namespace rtdata
