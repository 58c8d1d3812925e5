// The part of verify that recomputes all hashes: of rows' values and of the account's tables.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "recording/checksum.hpp"
#include "recording/recording_file.hpp"
#include "recording/verify_run.hpp"

namespace rtdata::detail {

/// The rows of a topic's table in their order, of which the last one of each transaction has the sum.
class ValueSums {
 public:
  explicit ValueSums(std::string table) : table_(std::move(table)) {}
  /// The statement is at the next row; its columns are those of the table from `first` on.
  void add(sqlite3_stmt* row, int first, RunsRows& runs);
  /// Rows that no sum has followed.
  std::uint64_t rest() const noexcept { return found_.rows; }

 private:
  void tell_changed(sqlite3_stmt* row, int first, RunRows& run) const;

  std::string table_;
  sqlite::RowHash hash_;
  sqlite::RowSum found_;  // since the last sum
};

/// Checks the account's tables against their checksums. True: data common to all runs (rtdata_topic and the columns of
/// its tables) was changed; `check_layout` reports that.
bool check_account_sums(const RecordingFile& file, const std::vector<RecordedTopic>& topics, VerifyReport& report);

}  // namespace rtdata::detail
