// How the SQLite writer begins: opens and locks the file, makes its tables, seals older runs, begins its own.
#include <unistd.h>

#include "sinks/sqlite/schema.hpp"
#include "sinks/sqlite/sqlite_writer.hpp"
#include "sinks/sqlite/utc_line.hpp"

namespace rtdata::sqlite {
namespace {

/// The version of the recording's format; 0: the file is empty.
Result<std::int64_t> format_of(const Database& database, const std::string& path) {
  auto id = database.integer("PRAGMA application_id");
  if (!id) return std::move(id).error();
  if (*id != application_id) {
    auto tables = database.integer("SELECT count(*) FROM sqlite_schema");
    if (!tables) return std::move(tables).error();
    if (*tables == 0) return 0;
    if (*id == application_id_before)
      return Error{Errc::not_a_recording, "cannot record into", path, written_before, advice_before};
    return Error{Errc::not_a_recording, "cannot record into", path, "it is another program's SQLite database",
                 "choose another path"};
  }
  auto version = database.integer("PRAGMA user_version");
  if (!version) return std::move(version).error();
  if (*version > schema_version) {
    return Error{Errc::newer_version, "cannot record into", path,
                 "a newer version wrote it (format " + std::to_string(*version) + ", this one knows " +
                     std::to_string(schema_version) + ")",
                 "update rt-data, or choose another path"};
  }
  return *version;
}

}  // namespace

std::string host_name() {
  char name[256] = {};
  return ::gethostname(name, sizeof name - 1) == 0 ? name : "";
}

Result<void> SqliteWriter::begin() {
  if (auto is_path = check_path(config_.path); !is_path) return is_path;
  auto database = Database::open(config_.path, Database::Mode::write, permissions_);
  if (!database) return std::move(database).error();
  database_ = std::move(*database);
  if (sqlite3_db_readonly(database_.raw(), "main") == 1) {
    return Error{Errc::not_permitted, "cannot record into", config_.path, "it is read-only",
                 "check the permissions of the file and its folder"};
  }
  if (auto format = format_of(database_, config_.path); !format) return std::move(format).error();
  const std::string recording = sqlite3_db_filename(database_.raw(), "main");  // without symbolic links
  auto lock = RecordingLock::take(recording);
  if (!lock) return std::move(lock).error();
  lock_ = std::move(*lock);
  return begin_in(recording);
}

Result<void> SqliteWriter::begin_in(const std::string& recording) {
  if (auto done = configure(); !done) return done;
  if (auto done = database_.execute("BEGIN IMMEDIATE"); !done) return done;
  is_in_transaction_ = true;
  if (auto done = make_schema(); !done) return done;
  std::vector<LiveFile> used;
  auto remarks = seal_runs(database_, recording, lock_.noted(), sums_, used);
  if (!remarks) return std::move(remarks).error();
  if (auto done = begin_run(); !done) return done;
  // A program that is killed again and again as soon as it has started stores nothing, but its runs take room.
  if (pruner_.has_limits()) {
    if (auto done = pruner_.make_room(database_, sums_, info_.started); !done) return done;
  }
  if (auto done = sums_.write(database_); !done) return done;
  if (auto made = LiveFile::make(recording, info_.uuid)) {
    const std::lock_guard lock(opening_mutex_);
    live_ = std::move(*made);
    counts_without_topics_ = !has_topics_;
    if (counts_without_topics_) live_.begin_counting();
  } else {
    tell_of_live_file(made.error());
  }
  is_in_transaction_ = false;
  if (auto done = database_.execute("COMMIT"); !done) {
    const std::lock_guard lock(opening_mutex_);
    live_.remove();
    return done;
  }
  {
    const std::lock_guard lock(opening_mutex_);
    lock_.note(live_.path());
  }
  remarks_ = std::move(*remarks);
  // The start after a power cut is to find this run, and what was known of those that were killed, whose live files go.
  if (config_.profile == SqliteProfile::normal) {
    if (auto synced = sync(); !synced) return synced;
  }
  for (LiveFile& one : used) one.remove();
  LiveFile::remove_left(recording);
  return {};
}

Result<void> SqliteWriter::configure() {
  // Of a new file. A row costs its page each time that it is committed: with small ones, many slow topics write a
  // quarter.
  std::string sql = config_.profile == SqliteProfile::card ? "PRAGMA page_size=1024;" : "";
  sql += "PRAGMA auto_vacuum=INCREMENTAL; PRAGMA journal_mode=WAL; PRAGMA synchronous=";
  switch (config_.profile) {
    case SqliteProfile::normal:
      sql += "NORMAL;";
      break;
    case SqliteProfile::safe:
    case SqliteProfile::card:
      sql += "FULL;";
      break;
    case SqliteProfile::fast:
      sql += "OFF;";
      break;
  }
  // Checkpoints are ours, outside of commits.
  const std::uint64_t most_log = pruner_.log_bytes() != 0 ? pruner_.log_bytes() : std::uint64_t{64} << 20;
  sql += "PRAGMA wal_autocheckpoint=0; PRAGMA temp_store=MEMORY; PRAGMA journal_size_limit=" + std::to_string(most_log);
  if (auto set = database_.execute(sql); !set) return set;
  auto bytes = database_.integer("PRAGMA page_size");
  if (!bytes) return std::move(bytes).error();
  page_bytes_ = static_cast<int>(*bytes);
  // Without memory SQLite may roll a transaction back within a statement that it then runs once more, by itself, after
  // a change of the schema: outside of the transaction. What would be committed so is refused.
  sqlite3_commit_hook(
      database_.raw(), [](void* is_in_transaction) { return *static_cast<bool*>(is_in_transaction) ? 1 : 0; },
      &is_in_transaction_);
  sqlite3_wal_hook(
      database_.raw(),
      [](void* pages, sqlite3*, const char*, int count) {
        *static_cast<int*>(pages) = count;
        return SQLITE_OK;
      },
      &log_pages_);
  return {};
}

Result<void> SqliteWriter::make_schema() {
  auto version = format_of(database_, config_.path);  // again, now that no other process can change it
  if (!version) return std::move(version).error();
  if (*version != 0) return {};
  return database_.execute(schema + run_view() + account_views() + ";PRAGMA application_id=" +
                           std::to_string(application_id) + ";PRAGMA user_version=" + std::to_string(schema_version));
}

Result<void> SqliteWriter::begin_run() {
  const RunInfo& run = info_;
  auto insert = database_.prepare(
      "INSERT INTO rtdata_run(uuid, name, notes, configuration, program, host, boot_id, pid, started, ended, "
      "clock_offset, state, format) "
      "VALUES(?,?,?,?,?,?,?,?,?,?,?,'recording',?) RETURNING *");
  if (!insert) return std::move(insert).error();
  const std::string host = host_name();
  const std::string program = "rtdata " RTDATA_VERSION;
  insert->bind(1, run.uuid)
      .bind(2, run.name)
      .bind(3, run.notes)
      .bind(4, run.configuration)
      .bind(5, program)
      .bind(6, host);
  insert->bind(7, run.boot_id).bind(8, std::int64_t{::getpid()}).bind(9, to_nanoseconds(run.started));
  insert->bind(10, to_nanoseconds(run.started)).bind(11, run.clock_offset.count());
  insert->bind(12, std::int64_t{schema_version});
  if (auto done = sums_.run(*insert); !done) return done;
  run_ = database_.last_rowid();
  positions_->begin_run(run_);
  pruner_.begin(run_);
  return {};
}

}  // namespace rtdata::sqlite
