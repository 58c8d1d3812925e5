// The table of one topic in a recording: made, found or extended, and filled.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "rtdata/data/description.hpp"
#include "rtdata/sinks/sink.hpp"
#include "sinks/sqlite/database.hpp"

namespace rtdata::sqlite {

class TopicTable {
 public:
  /// Within a transaction. Finds the table that this description fits; one whose fields are the first part of it gets the
  /// further columns; otherwise a new table is made. Errors: those of the database, bad-name.
  static Result<TopicTable> prepare(Database& database, const SlotInfo& slot, std::int64_t run);

  /// Inserts the record, at the latest with `flush`: its payload must live until then.
  Result<void> insert(const Record& record);
  Result<void> flush();
  /// After the transaction was rolled back.
  void forget() noexcept { pending_.clear(); }
  std::int64_t last_rowid() const noexcept { return last_rowid_; }
  const std::string& name() const noexcept { return name_; }

 private:
  struct Column {
    Kind kind;
    std::size_t offset;
    const Leaf* leaf;  // for what needs more than its bytes
  };
  void bind(sqlite3_stmt* statement, int first, const Record& record) const;
  Result<void> run(Statement& statement, std::span<const Record> records);

  Database* database_ = nullptr;
  std::string name_;
  std::int64_t run_ = 0;
  std::vector<Column> columns_;
  std::size_t rows_per_statement_ = 1;
  Statement one_;
  Statement many_;
  std::vector<Record> pending_;
  std::int64_t last_rowid_ = 0;
};

}  // namespace rtdata::sqlite
