// Keeps a recording within its limits: deletes the oldest rows, and counts them as pruned.
#pragma once

#include <cstdint>
#include <limits>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "recording/account_share.hpp"
#include "recording/account_sums.hpp"
#include "recording/database.hpp"
#include "recording/positions.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::sqlite {

/// First deletes runs without rows. Then deletes the rows of all topics before one instant, so that a fast sensor does
/// not displace a slow one. Deletes whole transactions of each table and keeps the last one, so that row numbers keep
/// increasing. Thread: the writer's.
class Pruner {
 public:
  Pruner() noexcept = default;
  /// `max_bytes`, `max_age`: 0 means no limit.
  Pruner(std::uint64_t max_bytes, Duration max_age);

  /// Sets the run that deletes rows from now on.
  void begin(std::int64_t run) noexcept { run_ = run; }
  bool has_limits() const noexcept { return max_bytes_ > 0 || max_age_.count() > 0; }
  /// The maximum size of the WAL file before a checkpoint; 0: no limit.
  std::uint64_t log_bytes() const noexcept { return max_bytes_ / 10; }

  /// Within a transaction: deletes rows beyond the limits, about as many as a transaction may write. `now` is a
  /// recorded time. `sums` gets changes of the account. `positions`: of the sinks that send the rows.
  void make_room(Database& database, AccountSums& sums, Positions& positions, Time now);
  /// True if the last call did not delete everything beyond the limits.
  bool has_more() const noexcept { return has_more_; }
  /// True if all deletable rows are deleted and the file is still too large.
  bool is_exhausted() const noexcept { return is_exhausted_; }
  /// The rows that the transaction has deleted, by table.
  struct Deleted {
    std::string topic;
    std::string table;
    std::int64_t up_to;  // the number of the last row
  };
  std::vector<Deleted> take_deleted() { return std::exchange(deleted_, {}); }
  /// Finalizes the statements, before the database is closed and after a rolled-back transaction.
  void close() noexcept {
    tables_.clear();
    found_tables_ = -1;
    deleted_.clear();
    share_.close();
    may_have_runs_ = true;
    for (Statement* statement : {&count_pruned_, &ledger_before_, &page_count_, &free_pages_}) *statement = Statement();
  }

 private:
  struct Table {
    std::string topic;
    std::string name;
    Statement first;  // row number, time and run of its first row
    Statement last;   // row number of the last row that may go: the end of the transaction before the last
    Statement at;     // time and run of a row, or of the next one that is there
    Statement up_to;  // row number of the last of its first rows that are all of a run and before a time
    /// Row number of the end of a transaction: of the first at a row or behind it, of the last before it.
    Statement ends[2];
    Statement count;                      // rows up to a row number, by run and origin; their last sequence and time
    Statement remove;                     // up to a row number
    std::vector<Statement> remove_steps;  // of a run and an origin, up to a time and a sequence: of each table of steps
    std::int64_t first_rowid = 0;
    std::int64_t first_time = 0;  // on the line of the present run
    std::int64_t first_run = 0;
    std::int64_t last_rowid = 0;
    bool has_rows() const noexcept { return first_rowid != 0 && last_rowid >= first_rowid; }
  };
  /// A run as the present one sees it.
  struct Line {
    std::int64_t shift = 0;      // added to its times, they are on the line of the present run
    std::int64_t run_since = 0;  // duration of later runs in ns: the least age of its rows
  };
  struct Pages {
    std::int64_t all = 0, free = 0, bytes = 1;  // bytes: of one
    std::int64_t used() const noexcept { return all - free; }
  };
  /// The objects that a transaction uses.
  struct Work {
    Database& database;
    AccountSums& sums;
    Positions* positions;  // null: nobody sends
  };
  void find_lines(Database& database, std::int64_t now);
  Line line_of(std::int64_t run) const;
  /// The rows to delete: those before `time`, and all rows of an earlier run that are at least `age` old.
  struct Limit {
    std::int64_t time;
    std::int64_t age = std::numeric_limits<std::int64_t>::max();
    bool is_exact = false;  // a transaction that is only partly beyond it stays
  };
  bool is_beyond(std::int64_t time, std::int64_t run, const Limit& limit) const;
  bool is_beyond(const Table& table, const Limit& limit) const;
  void find_tables(Database& database, std::int64_t now);
  void look_at(Table& table);
  Pages pages(Database& database);
  /// `time`, or an earlier time if that is enough to reduce the pages to `goal`; the recording may have pauses.
  std::int64_t end_of_step(std::int64_t time, const Pages& now, std::int64_t goal);
  /// Deletes at most some thousand rows beyond the limit; returns how many.
  std::int64_t delete_beyond(const Work& on, const Limit& limit);
  /// Deletes the first rows of tables that begin in the future (a wrong clock), the same share as of the others' time
  /// span.
  std::int64_t delete_part_of_future(const Work& on, std::int64_t now);
  /// The only place where rows are deleted: up to the end of the transaction that has this row, or of the one before.
  std::int64_t delete_rows(const Work& on, Table& table, std::int64_t row, const Limit& limit);
  /// Deletes runs of which no row is left, until enough pages are free. `ended_before`: only those.
  void delete_runs(Database& database, std::int64_t ended_before, std::int64_t goal, std::int64_t enough);
  void shrink(Database& database, const Pages& now);

  std::uint64_t max_bytes_ = 0;
  Duration max_age_{0};
  AccountShare share_;
  std::vector<Table> tables_;
  std::int64_t found_tables_ = -1;  // that the file had
  std::vector<Deleted> deleted_;
  std::map<std::int64_t, Line> lines_;  // by run
  std::int64_t run_ = 0;
  std::int64_t run_for_ = 0;  // ns that it has taken until now
  Statement count_pruned_;
  Statement ledger_before_;
  Statement page_count_;
  Statement free_pages_;
  std::int64_t used_before_ = 0;  // pages, after the last call
  std::int64_t next_look_ = 0;    // at the age
  bool may_have_runs_ = true;     // of which no row is left
  bool has_more_ = false;
  bool is_exhausted_ = false;
};

}  // namespace rtdata::sqlite
