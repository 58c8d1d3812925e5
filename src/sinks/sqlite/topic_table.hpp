// The table of one topic in a recording: made, found or extended, and filled.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "rtdata/data/description.hpp"
#include "rtdata/sinks/sink.hpp"
#include "sinks/core/escaped_texts.hpp"
#include "sinks/sqlite/checksum.hpp"
#include "sinks/sqlite/database.hpp"
#include "sinks/sqlite/utc_line.hpp"
#include "sinks/sqlite/value_ranges.hpp"

namespace rtdata::sqlite {

/// Whether a table can have a column for each of its values. Errors: bad-description.
Result<void> check_columns(std::string_view topic, const Description& description);

class TopicTable {
 public:
  /// Within a transaction. Finds the table that this description fits; one whose fields are the first part of it gets
  /// the further columns; otherwise a new table is made. Errors: those of the database, bad-name.
  /// Texts that are no UTF-8 are counted in `escaped`, and the checksum of each row goes to `ranges`;
  /// both outlive the table. The view of a new table is left in `views`, to be made within the same transaction.
  static Result<TopicTable> prepare(Database& database, const SlotInfo& slot, std::int64_t run,
                                    detail::EscapedTexts& escaped, ValueRanges& ranges, NewUtcViews& views);

  /// Inserts the record, at the latest with `flush`: its payload must live until then.
  Result<void> insert(const Record& record);
  Result<void> flush();
  std::int64_t last_rowid() const noexcept { return last_rowid_; }
  const std::string& name() const noexcept { return name_; }
  const std::string& topic() const noexcept { return topic_; }

 private:
  struct Column {
    Kind kind;
    std::size_t offset;
    const Leaf* leaf;  // for what needs more than its bytes
  };
  struct Insert {
    Statement statement;
    std::vector<const SlotInfo*> bound;  // whose origin each row has: bound anew only when it is another
  };
  /// All but the origin. Hashes the row, the origin too.
  void bind(sqlite3_stmt* statement, int first, const Record& record);
  Result<void> run(Insert& insert, std::span<const Record> records);

  Database* database_ = nullptr;
  detail::EscapedTexts* escaped_ = nullptr;
  std::string name_;
  std::string topic_;
  std::vector<Column> columns_;  // in the order of the table's
  ValueRanges* ranges_ = nullptr;
  RowHash hash_;
  Insert one_;
  Insert many_;
  std::vector<Record> pending_;
  std::int64_t last_rowid_ = 0;
};

}  // namespace rtdata::sqlite
