/// Recording: reads back what a SqliteSink recorded, also while it records.
///
///     auto recording = rtdata::Recording::open("run.db").or_throw();
///     auto events = recording.events<Climate>("room/climate").or_throw();
///     while (const auto* event = events.next().or_throw()) print(event->time, event->data.temperature);
///
/// Of any type, over several topics in order of time, with the gaps where they are:
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
#include <string_view>
#include <utility>
#include <vector>

#include "rtdata/data/describe.hpp"
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
  std::int64_t rows_up_to = 0;            ///< rows after this rowid came after the account
  std::vector<std::string> made_of = {};  ///< topics of whose events its own are made
  /// The sequence from which on all rows are in recorded steps of a second, and of a minute; 0: none are.
  std::uint64_t seconds_from = 0, minutes_from = 0;
  std::uint64_t dropped() const noexcept { return dropped_newest + dropped_oldest + dropped_refused + dropped_unsaved; }
};

/// What an origin came to in all runs that were deleted, and its outages in them (without a schedule).
struct DeletedOrigin {
  LedgerEntry account;  ///< only sums: no sequences; lost_is_known: of all of them
  Outages outages;
};

/// The runs of which `max_bytes` or `max_age` had deleted every row, and then the account: what is left are sums.
struct DeletedRuns {
  std::uint64_t runs = 0;  ///< 0: none was deleted, and nothing else is set
  std::int64_t first_run = 0, last_run = 0;
  Time started{}, ended{};    ///< of the first, of the last
  std::uint64_t sealed = 0;   ///< of them, those that were not closed
  std::uint64_t unsaved = 0;  ///< events of sensors that had only begun when their run was killed
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
  /// The opposite: the first time in that run whose UTC is not before this one.
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
  std::uint64_t count = 0;  ///< changes of the object up to this one, joined since there were too many
};

/// See HealthChange (runtime.hpp).
struct RecordedHealth {
  Time time{};
  std::string kind, name, state, reason;
  std::uint64_t count = 1;  ///< changes of this object that are joined; the state is that after the last
  Time last{};              ///< when that was; `time` is when the first was
};

/// What a sink that goes through the recording (SinkConfig::through) still has to send.
struct RecordedBacklog {
  std::string sink;
  std::string host;                 ///< the machine whose sink it is
  std::uint64_t events = 0;         ///< that wait
  std::uint64_t bytes = 0;          ///< of those, their payloads
  std::optional<Time> oldest = {};  ///< of those, UTC; none: nothing waits
  std::uint64_t refused = 0;        ///< events that its peer will never take: dropped
  std::uint64_t refused_keys = 0;   ///< of the newest of those the recording has the keys and the reasons
  std::uint64_t unsent = 0;         ///< events that a limit of the recording deleted before its peer had them
};

/// Which rows. Everything is taken that is not left out.
struct RowFilter {
  std::string topic = "#";               ///< a pattern; topics of "$rtdata/" only when it begins with "$"
  std::optional<std::int64_t> run = {};  ///< number of the run; all of them unless given
  std::optional<std::string> origin = {};
  std::optional<Time> from = {};   ///< first time taken; of gaps, those that have not ended by then
  std::optional<Time> until = {};  ///< first time not taken any more
  std::uint64_t limit = 0;         ///< at most so many rows, gaps not counted; 0: no limit
  /// Thins out: only the events 1, 1 + every, 1 + 2 * every and so on of each origin.
  std::uint64_t every = 1;
  enum class Gaps {
    left_out,
    in_place,  ///< each where it begins, before events of that time
  };
  Gaps gaps = Gaps::left_out;
  enum class Times {
    recorded,  ///< the run's line, which never jumps
    utc,       ///< see UtcLine
  };
  Times times = Times::recorded;  ///< what `from` and `until` are; of `steps`, also what the steps are
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
  /// Not null: there is no event, but a gap of that origin. Only with `RowFilter::Gaps::in_place`.
  const RecordedGap* gap() const noexcept { return gap_; }
  /// Of a gap: only the name is set.
  const RecordedTopic& topic() const noexcept { return *topic_; }
  /// Of a gap: when it begins, and sequence 0.
  const EventHeader& header() const noexcept { return header_; }
  /// Not of a gap.
  EventView event() const noexcept { return EventView(topic_->topic, header_, *topic_->description, payload_); }

 private:
  friend class Rows;
  friend struct detail::RowCursor;
  std::int64_t run_ = 0;
  EventHeader header_;
  std::string origin_;
  const RecordedTopic* topic_ = nullptr;
  const RecordedGap* gap_ = nullptr;
  std::vector<std::byte> payload_;
};

/// Rows run by run, in each in order of time across all topics; at one time in order of topics. Those that do not lie
/// in that order, and all of `steps`, SQLite sorts first, in a temporary file if need be. While it lives it
/// sees the recording as it was when it was made, also while another process writes it; as long as that takes, the log
/// of a recording that is being written grows.
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

/// A recorded event as a T. Valid until the next call of `next`.
template <Described T>
struct RecordedEvent : Event<T> {
  std::int64_t run = 0;
  const RecordedGap* gap = nullptr;  ///< not null: no event, but a gap: `data` means nothing
};

namespace detail {
/// How payloads of a recorded topic become a T. Errors: description-differs, which names the fields.
Result<std::shared_ptr<const void>> make_recorded_map(const RecordedTopic& topic, const Description& wanted);
void apply_recorded_map(const void* map, const std::byte* from, std::byte* to) noexcept;
}  // namespace detail

/// `Rows` of one type. The fields of T are found by name in each topic and each of its descriptions; it may leave some
/// out.
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
  /// The runs that are not among them any more.
  Result<DeletedRuns> deleted_runs() const;
  /// In order of name and version.
  Result<std::vector<RecordedTopic>> topics() const;
  Result<std::vector<LedgerEntry>> ledger(std::int64_t run) const;
  /// In order of time.
  Result<std::vector<RecordedGap>> gaps(std::int64_t run) const;
  Result<std::vector<RecordedSegment>> schedule(std::int64_t run) const;
  Result<std::vector<RecordedClock>> clock(std::int64_t run) const;
  /// The line of the run's boot; other runs of that boot in this recording help to find it. Error: not-found.
  Result<UtcLine> utc_line(std::int64_t run) const;
  Result<std::vector<RecordedConfiguration>> configurations(std::int64_t run) const;
  /// Of each sink that goes through the recording, by its name: as of its last position in the file, which is that of
  /// the last transaction.
  Result<std::vector<RecordedBacklog>> backlogs() const;
  Result<std::vector<RecordedError>> errors(std::int64_t run) const;
  /// Every change of health, in order of time.
  Result<std::vector<RecordedHealth>> health(std::int64_t run) const;
  /// Errors: bad-name (a pattern that is none), bad-argument (every 0).
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
  /// Reduced: for each origin and each step in which it has events a row, whose time is the beginning of the step, a
  /// multiple of its length since the epoch; its sequence counts the steps of the origin. Its description has the field
  /// "events", and for each number and bool of the topic a record of `count`, `min`, `max` and `mean`, of the values
  /// that are there and not NaN (the last three absent when there are none): `min` and `max` in the number's own kind,
  /// of a bool as u8, `mean` a double. Steps without events have no row: with `Gaps::in_place` the gaps tell why. Reads
  /// each event once, or the steps that were recorded of them: of whole seconds or minutes of recorded time, `from` and
  /// `until` as well. Errors: bad-name, bad-argument (a step below 1 ns).
  Result<Rows> steps(const RowFilter& filter, Duration step) const;

  /// For the other parts of this library.
  const std::shared_ptr<detail::RecordingFile>& file() const noexcept { return file_; }

 private:
  explicit Recording(std::shared_ptr<detail::RecordingFile> file);
  Result<void> check_type(const RowFilter& filter, const Description& wanted) const;
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
  std::uint64_t published = 0, missed = 0, failed = 0, unreadable = 0, dropped = 0, late = 0;
  std::uint64_t repeated = 0;     ///< the source itself had nothing new; no loss
  std::uint64_t first_lines = 0;  ///< no loss: as of SensorCounts
  std::uint64_t pruned = 0;       ///< stored, and deleted again by `max_age` or `max_bytes`; reached_hertz counts them
  Outages outages;                ///< of origins without a schedule
  std::vector<std::string> made_of_it;  ///< recorded topics, of one that is not recorded itself
  bool is_complete = false;             ///< those counts are of the whole run; else up to its last account
  std::optional<std::uint64_t> lost;    ///< none: the sources number nothing
  std::optional<Time> first, last;      ///< none without rows
};

/// One entry a topic that has an account or rows in the run, in order of name. Reads every row's time once.
Result<std::vector<TopicSummary>> summary(const Recording& recording, std::int64_t run);

}  // namespace rtdata
