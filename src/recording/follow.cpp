#include "rtdata/recording/follow.hpp"

#include <algorithm>
#include <chrono>
#include <map>
#include <optional>
#include <utility>

#include "recording/rows_merge.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata {
namespace {

using detail::RecordingFile;
using sqlite::Statement;

// Rows of one table are stored in the order of publishing, which is nearly that of time.
constexpr Duration disorder = std::chrono::seconds{10};
constexpr std::uint64_t rows_between_looks = 64;  // at the clock

/// The rows of a table after a given one, in the order in which they are stored.
class FollowCursor final : public detail::RowCursor {
 public:
  FollowCursor(const RecordingFile& file, const RecordedTopic& topic, Time from)
      : file_(file), table_(sqlite::quoted(topic.table)), from_(from) {
    set(topic);
    if (from > Time::min() + disorder) row_ = row_before(from - disorder);
  }

  /// The table may have more columns now.
  void set(const RecordedTopic& topic) {
    topic_ = topic;
    reader_.emplace(topic_);
    statement_ = file_.prepare("SELECT t.run, t.time, t.origin, t.sequence" + reader_->columns() + ", t._rowid_ FROM " +
                               table_ + " t WHERE t._rowid_ > ?1 AND t.time >= ?2 ORDER BY t._rowid_");
    row_column_ = sqlite3_column_count(statement_.raw()) - 1;
  }

  /// Before the first `advance` of a transaction.
  void begin() { statement_.bind(1, row_).bind(2, to_nanoseconds(from_)); }
  void end() noexcept { statement_.reset(); }

  bool advance() override {
    if (!statement_.step()) return false;
    run = statement_.integer(detail::run_column);
    time = statement_.integer(detail::time_column);
    return true;
  }
  void give(RecordedRow& row) override {
    const auto sequence = static_cast<std::uint64_t>(statement_.integer(detail::sequence_column));
    std::byte* const payload = set_event(row, statement_.text(detail::origin_column), sequence, topic_);
    row_ = statement_.integer(row_column_);
    try {
      reader_->read(statement_.raw(), detail::fixed_columns, payload);
    } catch (const SetupError& error) {
      throw SetupError(at_row(file_, topic_, run, row.header().origin, sequence, error.error()));
    }
  }

 private:
  /// The row before the first that is not earlier than this, if the rows of each run lie in order. The clock of a later
  /// run may have been behind that of an earlier one.
  std::int64_t row_before(Time wanted) {
    const auto number = [&](const char* function) {
      return file_.database.integer("SELECT ifnull(" + std::string(function) + "(_rowid_), 0) FROM " + table_);
    };
    auto next = file_.prepare("SELECT t.run, t.time FROM " + table_ +
                              " t WHERE t._rowid_ >= ?1 ORDER BY t._rowid_ LIMIT 1");
    // The first rowid from `low` to `high` from which on a row's column is at least this.
    const auto first_from = [&](std::int64_t low, std::int64_t high, int column, std::int64_t least) {
      while (low < high) {
        const std::int64_t middle = low + (high - low) / 2;
        next.bind(1, middle);
        const bool is_before = next.step() && next.integer(column) < least;
        next.reset();
        (is_before ? low : high) = is_before ? middle + 1 : middle;
      }
      return low;
    };
    const std::int64_t end = number("max") + 1;
    for (std::int64_t at = number("min"); at < end;) {
      next.bind(1, at);
      if (!next.step()) break;
      const std::int64_t run_here = next.integer(0);
      next.reset();
      const std::int64_t end_of_run = first_from(at, end, 0, run_here + 1);
      const std::int64_t found = first_from(at, end_of_run, 1, to_nanoseconds(wanted));
      if (found < end_of_run) return found - 1;
      at = end_of_run;
    }
    return end - 1;
  }

  const RecordingFile& file_;
  const std::string table_;
  const Time from_;
  RecordedTopic topic_;
  std::optional<detail::RowReader> reader_;
  Statement statement_;
  int row_column_ = 0;
  std::int64_t row_ = 0;  // the last that was given
};

bool is_later(const detail::RowCursor* a, const detail::RowCursor* b) noexcept {
  if (a->run != b->run) return a->run > b->run;
  if (a->time != b->time) return a->time > b->time;
  return a->place > b->place;
}

}  // namespace

struct RecordingFollower::Core {
  Core(Recording recording_, Config config_) : recording(std::move(recording_)), config(std::move(config_)) {}
  bool read(Duration at_most, const std::function<Goes(const RecordedRow&)>& take);
  /// Tables that are new, or have more columns.
  void look();

  Recording recording;
  Config config;
  std::map<std::string, FollowCursor> cursors;  // by table
  std::int64_t schema_version = -1;
  RecordedRow row;
};

void RecordingFollower::Core::look() {
  const RecordingFile& file = *recording.file();
  const std::int64_t schema = file.database.integer("PRAGMA schema_version");
  if (std::exchange(schema_version, schema) == schema) return;
  for (const RecordedTopic& topic : recording.topics().or_throw()) {
    const bool is_taken = std::any_of(config.topics.begin(), config.topics.end(),
                                      [&](const std::string& pattern) { return topic_matches(pattern, topic.topic); });
    if (!is_taken) continue;
    const auto known = cursors.find(topic.table);
    if (known != cursors.end()) {
      known->second.set(topic);
    } else {
      FollowCursor& made = cursors.try_emplace(topic.table, file, topic, config.from).first->second;
      made.place = cursors.size();
    }
  }
}

bool RecordingFollower::Core::read(Duration at_most, const std::function<Goes(const RecordedRow&)>& take) {
  const auto until = std::chrono::steady_clock::now() + at_most;
  const detail::Snapshot snapshot(recording.file());
  look();
  struct End {
    ~End() {
      for (auto& [table, cursor] : all) cursor.end();
    }
    std::map<std::string, FollowCursor>& all;
  };
  const End end{cursors};
  std::vector<FollowCursor*> heap;
  for (auto& [table, cursor] : cursors) {
    cursor.begin();
    if (cursor.advance()) heap.push_back(&cursor);
  }
  std::make_heap(heap.begin(), heap.end(), is_later);
  for (std::uint64_t given = 1; !heap.empty(); ++given) {
    std::pop_heap(heap.begin(), heap.end(), is_later);
    FollowCursor* const cursor = heap.back();
    cursor->put(row);
    const bool has_enough = take(row) == Goes::enough;
    if (cursor->advance()) {
      std::push_heap(heap.begin(), heap.end(), is_later);
    } else {
      heap.pop_back();
    }
    const bool is_late = given % rows_between_looks == 0 && std::chrono::steady_clock::now() >= until;
    if (has_enough || is_late) return !heap.empty();
  }
  return false;
}

RecordingFollower::RecordingFollower(std::unique_ptr<Core> core) : core_(std::move(core)) {}
RecordingFollower::RecordingFollower(RecordingFollower&&) noexcept = default;
RecordingFollower& RecordingFollower::operator=(RecordingFollower&&) noexcept = default;
RecordingFollower::~RecordingFollower() = default;

Result<RecordingFollower> RecordingFollower::open(const std::string& path, Config config) {
  for (const std::string& topic : config.topics) {
    if (!is_topic_pattern(topic))
      return Error{Errc::bad_name, "cannot follow the recording", "topic " + topic,
                   "it is neither a topic nor a pattern", "write room/climate, room/+ or room/#"};
  }
  auto recording = Recording::open(path);
  if (!recording) return std::move(recording).error();
  return RecordingFollower(std::make_unique<Core>(*std::move(recording), std::move(config)));
}

Result<bool> RecordingFollower::read(Duration at_most, const std::function<Goes(const RecordedRow&)>& take) try {
  return core_->read(at_most, take);
} catch (const SetupError& error) {
  return error.error();
}

const Recording& RecordingFollower::recording() const noexcept { return core_->recording; }

}  // namespace rtdata
