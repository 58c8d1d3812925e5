// Checksums of the account's rows: a sum for each run, in its row of rtdata_run, changed in the same transaction as the
// rows. Thread: the lane's.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <string_view>
#include <utility>

#include "recording/checksum.hpp"
#include "recording/database.hpp"

namespace rtdata::sqlite {

/// The sum of rtdata_topic, which belongs to all runs, and of the columns of the tables that it names: in
/// rtdata_checksum.
inline constexpr std::int64_t all_runs = 0;
/// The sum of the senders' rows, which belong to all runs. Statements for these tables return this number as the first
/// column, then the whole row.
inline constexpr std::int64_t of_senders = -1;
inline constexpr std::array<std::string_view, 3> sender_tables = {"rtdata_refused", "rtdata_refused_before",
                                                                  "rtdata_unsent"};

/// How many columns of these rows are hashed: all except the checksum of rtdata_run, its last column.
int hashed_columns(sqlite3_stmt* rows) noexcept;

/// Sums are updated with added and removed rows, so they stay wrong for rows changed by another program.
class AccountSums {
 public:
  enum class Rows { come, go };
  /// Runs a statement that gives whole rows of a table whose first column is the run, such as one with RETURNING *.
  void run(Statement& statement, Rows rows = Rows::come);
  /// Subtracts the rows found by `before` and adds the rows made by `change`.
  void replace(Statement& before, Statement& change);
  /// Adds or subtracts all rows of a run, around a change of many rows.
  void add_run(const Database& database, std::int64_t run, Rows rows = Rows::come);
  void add_topic(const Database& database, std::string_view table, Rows rows = Rows::come);
  /// In the transaction, after its changes.
  void write(Database& database);
  /// The transaction was rolled back.
  void clear() noexcept { changes_.clear(); }
  /// By run: sums of added minus removed rows since the last `write`.
  const std::map<std::int64_t, std::uint64_t>& changes() const noexcept { return changes_; }
  /// Returns to an earlier result of `changes`, because later changes were undone.
  void undo_to(std::map<std::int64_t, std::uint64_t> changes) noexcept { changes_ = std::move(changes); }

 private:
  RowHash hash_;
  std::map<std::int64_t, std::uint64_t> changes_;
};

}  // namespace rtdata::sqlite
