#include <algorithm>
#include <cstring>

#include "data/field_map.hpp"
#include "data/nearest.hpp"
#include "recording/rows_merge.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata {
namespace detail {

// ---- selecting

Selection Selection::make(const Recording& recording, const RowFilter& filter) {
  if (!is_topic_pattern(filter.topic)) {
    throw SetupError({Errc::bad_name, "cannot select rows", "topic " + filter.topic,
                      "it is neither a topic nor a pattern", "write room/climate, room/+ or room/#"});
  }
  if (filter.every == 0)
    throw SetupError({Errc::bad_argument, "cannot select rows", "every", "it is 0", "1 takes every row"});
  Selection selection{filter, {}};
  if (filter.times == RowFilter::Times::recorded || (!filter.from && !filter.until)) return selection;
  auto runs = recording.runs().or_throw();
  for (const RunInfo& run : runs) {
    if (filter.run && run.run != *filter.run) continue;
    auto line = recording.utc_line(run.run).or_throw();
    Bounds& bounds = selection.bounds.emplace_back(Bounds{run.run, {}, {}});
    if (filter.from) bounds.from = line.recorded(*filter.from);
    if (filter.until) bounds.until = line.recorded(*filter.until);
  }
  return selection;
}

std::string conditions(const Selection& selection, const char* from_column, const char* until_column) {
  const RowFilter& filter = selection.filter;
  std::string sql = "1";
  if (filter.run) sql += " AND t.run = :run";
  if (filter.origin) sql += " AND t.origin = :origin";
  const auto bound = [&](const char* name, auto of) {  // ":from", or that of each run
    if (selection.bounds.empty()) return std::string(name);
    std::string text = "CASE t.run";
    for (const Selection::Bounds& run : selection.bounds)
      text += " WHEN " + std::to_string(run.run) + " THEN " + std::to_string(to_nanoseconds(*of(run)));
    return text + " ELSE " + name + " END";
  };
  if (filter.from) {
    sql += std::string(" AND ") + from_column +
           " >= " + bound(":from", [](const Selection::Bounds& run) { return run.from; });
  }
  if (filter.until) {
    sql += std::string(" AND ") + until_column + " < " +
           bound(":until", [](const Selection::Bounds& run) { return run.until; });
  }
  return sql;
}

void bind_conditions(sqlite::Statement& statement, const Selection& selection) {
  const RowFilter& filter = selection.filter;
  const auto index = [&](const char* name) { return sqlite3_bind_parameter_index(statement.raw(), name); };
  if (filter.run) statement.bind(index(":run"), *filter.run);
  if (filter.origin) {  // a copy of it: the filter may go or move
    sqlite3_bind_text64(statement.raw(), index(":origin"), filter.origin->data(), filter.origin->size(),
                        SQLITE_TRANSIENT, SQLITE_UTF8);
  }
  if (filter.from) statement.bind(index(":from"), to_nanoseconds(*filter.from));
  if (filter.until) statement.bind(index(":until"), to_nanoseconds(*filter.until));
  if (const int every = index(":every"); every != 0)
    statement.bind(every, static_cast<std::int64_t>(std::min<std::uint64_t>(filter.every, INT64_MAX)));
}

std::string row_conditions(const Selection& selection) {
  return conditions(selection, "t.time", "t.time") +
         (selection.filter.every > 1 ? " AND (t.sequence - 1) % :every = 0" : "");
}

namespace {

/// True if the rows of each run have one origin, which publishes in time order.
bool has_one_origin(const RecordingFile& file, const RecordedTopic& topic, const RowFilter& filter) {
  if (filter.origin) return true;
  // A running or killed run may have origins that no account has yet.
  auto statement = file.prepare(
      "SELECT EXISTS(SELECT 1 FROM rtdata_run r WHERE r.state = 'recording' AND ifnull(r.run = :run, 1))"
      " OR EXISTS(SELECT 1 FROM rtdata_ledger t WHERE t.topic = :topic AND ifnull(t.run = :run, 1)"
      " GROUP BY t.run HAVING count(*) > 1)");
  statement.bind(sqlite3_bind_parameter_index(statement.raw(), ":topic"), std::string_view(topic.topic));
  if (filter.run) statement.bind(sqlite3_bind_parameter_index(statement.raw(), ":run"), *filter.run);
  statement.step();
  return statement.integer(0) == 0;
}

/// True if all rows are in time order. They are written in the order of publishing, which differs from time order only
/// if several origins share the table and one of them measures for long.
bool has_order(const RecordingFile& file, const RecordedTopic& topic, const Selection& selection) {
  auto statement = file.prepare("SELECT t.run, t.time FROM " + sqlite::quoted(topic.table) + " t WHERE " +
                                row_conditions(selection) + " ORDER BY t._rowid_");
  bind_conditions(statement, selection);
  std::int64_t run = INT64_MIN, time = INT64_MIN;
  while (statement.step()) {
    const std::int64_t next_run = statement.integer(0), next_time = statement.integer(1);
    if (next_run < run || (next_run == run && next_time < time)) return false;
    run = next_run;
    time = next_time;
  }
  return true;
}

}  // namespace

sqlite::Statement rows_in_order(const RecordingFile& file, const RecordedTopic& topic, const Selection& selection,
                                const std::string& columns) {
  // Otherwise SQLite must sort them, which takes longer.
  const bool in_order = has_one_origin(file, topic, selection.filter) || has_order(file, topic, selection);
  // SQLite would read the run of each row for `WHERE`, and again for the result.
  const char* const run = selection.filter.run ? ":run" : "t.run";
  auto statement = file.prepare("SELECT " + std::string(run) + ", t.time, t.origin, t.sequence" + columns + " FROM " +
                                sqlite::quoted(topic.table) + " t WHERE " + row_conditions(selection) +
                                (in_order ? " ORDER BY t._rowid_" : " ORDER BY t.run, t.time, t._rowid_"));
  bind_conditions(statement, selection);
  return statement;
}

Error behind_row(const RecordingFile& file, const RecordedTopic& topic, std::int64_t run, std::uint64_t sequence,
                 Error error) {
  error.where = file.database.path() + ", topic " + topic.topic;
  if (sequence > 0) error.where += ", after run " + std::to_string(run) + ", sequence " + std::to_string(sequence);
  return error;
}

Error at_row(const RecordingFile& file, const RecordedTopic& topic, std::int64_t run, std::string_view origin,
             std::uint64_t sequence, Error error) {
  error.where = file.database.path() + ", topic " + topic.topic + ", run " + std::to_string(run) + ", origin " +
                std::string(origin) + ", sequence " + std::to_string(sequence) + ", " + error.where;
  return error;
}

// ---- cursors

namespace {

class TableCursor final : public RowCursor {
 public:
  TableCursor(const RecordingFile& file, RecordedTopic topic, const Selection& selection)
      : file_(file),
        topic_(std::move(topic)),
        reader_(topic_),
        statement_(rows_in_order(file, topic_, selection, reader_.columns())) {}

  bool advance() override {
    try {
      if (!statement_.step()) return false;
    } catch (const SetupError& error) {
      throw SetupError(behind_row(file_, topic_, run, last_sequence_, error.error()));
    }
    const std::int64_t last_run = std::exchange(run, statement_.integer(run_column));
    const std::int64_t last_time = std::exchange(time, statement_.integer(time_column));
    const auto sequence = static_cast<std::uint64_t>(statement_.integer(sequence_column));
    if (!is_first_ && run == last_run && time < last_time) [[unlikely]] {
      throw SetupError(at_row(file_, topic_, run, statement_.text(origin_column), sequence,
                              {Errc::damaged, "cannot read the rows in order", "time",
                               "it is before that of the row before it, of the same origin", "see `rtdata verify`"}));
    }
    is_first_ = false;
    last_sequence_ = sequence;
    return true;
  }

  void give(RecordedRow& row) override {
    std::byte* const payload = set_event(row, statement_.text(origin_column), last_sequence_, topic_);
    try {
      reader_.read(statement_.raw(), fixed_columns, payload);
    } catch (const SetupError& error) {
      throw SetupError(at_row(file_, topic_, run, row.header().origin, last_sequence_, error.error()));
    }
  }

 private:
  const RecordingFile& file_;
  const RecordedTopic topic_;
  const RowReader reader_;
  sqlite::Statement statement_;
  std::uint64_t last_sequence_ = 0;  // sequence of the current row
  bool is_first_ = true;
};

class GapCursor final : public RowCursor {
 public:
  GapCursor(std::string pattern, sqlite::Statement statement)
      : pattern_(std::move(pattern)), statement_(std::move(statement)) {}

  bool advance() override {
    do {
      if (!statement_.step()) return false;
    } while (!topic_matches(pattern_, statement_.text(1)));
    run = statement_.integer(0);
    time = statement_.integer(5);
    return true;
  }
  void give(RecordedRow& row) override {
    const auto text = [&](int column) { return std::string(statement_.text(column)); };
    gap_ = {text(1),
            text(2),
            text(3),
            text(4),
            from_nanoseconds(time),
            from_nanoseconds(statement_.integer(6)),
            static_cast<std::uint64_t>(statement_.integer(7))};
    topic_.topic = gap_.topic;
    set_gap(row, gap_, topic_);
  }
  bool is_gap() const noexcept override { return true; }

 private:
  const std::string pattern_;
  sqlite::Statement statement_;
  RecordedGap gap_;
  RecordedTopic topic_;
};

}  // namespace

std::unique_ptr<RowCursor> make_table_cursor(const RecordingFile& file, RecordedTopic topic,
                                             const Selection& selection) {
  return std::make_unique<TableCursor>(file, std::move(topic), selection);
}

std::unique_ptr<RowCursor> make_gap_cursor(const RecordingFile& file, const Selection& selection) {
  auto statement = file.prepare(
      "SELECT t.run, t.topic, t.origin, t.kind, t.reason, t.first, t.last, t.count"
      " FROM rtdata_gap t WHERE " +
      conditions(selection, "t.last", "t.first") + " ORDER BY t.run, t.first, t._rowid_");
  bind_conditions(statement, selection);
  return std::unique_ptr<RowCursor>(std::make_unique<GapCursor>(selection.filter.topic, std::move(statement)));
}

// ---- merging

namespace {

bool is_later(const RowCursor* a, const RowCursor* b) noexcept {
  if (a->run != b->run) return a->run > b->run;
  if (a->time != b->time) return a->time > b->time;
  return a->place > b->place;
}

}  // namespace

void RowsMerge::add(std::unique_ptr<RowCursor> cursor) {
  cursor->place = cursors.size();
  cursors.push_back(std::move(cursor));
  if (!cursors.back()->advance()) return;
  heap.push_back(cursors.back().get());
  std::push_heap(heap.begin(), heap.end(), is_later);
}

RowCursor* RowsMerge::next() {
  if (RowCursor* const gone_on = std::exchange(last, nullptr)) {
    if (gone_on->advance()) {
      if (heap.empty() || !is_later(gone_on, heap.front())) return last = gone_on;
      heap.push_back(gone_on);
      std::push_heap(heap.begin(), heap.end(), is_later);
    }
  }
  if (heap.empty()) return nullptr;
  std::pop_heap(heap.begin(), heap.end(), is_later);
  last = heap.back();
  heap.pop_back();
  return last;
}

}  // namespace detail

Rows::Rows(std::unique_ptr<detail::RowsMerge> merge) : merge_(std::move(merge)) {}
Rows::Rows(Rows&&) noexcept = default;
Rows& Rows::operator=(Rows&&) noexcept = default;
Rows::~Rows() = default;

Result<const RecordedRow*> Rows::next() try {
  detail::RowsMerge& merge = *merge_;
  if (merge.limit != 0 && merge.given >= merge.limit) return nullptr;
  detail::RowCursor* const cursor = merge.next();
  if (cursor == nullptr) return nullptr;
  if (!cursor->is_gap()) ++merge.given;
  cursor->put(merge.row);
  return &merge.row;
} catch (const SetupError& error) {
  return error.error();
}

namespace {

/// A merge of the gaps, if they are asked for, and of what `add` adds for each table.
template <class Add>
std::unique_ptr<detail::RowsMerge> merged(const Recording& recording, const RowFilter& filter, Add add) {
  auto merge = std::make_unique<detail::RowsMerge>(recording.file(), detail::Snapshot(recording.file()), filter.limit);
  const auto selection = detail::Selection::make(recording, filter);
  if (filter.gaps == RowFilter::Gaps::in_place) merge->add(detail::make_gap_cursor(*merge->file, selection));
  auto all = recording.topics().or_throw();
  std::erase_if(all, [&](const RecordedTopic& topic) { return !topic_matches(filter.topic, topic.topic); });
  for (RecordedTopic& topic : all) add(*merge, std::move(topic), selection);
  return merge;
}

}  // namespace

Result<Rows> Recording::rows(const RowFilter& filter) const try {
  return Rows(merged(*this, filter, [](auto& to, RecordedTopic topic, const detail::Selection& selection) {
    to.add(detail::make_table_cursor(*to.file, std::move(topic), selection));
  }));
} catch (const SetupError& error) {
  return error.error();
}

Result<Rows> Recording::steps(const RowFilter& filter, Duration step, std::span<const std::string> fields) const try {
  if (step < Duration{1}) {
    throw SetupError({Errc::bad_argument, "cannot select steps", "step " + to_string(step), "it is not above 0",
                      "give the length of a step, such as 1 s"});
  }
  return Rows(merged(*this, filter, [&](auto& to, RecordedTopic topic, const detail::Selection& selection) {
    detail::add_step_cursors(to, *this, std::move(topic), selection, step, fields);
  }));
} catch (const SetupError& error) {
  return error.error();
}

// ---- of a type

namespace detail {

Result<std::shared_ptr<const void>> make_recorded_map(const RecordedTopic& topic, const Description& wanted) {
  auto map = map_fields(*topic.description, wanted);
  if (map) return std::shared_ptr<const void>(std::make_shared<const FieldMap>(*std::move(map)));
  return Error{Errc::description_differs, "cannot read topic " + topic.topic + " as " + wanted.name(),
               "table " + topic.table, map.error().why,
               "read it as a type with the fields that it has; `rtdata info` lists them"};
}

void apply_recorded_map(const void* map, const std::byte* from, std::byte* to) noexcept {
  static_cast<const FieldMap*>(map)->apply(from, to);
}

}  // namespace detail

Result<void> Recording::check_type(const RowFilter& filter, const Description& wanted) const try {
  auto all = topics().or_throw();
  bool is_any = false;
  for (const RecordedTopic& topic : all) {
    if (!is_topic_pattern(filter.topic)) break;  // which `rows` refuses
    if (!topic_matches(filter.topic, topic.topic)) continue;
    is_any = true;
    auto map = detail::make_recorded_map(topic, wanted);
    if (map) continue;
    auto statement = file_->prepare("SELECT 1 FROM " + sqlite::quoted(topic.table) + " t" +
                                    (filter.run ? " WHERE t.run = " + std::to_string(*filter.run) : "") + " LIMIT 1");
    if (statement.step()) return std::move(map).error();
  }
  if (is_any || !is_topic_name(filter.topic)) return {};
  std::vector<std::string_view> names;
  for (const RecordedTopic& topic : all) names.push_back(topic.topic);
  return Error{Errc::not_found, "cannot read events", path(), "it has no topic " + filter.topic,
               detail::suggestion(filter.topic, names)};
} catch (const SetupError& error) {
  return error.error();
}

}  // namespace rtdata
