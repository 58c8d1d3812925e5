// The table of one topic in a recording: finds, makes or extends it, and inserts rows.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "recording/account_sums.hpp"
#include "recording/database.hpp"
#include "recording/step_tables.hpp"
#include "recording/utc_line.hpp"
#include "rtdata/data/description.hpp"
#include "rtdata/sinks/sink.hpp"
#include "sinks/core/escaped_texts.hpp"

namespace rtdata::sqlite {

/// Checks that a table can have a column for each value. Errors: bad-description.
Result<void> check_columns(std::string_view topic, const Description& description);

/// In the order of the table's columns, which differs from that of the fields if a later run added some.
std::vector<const Leaf*> leaves_in_order(const Database& database, std::string_view table,
                                         const Description& description);

class TopicTable {
 public:
  /// Within a transaction: finds the table for this description. A table with only the first fields gets the missing
  /// columns; otherwise makes a new table. Errors: those of the database, bad-name. `no_utf8` counts texts that are not
  /// UTF-8 and must outlive the table. `sums` gets changes of rtdata_topic. Adds the view of a new table to `views`,
  /// which must be made in the same transaction. `steps`: null if none are recorded.
  static TopicTable prepare(Database& database, const SlotInfo& slot, std::int64_t run, detail::EscapedTexts& no_utf8,
                            AccountSums& sums, NewUtcViews& views, OpenSteps* steps);

  /// Inserts the record, at the latest with `flush`: its payload must live until then.
  void insert(const Record& record);
  /// At the end of the transaction: its last row takes the checksum.
  void flush();
  std::int64_t last_rowid() const noexcept { return last_rowid_; }
  const std::string& name() const noexcept { return name_; }
  const std::string& topic() const noexcept { return topic_; }
  std::size_t payload_bytes() const noexcept { return payload_bytes_; }

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
  void bind(Insert& insert, std::span<const Record> records);
  void run(Insert& insert);

  Database* database_ = nullptr;
  detail::EscapedTexts* no_utf8_ = nullptr;
  std::string name_;
  std::string topic_;
  std::size_t payload_bytes_ = 0;
  std::vector<Column> columns_;  // in the order of the table's
  std::int64_t run_ = 0;
  RowHash hash_;
  std::uint64_t sum_ = 0;  // of the rows of the transaction under way
  Insert one_;
  Insert many_;
  std::vector<Record> pending_;
  std::unique_ptr<StepTables> steps_;  // null: there are none
  std::int64_t last_rowid_ = 0;
};

}  // namespace rtdata::sqlite
