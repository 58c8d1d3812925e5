// The checksums of the values that a run records: one for each range of an origin's rows. The lane's.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "rtdata/sinks/sink.hpp"
#include "sinks/sqlite/checksum.hpp"
#include "sinks/sqlite/database.hpp"
#include "sinks/sqlite/live_file.hpp"

namespace rtdata::sqlite {

/// Ranges grow in memory with each transaction; a line is written only when one is closed, so that a small commit does
/// not write a second page for its checksum.
class ValueRanges {
 public:
  static constexpr std::uint64_t most_rows = 10'000;
  static constexpr Duration longest = std::chrono::minutes{1};

  void begin(std::int64_t run, Time started);

  /// A row that the transaction under way stores.
  void add(const Record& record, const std::string& table, int columns, std::uint64_t hash) {
    Slot& slot = touch(record.slot);
    if (slot.pending.rows == 0) [[unlikely]]
      open(slot, record, table, columns);
    slot.pending.last_sequence = record.header.sequence;
    ++slot.pending.rows;
    slot.pending.sum += hash;
  }
  /// In the transaction: writes the ranges that are full, and all of them when a minute is over or nothing follows.
  enum class Close { full, aged, all };
  Result<void> write(Database& database, Close which, Time at);
  /// A row that the transaction deletes again: the statement is at it, all columns of the table from the first on.
  void remove(sqlite3_stmt* row, const std::string& table, RowHash& hash);
  std::int64_t run() const noexcept { return run_; }
  /// Before the transaction commits, and after it: a kill leaves in the live file what is not in the recording.
  void stage(LiveFile& live) const;
  void committed(LiveFile& live);
  void rolled_back(LiveFile& live);

 private:
  struct Slot {
    const SlotInfo* info = nullptr;
    std::string table;
    int columns = 0;
    LiveRange settled{};  // as the last transaction left it
    LiveRange pending{};
    bool is_touched = false;
  };
  Slot& touch(std::uint32_t number) {
    if (number >= slots_.size()) [[unlikely]]
      slots_.resize(number + 1);
    Slot& slot = slots_[number];
    if (!slot.is_touched) {
      touched_.push_back(number);
      slot.is_touched = true;
    }
    return slot;
  }
  static void open(Slot& slot, const Record& record, const std::string& table, int columns);

  std::int64_t run_ = 0;
  std::vector<Slot> slots_;
  std::vector<std::uint32_t> touched_;
  Time closed_at_{};
  Time pending_closed_at_{};
};

/// A line of rtdata_checksum. `sum` is not read when `is_known` is false.
struct ChecksumLine {
  std::int64_t run = 0;
  std::string_view table = {};
  std::string_view origin = {};
  std::uint64_t first_sequence = 0, last_sequence = 0;
  int columns = 0;
  RowSum sum = {};
  bool is_known = true;
};
Result<void> insert_line(Database& database, const ChecksumLine& line);

/// The columns of a table.
Result<std::vector<std::string>> columns_of(const Database& database, std::string_view table);

/// In a transaction, before the rows of a data table up to this rowid are deleted: takes them out of their checksums,
/// so that what stays is still held to them. `open`: those of the run that is recorded. Gives back how many rows of
/// each (run, origin) those are.
struct DeletedRows {
  std::int64_t run;
  std::string origin;
  std::uint64_t rows;
};
Result<std::vector<DeletedRows>> sums_before_delete(Database& database, const std::string& table, std::int64_t up_to,
                                                    ValueRanges& open);

}  // namespace rtdata::sqlite
