// The checksums of the tables of the account: of each, one for all rows of a run. The lane's.
//
// Whatever this connection does to these tables is seen by triggers that exist in it alone (TEMP), so that no statement
// needs to say what it changes, and the sums stay exact when rows are joined, sealed or pruned.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <string_view>

#include "sinks/sqlite/checksum.hpp"
#include "sinks/sqlite/database.hpp"

namespace rtdata::sqlite {

/// rtdata_topic is of all runs.
inline constexpr std::string_view topic_table_name = "rtdata_topic";
inline constexpr std::int64_t all_runs = 0;

class AccountSums {
 public:
  AccountSums() = default;
  AccountSums(const AccountSums&) = delete;
  AccountSums& operator=(const AccountSums&) = delete;

  /// In a transaction: watches the account tables of this connection from now on. They have all their columns. It must
  /// outlive the connection's last statement.
  Result<void> watch(Database& database);
  /// The run whose lines are written when it ends; 0: none.
  void begin(std::int64_t run) { open_run_ = run; }
  /// As it was made; the connection that was watched is closed.
  void forget() noexcept {
    open_run_ = 0;
    settled_ = {};
    pending_.clear();
  }
  /// What its lines would say now, with what the transaction under way did.
  RunSums sums_of(std::int64_t run) const;
  /// From here on the run's sums are these: of one that is to be sealed.
  void set(std::int64_t run, const RunSums& sums) { pending_[run].sums = sums; }

  /// In a transaction, after its changes: brings the lines of ended runs in line with what it did to their accounts.
  Result<void> write_changes(Database& database);
  /// In a transaction: the run has ended. Of the open one, as the last change of its account.
  Result<void> write_lines(Database& database, std::int64_t run);
  void committed();
  void rolled_back() { pending_.clear(); }

 private:
  struct Change {
    RunSums sums{};
    RowSum topics;
    bool has_ended = false;  // the open run
  };
  static void changed(sqlite3_context* context, int count, sqlite3_value** values);

  RowHash hash_;
  std::int64_t open_run_ = 0;
  RunSums settled_{};                       // of the open run, as the last transaction left it
  std::map<std::int64_t, Change> pending_;  // by run: what the transaction under way added and took away
  std::array<int, account_tables.size() + 1> columns_{};
};

/// What is in the account tables of a run.
Result<RunSums> sums_found(const Database& database, std::int64_t run);

}  // namespace rtdata::sqlite
