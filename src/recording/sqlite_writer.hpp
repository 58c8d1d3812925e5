// Writes batches and accounts into a recording: one transaction per batch.
#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "recording/account_sums.hpp"
#include "recording/account_writer.hpp"
#include "recording/database.hpp"
#include "recording/live_file.hpp"
#include "recording/positions.hpp"
#include "recording/prune.hpp"
#include "recording/recording_lock.hpp"
#include "recording/topic_table.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sinks/recording_writer.hpp"

namespace rtdata::sqlite {

class SqliteWriter final : public RecordingWriter {
 public:
  /// Makes the live file, and touches nothing else. Throws SetupError.
  SqliteWriter(const SqliteConfig& config, RunInfo run);
  ~SqliteWriter() override;

  Opening opening() const override { return Opening::at_set_up; }
  /// Opens and locks the file, updates its format, seals runs that ended without closing (reported as remarks), and
  /// begins a run.
  Result<void> open() override;
  Result<void> write(Batch& batch) override;
  Result<void> flush() override;
  Result<void> sync() override;
  Result<void> close() override;
  Result<void> add_topic(std::uint32_t number, std::string_view topic, const Description& description) override;
  LiveCounts* live_counts(std::uint32_t slot) override;
  void keep(const OriginAccount& now, const Gap* closed) override;
  bool is_recording() const noexcept override { return true; }
  std::string run() const override { return info_.uuid; }
  std::shared_ptr<const RunReport> recorded() const override { return recorded_; }
  std::unique_ptr<detail::RowFeed> feed(const detail::RowFeedConfig& config) override;
  std::optional<Error> take_warning() override;
  std::vector<std::string> take_remarks() override { return std::exchange(remarks_, {}); }
  StorePace pace() const override;

 private:
  /// The work of `open`. After an error call `forget`.
  void begin();
  void begin_in(const std::string& recording);
  /// Makes what `begin` did survive a power failure. Throws SetupError.
  void end_beginning();
  /// Nothing has been opened yet.
  void forget() noexcept;
  void configure();
  void make_schema();
  void begin_run();
  /// Up to the end of the batch, or until enough new tables are made; the views of these too.
  void write_rows(Batch& batch, Batch::Iterator& next, std::size_t& rows);
  /// The topic's table; null when it can never be made: then `untaken_` has the reason.
  TopicTable* table_of(const Record& record);
  /// Stores as much of the batch as one transaction may hold, from `next` on, and advances `next`: everything with the
  /// account, or rows until enough new tables are made.
  void write_part(Batch& batch, Batch::Iterator& next);
  /// The transaction of it. Returns how many rows it has.
  std::size_t store(Batch& batch, Batch::Iterator& next);
  /// True if the file is no longer at its path.
  bool has_moved();
  /// True if another program truncated the WAL file before it was completely in the database.
  bool is_log_cut_off();
  std::int64_t log_size();
  /// The inode of the WAL file at its path; 0: there is none.
  std::uint64_t log_inode() const;
  /// After a transaction has committed, and after it was given up.
  void committed();
  void rolled_back();
  void begin_transaction();
  void commit();
  void roll_back() noexcept;
  void prune();
  void write_positions();
  /// Maintenance between two batches.
  template <class Work>
  void transaction(Work&& work);
  /// Between two transactions: checkpoints the WAL file if due.
  void tend_log();
  Result<void> checkpoint(int mode);
  void look_at_space();
  void look_at_size();
  void tell_of_live_file(const Error& why);
  void read_account() noexcept;

  const SqliteConfig config_;
  const RunInfo info_;
  const mode_t permissions_;
  AccountSums sums_;
  RecordingLock lock_;  // of these members, released last
  LiveFile live_;
  std::vector<LiveFile> sealed_;    // of runs that `begin` has sealed
  bool has_begun_ = false;          // and that is on the disk
  bool is_in_transaction_ = false;  // begun by us; read by the hook of the connection
  Database database_;
  std::int64_t run_ = 0;  // 0: none has begun
  std::vector<std::string> remarks_;
  detail::EscapedTexts no_utf8_{"it is kept as it is, as a BLOB"};
  OpenSteps open_steps_;
  TopicTables tables_;
  NewUtcViews new_views_;
  std::map<std::uint32_t, Error> untaken_;  // topics whose tables cannot be made
  Statement begin_;
  Statement commit_;
  AccountWriter account_;
  std::optional<Error> warning_;
  Time space_looked_at_{};
  bool space_is_short_ = false;
  const std::shared_ptr<Positions> positions_ = std::make_shared<Positions>();
  std::atomic<bool> has_feeds_{false};
  Pruner pruner_;
  bool is_too_large_ = false;  // and this was reported
  bool log_is_read_ = false;   // by another program, so it could not restart the last time
  Time now_{};                 // of the last account
  using SteadyTime = std::chrono::steady_clock::time_point;
  SteadyTime readers_waited_for_at_{};
  int log_pages_ = 0;           // after the last transaction
  std::int64_t log_bytes_ = 0;  // of its file, as this writer left it
  std::uint64_t log_inode_ = 0;
  std::size_t rows_in_last_ = 0;
  std::size_t stored_rows_ = 0;  // of the batch under way, in parts before this one
  int page_bytes_ = 4096;
  bool has_told_of_live_file_ = false;
  bool is_closed_ = false;
  bool is_log_lost_ = false;
  std::shared_ptr<const RunReport> recorded_;  // once it is closed
};

/// The endings of the files that SQLite and this library keep beside a recording.
inline constexpr std::array<std::string_view, 4> companion_endings{"-wal", "-shm", "-journal", "-lock"};

/// Checks that SQLite treats the path as a file path, and that the companion files' names are not too long.
Result<void> check_path(const std::string& path);

/// Within a transaction: inserts the row of a run that begins.
void insert_run(const Database& database, const RunInfo& run, AccountSums& sums);

/// Within a transaction: seals every run still marked as recording, using its surviving live file. The caller holds the
/// recording's lock, which had the text `noted`. Runs that were killed before they had a row get one. Adds live files
/// to remove to `used`. Returns a remark for each run.
std::vector<std::string> seal_runs(Database& database, const std::string& recording, const std::string& noted,
                                   AccountSums& sums, std::vector<LiveFile>& used);

}  // namespace rtdata::sqlite
