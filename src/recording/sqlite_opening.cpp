// Opening of the SQLite writer: opens and locks the file, makes its tables, seals older runs, begins its own.
#include <unistd.h>

#include "recording/schema.hpp"
#include "recording/sqlite_writer.hpp"
#include "recording/utc_line.hpp"

namespace rtdata::sqlite {
namespace {

/// The version of the recording's format; 0: the file is empty.
std::int64_t format_of(const Database& database, const std::string& path) {
  auto id = database.integer("PRAGMA application_id");
  if (id != application_id) {
    auto tables = database.integer("SELECT count(*) FROM sqlite_schema");
    if (tables == 0) return 0;
    if (id == application_id_before)
      throw SetupError({Errc::not_a_recording, "cannot record into", path, written_before, advice_before});
    throw SetupError({Errc::not_a_recording, "cannot record into", path, "it is another program's SQLite database",
                      "choose another path"});
  }
  if (lacks_suspensions(database))
    throw SetupError({Errc::not_a_recording, "cannot record into", path, written_before, advice_before});
  auto version = database.integer("PRAGMA user_version");
  if (version > schema_version) {
    throw SetupError({Errc::newer_version, "cannot record into", path,
                      "a newer version wrote it (format " + std::to_string(version) + ", this one knows " +
                          std::to_string(schema_version) + ")",
                      "update rt-data, or choose another path"});
  }
  return version;
}

}  // namespace

std::string host_name() {
  char name[256] = {};
  return ::gethostname(name, sizeof name - 1) == 0 ? name : "";
}

bool lacks_suspensions(const Database& database) {
  const auto has = [&](const char* column) {
    return sqlite3_table_column_metadata(database.raw(), "main", "rtdata_clock", column, nullptr, nullptr, nullptr,
                                         nullptr, nullptr) == SQLITE_OK;
  };
  return has(nullptr) && !has("suspended");
}

void make_recording(const Database& database) {
  std::string sql = std::string(schema) + position_schema;
  for (const View& view : account_views()) sql += view.sql + ";";
  database.execute(sql + "PRAGMA application_id=" + std::to_string(application_id) +
                   ";PRAGMA user_version=" + std::to_string(schema_version));
}

void SqliteWriter::begin() {
  check_path(config_.path).or_throw();
  database_ = Database::open(config_.path, Database::Mode::write, permissions_);
  if (sqlite3_db_readonly(database_.raw(), "main") == 1) {
    throw SetupError({Errc::not_permitted, "cannot record into", config_.path, "it is read-only",
                      "check the permissions of the file and its folder"});
  }
  const std::string recording = sqlite3_db_filename(database_.raw(), "main");  // without symbolic links
  lock_ = RecordingLock::take(recording).or_throw();
  // With the lock SQLite would take the journal of a killed program for that of one at work.
  if (::access((recording + "-journal").c_str(), F_OK) != 0) hold_file(database_).or_throw();
  format_of(database_, config_.path);
  live_.set_recording(recording);
  begin_in(recording);
}

void SqliteWriter::begin_in(const std::string& recording) {
  configure();
  hold_file(database_).or_throw();
  database_.execute("BEGIN IMMEDIATE");
  is_in_transaction_ = true;
  make_schema();
  std::vector<LiveFile> used;
  auto remarks = seal_runs(database_, recording, lock_.noted(), sums_, used);
  begin_run();
  // A program that is repeatedly killed at its start stores no rows, but its runs take space.
  if (pruner_.has_limits()) pruner_.make_room(database_, sums_, *positions_, info_.started);
  sums_.write(database_);
  is_in_transaction_ = false;
  database_.execute("COMMIT");
  live_.set_has_row();
  positions_->committed();
  lock_.note(live_.path());
  remarks_ = std::move(remarks);
  sealed_ = std::move(used);
  log_inode_ = log_inode();
}

void SqliteWriter::end_beginning() {
  // The next start after a power failure must find this run, and the sealed data of killed runs, whose live files are
  // removed now.
  if (config_.profile == SqliteProfile::normal) sync().or_throw();
  for (LiveFile& one : sealed_) one.remove();
  sealed_.clear();
  LiveFile::remove_left(sqlite3_db_filename(database_.raw(), "main"));
  has_begun_ = true;
}

void SqliteWriter::configure() {
  // For a new file. Each commit of a row writes its page: with small pages, many slow topics write only a
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
  // This program makes the checkpoints itself, outside of commits.
  const std::uint64_t most_log = pruner_.log_bytes() != 0 ? pruner_.log_bytes() : std::uint64_t{64} << 20;
  sql += "PRAGMA wal_autocheckpoint=0; PRAGMA temp_store=MEMORY; PRAGMA journal_size_limit=" + std::to_string(most_log);
  database_.execute(sql);
  auto bytes = database_.integer("PRAGMA page_size");
  page_bytes_ = static_cast<int>(bytes);
  // Without memory SQLite may roll a transaction back within a statement and then repeat the statement outside the
  // transaction, after a change of the schema. Such a commit is refused.
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
}

void SqliteWriter::make_schema() {
  if (format_of(database_, config_.path) != 0) return;  // again, now that no other process can change it
  make_recording(database_);
}

void SqliteWriter::begin_run() {
  insert_run(database_, info_, sums_);
  run_ = database_.last_rowid();
  positions_->begin_run(run_);
  pruner_.begin(run_);
}

}  // namespace rtdata::sqlite
