// Rows of a topic's table, read some at a time: a function that the query calls for each row takes it apart at once.
// That costs a third less than a step of the query, and a call for each column, for every row.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "sinks/sqlite/recording_file.hpp"

namespace rtdata::detail {

/// Thread: one at a time. It stays where it is while a statement knows it.
class RowBatch {
 public:
  struct Row {
    std::int64_t run;
    std::int64_t time;
    std::uint64_t sequence;
    std::uint32_t origin;  // among those of the batch
    bool is_damaged;       // then it is the last one: `error` says what is wrong with it
  };

  /// So that queries on this connection may call the function.
  static void provide(const sqlite::Database& database);

  /// `most_bytes`: of the payloads that it keeps; at least one row.
  RowBatch(const RecordedTopic& topic, std::size_t most_bytes);
  RowBatch(const RowBatch&) = delete;
  RowBatch& operator=(const RowBatch&) = delete;

  /// The rows of a topic's table in their order, taken by a batch: true when it has no room for another one.
  static sqlite::Statement query(const RecordingFile& file, const RecordedTopic& topic, const Selection& selection);
  /// The statement that `query` made fills this batch.
  void bind_to(sqlite::Statement& statement) noexcept;
  /// Some more rows, from the first that the statement has not given. None: there are no more. Errors: those of the
  /// database, once the rows before are out.
  bool fill(sqlite::Statement& statement);

  std::size_t size() const noexcept { return rows_.size(); }
  const Row& operator[](std::size_t row) const noexcept { return rows_[row]; }
  std::string_view origin(const Row& row) const noexcept { return origins_[row.origin]; }
  const std::byte* payload(std::size_t row) const noexcept { return payloads_.data() + row * payload_bytes_; }
  const Error& error() const noexcept { return *error_; }

 private:
  static void take(sqlite3_context* context, int count, sqlite3_value** arguments) noexcept;
  /// Columns of a row, the first of which is this one: all of them in turn. True: the batch is to be read now.
  bool take(std::size_t first, std::span<sqlite3_value*> columns);
  bool has_room() const noexcept { return rows_.size() < most_rows_; }
  void begin_row(std::span<sqlite3_value*> fixed);

  const RowReader reader_;
  const std::size_t columns_;  // all
  const std::size_t payload_bytes_;
  const std::size_t most_rows_;
  std::vector<Row> rows_;
  std::vector<std::byte> payloads_;
  std::vector<std::string> origins_;
  bool is_row_whole_ = true;     // the last one was taken up to its last column
  std::optional<Error> error_;   // of the last row
  std::optional<Error> failed_;  // of the database, behind the last row
  bool has_ended_ = false;
};

}  // namespace rtdata::detail
