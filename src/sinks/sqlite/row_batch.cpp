#include "sinks/sqlite/row_batch.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

namespace rtdata::detail {
namespace {

constexpr const char* function_name = "rtdata_take";
constexpr const char* pointer_type = "rtdata row batch";
constexpr int batch_argument = 0, column_argument = 1, first_argument = 2;
constexpr std::size_t most_columns = 100;  // in a call; SQLite passes up to 127 values
constexpr std::size_t most_rows = 64;

/// Calls that take all columns of a row called t.
std::string calls(const RecordedTopic& topic, const Selection& selection) {
  // SQLite would take the run out of each row for the conditions, and once more to give it.
  std::vector<std::string> columns{selection.filter.run ? ":run" : "t.run", "t.time", "t.origin", "t.sequence"};
  for (const Leaf& leaf : topic.description->leaves()) columns.push_back("t." + sqlite::quoted(leaf.path));
  std::string sql;
  for (std::size_t i = 0; i < columns.size(); ++i) {
    if (i % most_columns == 0)
      sql += (i == 0 ? "" : ") + ") + std::string(function_name) + "(:batch, " + std::to_string(i);
    sql += ", " + columns[i];
  }
  return sql + ")";
}

}  // namespace

RowBatch::RowBatch(const RecordedTopic& topic, std::size_t most_bytes)
    : reader_(topic),
      columns_(fixed_columns + topic.description->leaves().size()),
      payload_bytes_(topic.description->size()),
      most_rows_(std::clamp<std::size_t>(most_bytes / std::max<std::size_t>(payload_bytes_, 1), 1, most_rows)) {
  rows_.reserve(most_rows_);
  payloads_.resize(most_rows_ * payload_bytes_);
}

void RowBatch::provide(const sqlite::Database& database) {
  if (sqlite3_create_function_v2(database.raw(), function_name, -1, SQLITE_UTF8 | SQLITE_DIRECTONLY, nullptr, &take,
                                 nullptr, nullptr, nullptr) != SQLITE_OK)
    throw SetupError(sqlite::error_of(database.raw(), "cannot read the recording"));
}

sqlite::Statement RowBatch::query(const RecordingFile& file, const RecordedTopic& topic, const Selection& selection) {
  auto in_order = lies_in_order(file, topic, selection);
  const std::string table = sqlite::quoted(topic.table) + " t", rows = row_conditions(selection);
  // Only a row that is wanted is taken, and when its turn has come: SQLite would choose another order for two
  // conditions side by side, and sorts what was computed before. It sorts first where a limit, though it is none,
  // follows.
  auto statement = file.prepare(in_order ? "SELECT 1 FROM " + table + " WHERE CASE WHEN " + rows + " THEN " +
                                               calls(topic, selection) + " END ORDER BY t._rowid_"
                                         : "SELECT 1 FROM (SELECT * FROM " + table + " WHERE " + rows +
                                               " ORDER BY t.run, t.time, t._rowid_ LIMIT -1) t WHERE " +
                                               calls(topic, selection));
  bind_conditions(statement, selection);
  return statement;
}

void RowBatch::bind_to(sqlite::Statement& statement) noexcept {
  sqlite3_bind_pointer(statement.raw(), sqlite3_bind_parameter_index(statement.raw(), ":batch"), this, pointer_type,
                       nullptr);
}

bool RowBatch::fill(sqlite::Statement& statement) {
  rows_.clear();
  origins_.clear();
  error_.reset();
  if (!has_ended_) {
    try {
      has_ended_ = !statement.step();
    } catch (const SetupError& error) {
      has_ended_ = true;
      failed_ = error.error();
      if (!rows_.empty() && !is_row_whole_) rows_.pop_back();  // the rest of it cannot be read
    }
  }
  if (rows_.empty() && failed_) throw SetupError(*failed_);
  return !rows_.empty();
}

void RowBatch::take(sqlite3_context* context, int count, sqlite3_value** arguments) noexcept {
  auto* const batch = count > first_argument
                          ? static_cast<RowBatch*>(sqlite3_value_pointer(arguments[batch_argument], pointer_type))
                          : nullptr;
  if (batch == nullptr) return sqlite3_result_error(context, "rtdata_take is not for use in SQL", -1);
  try {
    const auto first = static_cast<std::size_t>(sqlite3_value_int64(arguments[column_argument]));
    // It reads on when the batch is full only if it takes rows for another reason than to give them.
    if (first == 0 && !batch->has_room()) return sqlite3_result_error(context, "the rows come out of turn", -1);
    sqlite3_result_int(
        context,
        batch->take(first, {arguments + first_argument, static_cast<std::size_t>(count - first_argument)}) ? 1 : 0);
  } catch (...) {  // nothing in it throws but for want of memory
    sqlite3_result_error_nomem(context);
  }
}

void RowBatch::begin_row(std::span<sqlite3_value*> fixed) {
  const auto* const text = reinterpret_cast<const char*>(sqlite3_value_text(fixed[origin_column]));
  const std::string_view origin(text != nullptr ? text : "",
                                static_cast<std::size_t>(sqlite3_value_bytes(fixed[origin_column])));
  if (origins_.empty() || origins_.back() != origin) origins_.emplace_back(origin);
  rows_.push_back({sqlite3_value_int64(fixed[run_column]), sqlite3_value_int64(fixed[time_column]),
                   static_cast<std::uint64_t>(sqlite3_value_int64(fixed[sequence_column])),
                   static_cast<std::uint32_t>(origins_.size() - 1), false});
  is_row_whole_ = false;
  std::memset(payloads_.data() + (rows_.size() - 1) * payload_bytes_, 0, payload_bytes_);
}

bool RowBatch::take(std::size_t first, std::span<sqlite3_value*> columns) {
  const bool is_last = first + columns.size() == columns_;
  if (first == 0) {
    begin_row(columns.first(fixed_columns));
    first = fixed_columns;
    columns = columns.subspan(fixed_columns);
  }
  Row& row = rows_.back();
  if (!row.is_damaged) {
    try {
      reader_.read(columns, first - fixed_columns, payloads_.data() + (rows_.size() - 1) * payload_bytes_);
    } catch (const SetupError& error) {
      row.is_damaged = true;
      error_ = error.error();
    }
  }
  is_row_whole_ = is_last;
  return is_last && (row.is_damaged || !has_room());
}

}  // namespace rtdata::detail
