// Work of the SQLite writer between transactions: checkpoints the WAL file, detects that another program has truncated
// it or moved the file, and watches the sizes.
#include <sys/stat.h>
#include <sys/statvfs.h>

#include <algorithm>

#include "recording/sqlite_writer.hpp"

namespace rtdata::sqlite {
namespace {

// A small WAL file stays in the caches. A slowly growing one holds the same pages many times, and a checkpoint writes
// each page once, so late checkpoints write less.
constexpr std::uint64_t log_bytes_at_most = std::uint64_t{4} << 20;
constexpr std::uint64_t log_bytes_when_fast = std::uint64_t{1} << 20;
constexpr std::size_t rows_when_fast = 1000;  // in a transaction
constexpr Duration reader_wait_interval = std::chrono::seconds{1};
constexpr int reader_wait_ms = 200;
constexpr int busy_ms = 2000;
constexpr std::uint64_t short_of_space = std::uint64_t{64} << 20;
constexpr Duration space_interval = std::chrono::seconds{10};

}  // namespace

std::int64_t SqliteWriter::log_size() {
  sqlite3_file* log = nullptr;
  sqlite3_int64 size = 0;
  const bool is_known = sqlite3_file_control(database_.raw(), "main", SQLITE_FCNTL_JOURNAL_POINTER, &log) ==
                            SQLITE_OK &&
                        log != nullptr && log->pMethods != nullptr && log->pMethods->xFileSize(log, &size) == SQLITE_OK;
  return is_known ? size : -1;
}

std::uint64_t SqliteWriter::log_inode() const {
  struct stat about {};
  const char* const path = sqlite3_filename_wal(sqlite3_db_filename(database_.raw(), "main"));
  return ::stat(path, &about) == 0 ? about.st_ino : 0;
}

bool SqliteWriter::is_log_cut_off() {
  if (is_log_lost_) return true;
  const std::int64_t size = log_size();
  if (size < 0 || size >= log_bytes_) return false;
  // Another program may have checkpointed and emptied it; then it has nothing to read.
  return size != 0 || !checkpoint(SQLITE_CHECKPOINT_PASSIVE);
}

bool SqliteWriter::has_moved() {
  int moved = 0;
  return sqlite3_file_control(database_.raw(), "main", SQLITE_FCNTL_HAS_MOVED, &moved) == SQLITE_OK && moved != 0;
}

void SqliteWriter::tend_log() {
  if (is_log_cut_off()) {
    // The file is consistent up to the last checkpoint; applying the rest of the WAL file would damage it.
    (void)sqlite3_db_config(database_.raw(), SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, 1, nullptr);
    is_log_lost_ = true;
    throw SetupError({Errc::closed, "recording has ended", config_.path,
                      "its WAL file, " + config_.path + "-wal, was cut off: rows that were only there are lost",
                      "do not change it during recording; the next start seals the run"});
  }
  const std::uint64_t limit = pruner_.log_bytes();
  std::uint64_t most = rows_in_last_ >= rows_when_fast ? log_bytes_when_fast : log_bytes_at_most;
  if (limit != 0) most = std::min(most, limit / 2);
  const auto bytes = static_cast<std::uint64_t>(log_pages_) * static_cast<std::uint64_t>(page_bytes_);
  const SteadyTime now = std::chrono::steady_clock::now();
  if (bytes >= most) {
    const Positions::HoldOff hold_off(*positions_);
    checkpoint(SQLITE_CHECKPOINT_PASSIVE).or_throw();
    log_pages_ = 0;
    // A permanent reader prevents the WAL file from restarting, so wait for a moment without readers.
    if (limit != 0 && bytes >= limit && now - readers_waited_for_at_ >= reader_wait_interval) {
      readers_waited_for_at_ = now;
      sqlite3_busy_timeout(database_.raw(), reader_wait_ms);
      auto done = checkpoint(SQLITE_CHECKPOINT_RESTART);
      sqlite3_busy_timeout(database_.raw(), busy_ms);
      done.or_throw();
    }
  }
  if (config_.max_bytes != 0) look_at_size();
}

Result<void> SqliteWriter::checkpoint(int mode) {
  const int status = sqlite3_wal_checkpoint_v2(database_.raw(), nullptr, mode, nullptr, nullptr);
  if (mode == SQLITE_CHECKPOINT_RESTART) log_is_read_ = (status & 0xff) == SQLITE_BUSY;
  if (status != SQLITE_OK && (status & 0xff) != SQLITE_BUSY)
    return error_of(database_.raw(), "cannot checkpoint the recording");
  log_bytes_ = std::max<std::int64_t>(log_size(), 0);
  return {};
}

Result<void> SqliteWriter::sync() {
  sqlite3_file* log = nullptr;
  if (sqlite3_file_control(database_.raw(), "main", SQLITE_FCNTL_JOURNAL_POINTER, &log) != SQLITE_OK ||
      log == nullptr || log->pMethods == nullptr) {
    return {};
  }
  if (log->pMethods->xSync(log, SQLITE_SYNC_NORMAL) == SQLITE_OK) return {};
  return Error{Errc::io_failed, "cannot force the recording's WAL file onto the disk", config_.path + "-wal", "", ""};
}

/// Warns once when a limit does not hold, and again only after it has held.
void SqliteWriter::look_at_size() {
  std::uint64_t total = 0;
  for (const char* part : {"", "-wal", "-shm"}) {
    struct stat status {};
    if (::stat((config_.path + part).c_str(), &status) == 0) total += static_cast<std::uint64_t>(status.st_size);
  }
  const bool is_too_large = total > config_.max_bytes + config_.max_bytes / 10;
  const bool has_cause = pruner_.is_exhausted() || log_is_read_;  // otherwise it becomes smaller soon
  if (is_too_large && !is_too_large_ && !pruner_.has_more() && has_cause) {
    warning_ = Error{Errc::storage_full, "the recording is larger than `max_bytes`", config_.path,
                     std::to_string(total) + " bytes" +
                         (pruner_.is_exhausted() ? ": its accounts alone need this much"
                                                 : ": another program holds a transaction open"),
                     pruner_.is_exhausted() ? "raise `max_bytes`, or record into another file"
                                            : "end its query: until then no space can be used again"};
    is_too_large_ = true;
  }
  if (total <= config_.max_bytes) is_too_large_ = false;
}

void SqliteWriter::look_at_space() {
  if (now_ - space_looked_at_ < space_interval) return;
  space_looked_at_ = now_;
  struct statvfs space {};
  if (::statvfs(config_.path.c_str(), &space) != 0) return;
  const std::uint64_t free = std::uint64_t{space.f_bavail} * space.f_frsize;
  const bool is_short = free < short_of_space;
  if (is_short && !space_is_short_) {
    warning_ = Error{Errc::storage_full, "space runs out", config_.path, std::to_string(free >> 20) + " MiB are left",
                     "make room, or set `max_bytes` or `max_age`"};
  }
  space_is_short_ = is_short;
}

}  // namespace rtdata::sqlite
