// The part of verify that hashes everything again: values of rows, and tables of the account.
#pragma once

#include <map>
#include <string>
#include <unordered_map>
#include <vector>

#include "sinks/sqlite/account_sums.hpp"
#include "sinks/sqlite/checksum.hpp"
#include "sinks/sqlite/recording_file.hpp"

namespace rtdata::detail {

/// The checksums of one origin's rows in one table.
class RangeCheck {
 public:
  struct Range {
    std::uint64_t first_sequence, last_sequence;
    int columns;
    sqlite::RowSum said;
    bool is_known;
    sqlite::RowSum found = {};
    std::uint64_t first_found = 0, last_found = 0;
  };
  std::vector<Range> ranges;  // in the order of the sequences
  std::uint64_t beyond = 0;   // rows with a value in a column that their table did not have yet
  std::uint64_t outside = 0;  // rows in no range
  std::uint64_t first_outside = 0;

  /// The statement is at the row; its columns begin with the rowid, then come those of the table.
  void add(sqlite3_stmt* row, std::uint64_t sequence, sqlite::RowHash& hash);

 private:
  std::size_t current_ = 0;
};

/// What the checksums of a recording say, and what is found.
struct Checksums {
  struct Line {
    std::uint64_t count = 0;  // 1, or there is a mistake
    int columns = 0;
    sqlite::RowSum said;
    sqlite::RowSum found = {};
  };
  using Origins = std::unordered_map<std::string, RangeCheck>;
  std::map<std::string, std::map<std::int64_t, Origins, std::less<>>, std::less<>> values;  // by table, run, origin
  std::map<std::string, std::map<std::int64_t, Line>, std::less<>> accounts;                // by table, run
  std::vector<std::string> strays;                                                          // lines of nothing

  static Result<Checksums> load(const RecordingFile& file);
  /// Hashes the tables of the account. `problems`: rows of runs that are not there.
  Result<void> scan_accounts(const RecordingFile& file, const std::vector<std::int64_t>& runs,
                             std::vector<std::string>& problems);
  /// Adds to `strays` each checksum that covers fewer than the fixed columns or more than `columns`, all of `table`.
  void check_widths(const std::string& table, int columns);
  RangeCheck* find(std::string_view table, std::int64_t run, const std::string& origin);
};

}  // namespace rtdata::detail
