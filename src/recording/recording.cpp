#include "rtdata/recording/recording.hpp"

#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>

#include "data/name_in.hpp"
#include "recording/recording_file.hpp"
#include "recording/rows_merge.hpp"
#include "recording/schema.hpp"
#include "recording/utc_line.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata {

using detail::RecordingFile;
using detail::Snapshot;
using sqlite::Database;
using sqlite::Statement;

std::string_view name_of(RunState state) noexcept {
  constexpr std::string_view names[] = {"recording", "closed", "sealed"};
  return detail::name_in(names, state);
}

namespace detail {

Error RecordingFile::damaged(std::string where, std::string why) const {
  return {Errc::damaged, "cannot read the recording", database.path() + (where.empty() ? "" : ", " + where),
          std::move(why), "keep it as it is, and record into another file"};
}

Statement RecordingFile::prepare(const std::string& sql) const {
  try {
    return database.prepare(sql);
  } catch (const SetupError& error) {
    if (sqlite3_errcode(database.raw()) != SQLITE_ERROR) throw;
    throw SetupError(damaged("", error.error().why));
  }
}

Snapshot::Snapshot(std::shared_ptr<RecordingFile> file) : file_(std::move(file)) {
  if (file_->snapshots == 0) file_->database.execute("BEGIN");
  ++file_->snapshots;
}

Snapshot::~Snapshot() {
  if (file_ != nullptr && --file_->snapshots == 0)
    sqlite3_exec(file_->database.raw(), "COMMIT", nullptr, nullptr, nullptr);
}

}  // namespace detail

namespace {

constexpr const char* doing = "cannot read the recording";

Error no_recording(const std::string& path, std::string why) {
  return {Errc::not_a_recording, doing, path, std::move(why), "name a file that `rtdata run` or a SqliteSink wrote"};
}

/// SQLite reads a file in WAL mode in a folder that cannot be written only when it is opened as immutable; then it
/// looks at no log or journal beside it.
bool is_at_rest(const std::string& path) {
  return ::access((path + "-wal").c_str(), F_OK) != 0 && ::access((path + "-journal").c_str(), F_OK) != 0;
}

/// Opens it once more where that helps.
std::int64_t application_id_of(Database& opened, const std::string& path) {
  constexpr const char* query = "PRAGMA application_id";
  try {
    return opened.integer(query);
  } catch (const SetupError& error) {
    const int code = sqlite3_errcode(opened.raw()) & 0xff;
    if (sqlite3_extended_errcode(opened.raw()) == SQLITE_READONLY_ROLLBACK)
      throw SetupError(
          no_recording(path, "its program ended while it made the file, which is empty: the next run makes it again"));
    Error why = error.error();
    if ((code == SQLITE_CANTOPEN || code == SQLITE_READONLY) && is_at_rest(path)) {
      opened = Database::open(path, Database::Mode::read_at_rest);
      try {
        return opened.integer(query);
      } catch (const SetupError& again) {
        why = again.error();
      }
    }
    if (why.code == make_error_code(Errc::not_a_recording))
      throw SetupError(no_recording(path, "it is not an SQLite file"));
    why.what = doing;
    why.where = path;
    if (code == SQLITE_CANTOPEN && ::access((path + "-wal").c_str(), R_OK) == 0) {
      why.why = "its newest data is in " + path + "-wal, which SQLite reads only where it can make " + path + "-shm";
      why.advice = "copy both files into a folder that can be written, and read the copy";
    }
    throw SetupError(std::move(why));
  }
}

Database open_file(const std::string& path) {
  struct stat status {};
  if (::stat(path.c_str(), &status) == 0) {
    if (!S_ISDIR(status.st_mode) && !S_ISREG(status.st_mode))
      throw SetupError(no_recording(path, "it is not a regular file"));
    if (S_ISREG(status.st_mode) && status.st_size == 0) throw SetupError(no_recording(path, "the file is empty"));
    if (S_ISREG(status.st_mode) && ::access(path.c_str(), R_OK) != 0) {
      throw SetupError(system_error(errno, doing, path, "check the permissions of the file"));
    }
  }
  auto opened = Database::open(path, Database::Mode::read);
  const std::int64_t application = application_id_of(opened, path);
  if (application == sqlite::application_id_before ||
      (application == sqlite::application_id && sqlite::lacks_suspensions(opened))) {
    std::string writer;
    try {
      auto query = opened.prepare("SELECT program FROM rtdata_run ORDER BY run DESC LIMIT 1");
      if (query.step()) writer = " (\"" + std::string(query.text(0)) + "\" wrote it)";
    } catch (const SetupError&) {  // the file does not say so
    }
    throw SetupError({Errc::not_a_recording, doing, path, sqlite::written_before + writer, sqlite::advice_before});
  }
  if (application != sqlite::application_id) {
    const bool is_empty = opened.integer("SELECT count(*) FROM sqlite_schema") == 0;
    throw SetupError(
        no_recording(path, is_empty ? "it is a SQLite file without content" : "it is another program's SQLite file"));
  }
  auto version = opened.integer("PRAGMA user_version");
  if (version < 1)
    throw SetupError({Errc::damaged, doing, path,
                      "its format is version " + std::to_string(version) + ", which does not exist",
                      "keep it as it is"});
  if (version > sqlite::schema_version) {
    throw SetupError({Errc::newer_version, doing, path,
                      "its format is version " + std::to_string(version) + ", this program knows up to " +
                          std::to_string(sqlite::schema_version),
                      "read it with the version of rtdata that recorded it, or a newer one"});
  }
  return opened;
}

std::uint64_t count_of(const Statement& row, int column) { return static_cast<std::uint64_t>(row.integer(column)); }
Time time_of(const Statement& row, int column) { return from_nanoseconds(row.integer(column)); }
std::string string_of(const Statement& row, int column) { return std::string(row.text(column)); }

constexpr std::int64_t every_run = -1;
/// Every row of a statement through `make`, collected.
template <class T, class Make>
Result<std::vector<T>> all(const RecordingFile& file, const std::string& sql, std::int64_t run, Make make) try {
  auto statement = file.prepare(sql);
  if (run != every_run) statement.bind(1, run);
  std::vector<T> found;
  while (statement.step()) found.push_back(make(statement));
  return found;
} catch (const SetupError& error) {
  return error.error();
}

}  // namespace

Recording::Recording(std::shared_ptr<RecordingFile> file) : file_(std::move(file)) {}
Recording::Recording(Recording&&) noexcept = default;
Recording& Recording::operator=(Recording&&) noexcept = default;
Recording::~Recording() = default;

Result<Recording> Recording::open(const std::string& path) try {
  auto database = open_file(path);
  auto file = std::make_shared<RecordingFile>();
  file->database = std::move(database);
  detail::provide_steps(file->database);
  for (const char* table : {"run", "topic", "schedule", "ledger", "gap", "clock", "error"}) {
    auto there = file->prepare("SELECT 1 FROM rtdata_" + std::string(table) + " LIMIT 1");
    there.step();
  }
  return Recording(std::move(file));
} catch (const SetupError& error) {
  return error.error();
}

const std::string& Recording::path() const noexcept { return file_->database.path(); }

Result<std::vector<RunInfo>> Recording::runs() const {
  return all<RunInfo>(*file_,
                      "SELECT run, uuid, name, notes, configuration, program, host, boot_id, pid, started, ended, "
                      "clock_offset, state, lost, remark FROM rtdata_run ORDER BY run",
                      every_run, [](const Statement& row) {
                        RunInfo run;
                        run.run = row.integer(0);
                        run.uuid = string_of(row, 1);
                        run.name = string_of(row, 2);
                        run.notes = string_of(row, 3);
                        run.configuration = string_of(row, 4);
                        run.program = string_of(row, 5);
                        run.host = string_of(row, 6);
                        run.boot_id = string_of(row, 7);
                        run.pid = row.integer(8);
                        run.started = time_of(row, 9);
                        if (!row.is_null(10)) run.ended = time_of(row, 10);
                        run.clock_offset = Duration{row.integer(11)};
                        run.state = row.text(12) == "closed"   ? RunState::closed
                                    : row.text(12) == "sealed" ? RunState::sealed
                                                               : RunState::recording;
                        if (!row.is_null(13)) run.lost = count_of(row, 13);
                        run.remark = string_of(row, 14);
                        return run;
                      });
}

Result<std::vector<RecordedTopic>> Recording::topics() const try {
  auto statement = file_->prepare(
      "SELECT topic, version, table_name, description, first_run FROM rtdata_topic ORDER BY topic, version");
  std::vector<RecordedTopic> topics;
  while (statement.step()) {
    RecordedTopic topic{string_of(statement, 0), statement.integer(1), string_of(statement, 2), nullptr,
                        statement.integer(4)};
    if (!is_topic_name(topic.topic))
      throw SetupError(file_->damaged("table rtdata_topic", "\"" + topic.topic + "\" is not a name of a topic"));
    auto description = Description::from_json(statement.text(3));
    if (!description) throw SetupError(file_->damaged("topic " + topic.topic, description.error().text()));
    topic.description = std::move(*description);
    topics.push_back(std::move(topic));
  }
  return topics;
} catch (const SetupError& error) {
  return error.error();
}

Result<std::vector<LedgerEntry>> Recording::ledger(std::int64_t run) const {
  return all<LedgerEntry>(
      *file_,
      "SELECT topic, origin, has_schedule, scheduled, taken, missed, failed, in_flight, late, received, published, "
      "repeated,"
      " filtered, lost, offered, stored, dropped_newest, dropped_oldest, dropped_refused, dropped_unsaved, "
      "first_sequence,"
      " last_sequence, pruned, rows_up_to, carried, unreadable, one_a_read, lateness, first_lines, made_of, "
      "seconds_from, "
      "minutes_from FROM "
      "rtdata_ledger WHERE run = ? ORDER BY topic, origin",
      run, [](const Statement& row) {
        LedgerEntry entry;
        entry.topic = string_of(row, 0);
        entry.origin = string_of(row, 1);
        SensorCounts& sensor = entry.sensor;
        sensor.has_schedule = row.integer(2) != 0;
        std::uint64_t* const counts[] = {
            &sensor.scheduled,      &sensor.taken,         &sensor.missed,        &sensor.failed,
            &sensor.in_flight,      &sensor.late,          &sensor.received,      &sensor.published,
            &sensor.repeated,       &sensor.filtered,      &sensor.lost,          &entry.offered,
            &entry.stored,          &entry.dropped_newest, &entry.dropped_oldest, &entry.dropped_refused,
            &entry.dropped_unsaved, &entry.first_sequence, &entry.last_sequence,  &entry.pruned};
        int column = 3;
        for (std::uint64_t* count : counts) *count = count_of(row, column++);
        sensor.lost_is_known = !row.is_null(13);
        entry.rows_up_to = row.integer(column++);
        entry.carried = count_of(row, column++);
        sensor.unreadable = count_of(row, column++);
        sensor.is_one_a_read = row.integer(column++) != 0;
        sensor.lateness = count_of(row, column++);
        sensor.first_lines = count_of(row, column++);
        const std::string made_of = string_of(row, column++);
        entry.seconds_from = count_of(row, column++);
        entry.minutes_from = count_of(row, column);
        for (std::size_t at = 0; at < made_of.size();) {
          const std::size_t end = std::min(made_of.find(' ', at), made_of.size());
          if (end != at) entry.made_of.push_back(made_of.substr(at, end - at));
          at = end + 1;
        }
        return entry;
      });
}

Result<std::vector<RecordedGap>> Recording::gaps(std::int64_t run) const {
  return all<RecordedGap>(
      *file_,
      "SELECT topic, origin, kind, reason, first, last, count FROM rtdata_gap WHERE run = ? ORDER BY first, _rowid_",
      run, [](const Statement& row) {
        return RecordedGap{string_of(row, 0), string_of(row, 1), string_of(row, 2), string_of(row, 3),
                           time_of(row, 4),   time_of(row, 5),   count_of(row, 6)};
      });
}

Result<std::vector<RecordedSegment>> Recording::schedule(std::int64_t run) const {
  return all<RecordedSegment>(*file_,
                              "SELECT origin, topic, first_due, period, end, scheduled, late_after FROM "
                              "rtdata_schedule WHERE run = ? ORDER BY origin, first_due",
                              run, [](const Statement& row) {
                                return RecordedSegment{
                                    string_of(row, 0), string_of(row, 1),
                                    Segment{time_of(row, 2), Duration{row.integer(3)}, time_of(row, 4),
                                            count_of(row, 5), Duration{row.integer(6)}}};
                              });
}

Result<std::vector<RecordedClock>> Recording::clock(std::int64_t run) const try {
  return sqlite::clock_pairs(file_->database, "r.run = " + std::to_string(run));
} catch (const SetupError& error) {
  return error.error();
}

namespace {

/// Empty: there is no such run.
std::optional<UtcLine> find_utc_line(const RecordingFile& file, std::int64_t run) {
  auto info = file.prepare("SELECT boot_id, clock_offset FROM rtdata_run WHERE run = ?");
  info.bind(1, run);
  if (!info.step()) return std::optional<UtcLine>{};
  auto pairs = sqlite::clock_pairs_of_boot(file.database, info.text(0));
  return std::optional<UtcLine>(UtcLine(pairs, Duration{info.integer(1)}));
}

}  // namespace

UtcLine detail::utc_line_of(const RecordingFile& file, std::int64_t run) {
  auto line = find_utc_line(file, run);
  return line.value_or(UtcLine({}));
}

Result<UtcLine> Recording::utc_line(std::int64_t run) const try {
  auto line = find_utc_line(*file_, run);
  if (line) return *std::move(line);
  return Error{Errc::not_found, doing, path(), "it has no run " + std::to_string(run), "see `rtdata info`"};
} catch (const SetupError& error) {
  return error.error();
}

Result<std::vector<RecordedHealth>> Recording::health(std::int64_t run) const {
  return all<RecordedHealth>(
      *file_,
      "SELECT time, kind, name, state, reason, count, max(last, time) FROM rtdata_health WHERE run = ? ORDER BY time, "
      "_rowid_",
      run, [](const Statement& row) {
        return RecordedHealth{time_of(row, 0),   string_of(row, 1), string_of(row, 2), string_of(row, 3),
                              string_of(row, 4), count_of(row, 5),  time_of(row, 6)};
      });
}

Result<std::vector<RecordedConfiguration>> Recording::configurations(std::int64_t run) const {
  return all<RecordedConfiguration>(
      *file_, "SELECT time, object, text, count FROM rtdata_configuration WHERE run = ? ORDER BY time, _rowid_", run,
      [](const Statement& row) {
        return RecordedConfiguration{time_of(row, 0), string_of(row, 1), string_of(row, 2), count_of(row, 3)};
      });
}

Result<std::vector<RecordedError>> Recording::errors(std::int64_t run) const {
  return all<RecordedError>(
      *file_,
      "SELECT time, object, id, text, count, max(last, time) FROM rtdata_error WHERE run = ? ORDER BY time, _rowid_",
      run, [](const Statement& row) {
        return RecordedError{time_of(row, 0),   string_of(row, 1), string_of(row, 2),
                             string_of(row, 3), count_of(row, 4),  time_of(row, 5)};
      });
}

}  // namespace rtdata
