#include <algorithm>

#include "rtdata/loop/topic.hpp"
#include "sinks/sqlite/recording_file.hpp"

namespace rtdata {
namespace detail {
namespace {

/// The rows of one table in order of run and time, the next one at hand.
struct TableCursor {
  RecordedTopic topic;
  sqlite::Statement statement;
  std::size_t place = 0;  // among the cursors
  std::int64_t run = 0;
  std::int64_t time = 0;

  /// False at the end.
  Result<bool> advance() {
    auto more = statement.step();
    if (!more || !*more) return more;
    run = statement.integer(run_column);
    time = statement.integer(time_column);
    return true;
  }
};

std::string conditions(const RowFilter& filter) {
  std::string sql = " WHERE 1";
  if (filter.run) sql += " AND t.run = :run";
  if (filter.origin) sql += " AND t.origin = :origin";
  if (filter.from) sql += " AND t.time >= :from";
  if (filter.until) sql += " AND t.time < :until";
  if (filter.every > 1) sql += " AND (t.sequence - 1) % :every = 0";
  return sql;
}

void bind(sqlite::Statement& statement, const RowFilter& filter) {
  const auto index = [&](const char* name) { return sqlite3_bind_parameter_index(statement.raw(), name); };
  if (filter.run) statement.bind(index(":run"), *filter.run);
  if (filter.origin) {  // a copy of it: the filter may go or move
    sqlite3_bind_text64(statement.raw(), index(":origin"), filter.origin->data(), filter.origin->size(),
                        SQLITE_TRANSIENT, SQLITE_UTF8);
  }
  if (filter.from) statement.bind(index(":from"), to_nanoseconds(*filter.from));
  if (filter.until) statement.bind(index(":until"), to_nanoseconds(*filter.until));
  if (filter.every > 1)
    statement.bind(index(":every"), static_cast<std::int64_t>(std::min<std::uint64_t>(filter.every, INT64_MAX)));
}

/// Whether the rows lie in the order of time. They are written in the order in which they were published. That is the
/// order of time unless several origins share the table and one of them measures long: then SQLite sorts, which takes
/// longer.
Result<bool> is_in_order(const RecordingFile& file, const RecordedTopic& topic, const RowFilter& filter) {
  auto statement = file.prepare("SELECT t.run, t.time FROM " + sqlite::quoted(topic.table) + " t" + conditions(filter) +
                                " ORDER BY t.rowid");
  if (!statement) return std::move(statement).error();
  bind(*statement, filter);
  std::int64_t run = INT64_MIN, time = INT64_MIN;
  for (;;) {
    auto more = statement->step();
    if (!more) return std::move(more).error();
    if (!*more) return true;
    const std::int64_t next_run = statement->integer(0), next_time = statement->integer(1);
    if (next_run < run || (next_run == run && next_time < time)) return false;
    run = next_run;
    time = next_time;
  }
}

}  // namespace

Result<sqlite::Statement> rows_in_order(const RecordingFile& file, const RecordedTopic& topic,
                                        const RowFilter& filter) {
  auto in_order = is_in_order(file, topic, filter);
  if (!in_order) return std::move(in_order).error();
  auto statement = file.prepare("SELECT t.run, t.time, t.origin, t.sequence" + RowReader(topic).columns() + " FROM " +
                                sqlite::quoted(topic.table) + " t" + conditions(filter) +
                                (*in_order ? " ORDER BY t.rowid" : " ORDER BY t.run, t.time, t.rowid"));
  if (statement) bind(*statement, filter);
  return statement;
}

Error at_row(const RecordingFile& file, const RecordedTopic& topic, std::int64_t run, std::string_view origin,
             std::uint64_t sequence, Error error) {
  error.where = file.database.path() + ", topic " + topic.topic + ", run " + std::to_string(run) + ", origin " +
                std::string(origin) + ", sequence " + std::to_string(sequence) + ", " + error.where;
  return error;
}

struct RowsMerge {
  RowsMerge(std::shared_ptr<RecordingFile> file_, Snapshot snapshot_, RowFilter filter_)
      : file(std::move(file_)), snapshot(std::move(snapshot_)), filter(std::move(filter_)) {}

  std::shared_ptr<RecordingFile> file;
  Snapshot snapshot;
  RowFilter filter;
  std::vector<std::unique_ptr<TableCursor>> cursors;
  std::vector<TableCursor*> heap;
  TableCursor* last = nullptr;  // gave the row that is out; goes on at the next call
  std::uint64_t given = 0;
  std::int64_t first_run_with_escapes = 0;
  RecordedRow row;

  static bool is_later(const TableCursor* a, const TableCursor* b) noexcept {
    if (a->run != b->run) return a->run > b->run;
    if (a->time != b->time) return a->time > b->time;
    return a->place > b->place;
  }

  Result<void> add(RecordedTopic topic) {
    auto statement = rows_in_order(*file, topic, filter);
    if (!statement) return std::move(statement).error();
    cursors.push_back(
        std::make_unique<TableCursor>(TableCursor{std::move(topic), std::move(*statement), cursors.size()}));
    return push(*cursors.back());
  }

  Result<void> push(TableCursor& cursor) {
    auto more = cursor.advance();
    if (!more) return std::move(more).error();
    if (!*more) return {};
    heap.push_back(&cursor);
    std::push_heap(heap.begin(), heap.end(), is_later);
    return {};
  }
};

}  // namespace detail

Rows::Rows(std::unique_ptr<detail::RowsMerge> merge) : merge_(std::move(merge)) {}
Rows::Rows(Rows&&) noexcept = default;
Rows& Rows::operator=(Rows&&) noexcept = default;
Rows::~Rows() = default;

Result<const RecordedRow*> Rows::next() {
  detail::RowsMerge& merge = *merge_;
  if (merge.filter.limit != 0 && merge.given >= merge.filter.limit) return nullptr;
  if (detail::TableCursor* last = std::exchange(merge.last, nullptr)) {
    if (auto pushed = merge.push(*last); !pushed) return std::move(pushed).error();
  }
  if (merge.heap.empty()) return nullptr;
  std::pop_heap(merge.heap.begin(), merge.heap.end(), detail::RowsMerge::is_later);
  detail::TableCursor& cursor = *merge.heap.back();
  merge.heap.pop_back();
  merge.last = &cursor;
  ++merge.given;
  RecordedRow& row = merge.row;
  row.run_ = cursor.run;
  row.topic_ = &cursor.topic;
  row.origin_.assign(cursor.statement.text(detail::origin_column));
  row.header_ = {from_nanoseconds(cursor.time),
                 static_cast<std::uint64_t>(cursor.statement.integer(detail::sequence_column)), row.origin_};
  row.payload_.resize(cursor.topic.description->size());
  if (auto read = detail::RowReader(cursor.topic)
                      .read(cursor.statement.raw(), detail::fixed_columns,
                            cursor.run >= merge.first_run_with_escapes ? detail::RowReader::Texts::with_escapes
                                                                       : detail::RowReader::Texts::as_they_are,
                            row.payload_.data());
      !read) {
    return at_row(*merge.file, cursor.topic, row.run_, row.origin_, row.header_.sequence, std::move(read).error());
  }
  return &row;
}

Result<Rows> Recording::rows(const RowFilter& filter) const {
  if (!is_topic_pattern(filter.topic)) {
    return Error{Errc::bad_name, "cannot select rows", "topic " + filter.topic, "it is neither a topic nor a pattern",
                 "write room/climate, room/+ or room/#"};
  }
  if (filter.every == 0)
    return Error{Errc::bad_argument, "cannot select rows", "every", "it is 0", "1 takes every row"};
  auto snapshot = detail::Snapshot::take(file_);
  if (!snapshot) return std::move(snapshot).error();
  auto merge = std::make_unique<detail::RowsMerge>(file_, std::move(*snapshot), filter);
  auto first_run = file_->first_run_with_escapes();
  if (!first_run) return std::move(first_run).error();
  merge->first_run_with_escapes = *first_run;
  auto all = topics();
  if (!all) return std::move(all).error();
  for (RecordedTopic& topic : *all) {
    if (!topic_matches(filter.topic, topic.topic)) continue;
    if (auto added = merge->add(std::move(topic)); !added) return std::move(added).error();
  }
  return Rows(std::move(merge));
}

}  // namespace rtdata
