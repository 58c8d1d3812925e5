#include "sinks/sqlite/sqlite_writer.hpp"

#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <algorithm>

#include "data/permissions.hpp"
#include "loop/support/first_line.hpp"
#include "sinks/sqlite/schema.hpp"
#include "sinks/sqlite/utc_line.hpp"

namespace rtdata::sqlite {
namespace {

// A log that stays small stays in the caches. One that fills slowly holds the same pages again and again, and a
// checkpoint writes each of them once: the later, the less is written.
constexpr std::uint64_t log_bytes_at_most = std::uint64_t{4} << 20;
constexpr std::uint64_t log_bytes_when_fast = std::uint64_t{1} << 20;
constexpr std::size_t rows_when_fast = 1000;  // in a transaction
constexpr Duration log_sync_interval = std::chrono::seconds{30};
constexpr Duration reader_wait_interval = std::chrono::seconds{1};
constexpr int reader_wait_ms = 200;
constexpr int busy_ms = 2000;
constexpr std::size_t batch_bytes = std::size_t{1} << 20;
constexpr std::uint64_t account_events = 5000;
constexpr Duration account_interval = std::chrono::seconds{30};
constexpr Duration account_interval_of_card = std::chrono::seconds{60};
constexpr std::uint64_t short_of_space = std::uint64_t{64} << 20;
constexpr Duration space_interval = std::chrono::seconds{10};

std::string random_uuid() { return detail::first_line("/proc/sys/kernel/random/uuid"); }

std::string host_name() {
  char name[256] = {};
  return ::gethostname(name, sizeof name - 1) == 0 ? name : "";
}

/// The version of the recording's format; 0: the file is empty.
Result<std::int64_t> format_of(const Database& database, const std::string& path) {
  auto id = database.integer("PRAGMA application_id");
  if (!id) return std::move(id).error();
  if (*id != application_id) {
    auto tables = database.integer("SELECT count(*) FROM sqlite_schema");
    if (!tables) return std::move(tables).error();
    if (*tables == 0) return 0;
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

SqliteWriter::SqliteWriter(const SqliteConfig& config, RunInfo run)
    : config_(config),
      info_(std::move(run)),
      permissions_(detail::permissions_of(config.permissions, config.path).or_throw()),
      pruner_(config.max_bytes, config.max_age) {
  if (config_.path.empty()) {
    throw SetupError(
        {Errc::bad_argument, "cannot record", "sqlite sink", "it has no path", "set `path`, such as \"run.db\""});
  }
  if (config_.max_bytes != 0 && config_.max_bytes < SqliteConfig::least_max_bytes) {
    throw SetupError({Errc::bad_argument, "cannot record into", config_.path,
                      "`max_bytes` is " + std::to_string(config_.max_bytes),
                      "set at least " + std::to_string(SqliteConfig::least_max_bytes) + " (4 MiB), or 0 for no limit"});
  }
  if (config_.max_age.count() < 0) {
    throw SetupError({Errc::bad_argument, "cannot record into", config_.path, "`max_age` is negative",
                      "set a positive time, or 0 for no limit"});
  }
}

Result<void> SqliteWriter::open() {
  if (run_ == 0) {
    Result<void> begun;
    try {
      begun = begin();
    } catch (...) {  // no memory
      forget();
      throw;
    }
    if (!begun) {
      forget();
      return begun;
    }
  }
  // The run is in the database whatever becomes of the log. What fails here fails, and is told, when the log is full.
  if (!checkpoint(SQLITE_CHECKPOINT_PASSIVE)) log_bytes_ = std::max<std::int64_t>(log_size(), 0);
  for (auto [statement, sql] : {std::pair{&begin_, "BEGIN IMMEDIATE"}, std::pair{&commit_, "COMMIT"}}) {
    if (*statement) continue;
    auto made = database_.prepare(sql);
    if (!made) return std::move(made).error();
    *statement = std::move(*made);
  }
  return account_.prepare(database_, run_, info_.boot_id);
}

void SqliteWriter::forget() noexcept {
  run_ = 0;
  {
    const std::lock_guard lock(opening_mutex_);
    counts_without_topics_ = false;
    live_ = LiveFile();
  }
  database_ = Database();
  sums_.forget();
  remarks_.clear();
  if (lock_.noted().empty()) lock_.remove();
  lock_ = RecordingLock();
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
  const std::string uuid = random_uuid();
  if (auto done = database_.execute("BEGIN IMMEDIATE"); !done) return done;
  if (auto done = make_schema(); !done) return done;
  if (auto done = sums_.watch(database_); !done) return done;
  std::vector<LiveFile> used;
  auto remarks = seal_runs(database_, recording, lock_.noted(), sums_, used);
  if (!remarks) return std::move(remarks).error();
  if (auto done = begin_run(uuid); !done) return done;
  if (auto done = sums_.write_changes(database_); !done) return done;
  if (auto made = LiveFile::make(recording, uuid)) {
    const std::lock_guard lock(opening_mutex_);
    live_ = std::move(*made);
    counts_without_topics_ = !has_topics_;
    if (counts_without_topics_) live_.begin_counting();
  } else {
    tell_of_live_file(made.error());
  }
  if (auto done = database_.execute("COMMIT"); !done) {
    const std::lock_guard lock(opening_mutex_);
    live_.remove();
    return done;
  }
  {
    const std::lock_guard lock(opening_mutex_);
    if (live_) live_.sums().set(sums_.sums_of(run_));
    lock_.note(live_.path());
  }
  sums_.committed();
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
  sqlite3_wal_hook(
      database_.raw(),
      [](void* pages, sqlite3*, const char*, int count) {
        *static_cast<int*>(pages) = count;
        return SQLITE_OK;
      },
      &log_pages_);
  return {};
}

StorePace SqliteWriter::pace() const {
  const bool is_card = config_.profile == SqliteProfile::card;
  const std::uint64_t of_limit = config_.max_bytes == 0 ? batch_bytes : config_.max_bytes / 20;
  Duration account_time = is_card ? account_interval_of_card : account_interval;
  // The time of the account says what is too old; that of an event may be a device's, and wrong.
  if (config_.max_age.count() > 0)
    account_time = std::clamp<Duration>(config_.max_age / 50, std::chrono::seconds{1}, account_time);
  return {static_cast<std::size_t>(std::min<std::uint64_t>(batch_bytes, of_limit)), account_time, account_events,
          config_.profile == SqliteProfile::normal ? log_sync_interval : Duration{0}};
}

Result<void> SqliteWriter::make_schema() {
  auto version = format_of(database_, config_.path);  // again, now that nobody else can change it
  if (!version) return std::move(version).error();
  if (*version == schema_version) return {};
  std::string sql = schema + run_view();
  if (*version == 1) sql += std::string(";") + from_version_1;
  if (*version >= 1 && *version < first_version_of_own_account) sql += std::string(";") + from_version_3;
  if (*version >= 1 && *version < 5) sql += std::string(";") + from_version_4;
  if (*version >= 3 && *version < 5) sql += std::string(";") + health_from_version_4;
  sql += account_views();
  sql += ";PRAGMA application_id=" + std::to_string(application_id) +
         ";PRAGMA user_version=" + std::to_string(schema_version);
  if (auto made = database_.execute(sql); !made || *version == 0) return made;
  if (auto written = write_utc_lines(database_); !written) return written;
  auto topic = database_.prepare("SELECT table_name, description FROM rtdata_topic");
  if (!topic) return std::move(topic).error();
  std::vector<std::pair<std::string, std::shared_ptr<const Description>>> tables;
  for (;;) {
    auto row = topic->step();
    if (!row) return std::move(row).error();
    if (!*row) break;
    // Written by something else: left alone.
    if (auto description = Description::from_json(topic->text(1))) tables.emplace_back(topic->text(0), *description);
  }
  for (const auto& [table, description] : tables) {
    if (auto made = make_utc_view(database_, table, *description); !made) return made;
  }
  return {};
}

Result<void> SqliteWriter::begin_run(const std::string& uuid) {
  const RunInfo& run = info_;
  auto insert = database_.prepare(
      "INSERT INTO rtdata_run(uuid, name, notes, configuration, program, host, boot_id, pid, started, ended, "
      "clock_offset, state, format) "
      "VALUES(?,?,?,?,?,?,?,?,?,?,?,'recording',?)");
  if (!insert) return std::move(insert).error();
  const std::string host = host_name();
  const std::string program = "rtdata " RTDATA_VERSION;
  insert->bind(1, uuid).bind(2, run.name).bind(3, run.notes).bind(4, run.configuration).bind(5, program).bind(6, host);
  insert->bind(7, run.boot_id).bind(8, std::int64_t{::getpid()}).bind(9, to_nanoseconds(run.started));
  insert->bind(10, to_nanoseconds(run.started)).bind(11, run.clock_offset.count());
  insert->bind(12, std::int64_t{schema_version});
  if (auto done = insert->run(); !done) return done;
  run_ = database_.last_rowid();
  sums_.begin(run_);
  ranges_.begin(run_, run.started);
  return {};
}

LiveCounts* SqliteWriter::live_counts(std::uint32_t slot) {
  return live_.reserve(slot) ? &live_.counts(slot) : nullptr;  // the lane tells when it cannot be
}

void SqliteWriter::keep(const OriginAccount& now, const Gap* closed) {
  if (!live_.has(now.slot)) return;
  const auto kept = [](const Gap& gap) {
    LiveGap live{gap.kind, true, {}, to_nanoseconds(gap.first), to_nanoseconds(gap.last), gap.count};
    gap.reason.copy(live.reason, sizeof live.reason - 1);
    return live;
  };
  LiveAccount account{now.sensor, now.first_sequence, now.segment, {}, {}};
  if (now.has_gap) account.under_way = kept(now.gap);
  if (closed != nullptr) account.closed = kept(*closed);
  live_.slot(now.slot).account.set(account);
}

void SqliteWriter::tell_of_live_file(const Error& why) {
  has_told_of_live_file_ = true;
  warning_ = Error{why.code, "what a kill would lose will not be known", config_.path,
                   why.what + " " + why.where + ": " + why.why, why.advice};
}

Result<void> SqliteWriter::add_topic(std::uint32_t, std::string_view topic, const Description& description) {
  auto fits = check_columns(topic, description);
  if (!fits || is_counting_) return fits;
  const std::lock_guard lock(opening_mutex_);
  has_topics_ = true;
  // A kill before the loop has heard that the run has begun: what was published until then is not known.
  if (std::exchange(counts_without_topics_, false)) live_.pause_counting();
  return fits;
}

void SqliteWriter::begin_counting() {
  live_.begin_counting();
  is_counting_ = true;
}

Result<void> SqliteWriter::write(Batch& batch) {
  if (has_moved()) {
    (void)checkpoint(SQLITE_CHECKPOINT_TRUNCATE);  // the log stays where it was: what is in it goes into the file
    return Error{Errc::closed, "recording has ended", config_.path, "the file was deleted or moved",
                 "leave it where it is while it is recorded into; start again"};
  }
  // Before the batch, not after it: what fails here must not make it come again when it is stored already.
  if (auto done = tend_log(); !done) return done;
  escaped_.begin_batch();
  const auto undo = [&]() noexcept {
    roll_back();
    tables_.clear();  // what was made in the transaction is gone with it
  };
  Result<void> done;
  try {
    done = store(batch);
  } catch (...) {  // no memory
    undo();
    throw;
  }
  if (!done) {
    undo();
    return done;
  }
  committed();
  account_.committed(batch);
  if (batch.account() != nullptr) now_ = std::max(now_, batch.account()->at);
  rows_in_last_ = batch.size();
  // It is stored: whatever happens from here on, it must not come again.
  try {
    escaped_.end_batch(batch);
    look_at_space();
    if (batch.account() != nullptr && !has_told_of_live_file_ && live_.lacks_room()) tell_of_live_file(live_.no_room());
  } catch (...) {  // no memory for a warning
  }
  return {};
}

void SqliteWriter::roll_back() noexcept {
  if (sqlite3_get_autocommit(database_.raw()) == 0)
    sqlite3_exec(database_.raw(), "ROLLBACK", nullptr, nullptr, nullptr);
  rolled_back();
  pruner_.close();
}

Result<void> SqliteWriter::store(Batch& batch) {
  auto done = begin_.run();
  // First, so that the new rows take the pages of the old ones within one transaction.
  if (done && pruner_.has_limits()) done = pruner_.make_room(database_, ranges_, now_);
  if (done) done = account_.write_slots(batch, tables_);
  if (done) done = write_rows(batch);
  if (done) done = account_.write_escaped(batch, escaped_);
  if (done && batch.account() != nullptr) done = account_.write(batch, *batch.account(), tables_);
  if (done) done = write_checksums(batch.account());
  if (done) stage();
  if (done) done = commit_.run();
  return done;
}

std::int64_t SqliteWriter::log_size() {
  sqlite3_file* log = nullptr;
  sqlite3_int64 size = 0;
  const bool is_known = sqlite3_file_control(database_.raw(), "main", SQLITE_FCNTL_JOURNAL_POINTER, &log) ==
                            SQLITE_OK &&
                        log != nullptr && log->pMethods != nullptr && log->pMethods->xFileSize(log, &size) == SQLITE_OK;
  return is_known ? size : -1;
}

bool SqliteWriter::is_log_cut_off() {
  if (is_log_lost_) return true;
  const std::int64_t size = log_size();
  if (size < 0 || size >= log_bytes_) return false;
  // Another program may have brought all of it into the file and emptied it: then there is nothing to be read from it.
  return size != 0 || !checkpoint(SQLITE_CHECKPOINT_PASSIVE);
}

bool SqliteWriter::has_moved() {
  int moved = 0;
  return sqlite3_file_control(database_.raw(), "main", SQLITE_FCNTL_HAS_MOVED, &moved) == SQLITE_OK && moved != 0;
}

Result<void> SqliteWriter::write_rows(Batch& batch) {
  for (const Record& record : batch) {
    const std::uint32_t number = record.info->topic_number;
    TopicTable* table = number < tables_.size() ? tables_[number].get() : nullptr;
    if (table == nullptr) [[unlikely]] {
      auto found = table_of(record);
      if (!found) return std::move(found).error();
      table = *found;
      if (table == nullptr) {
        batch.refuse_topic(record, untaken_.at(number));
        continue;
      }
    }
    if (auto inserted = table->insert(record); !inserted) return inserted;
  }
  for (const auto& table : tables_) {
    if (table == nullptr) continue;
    if (auto flushed = table->flush(); !flushed) return flushed;
  }
  return {};
}

Result<TopicTable*> SqliteWriter::table_of(const Record& record) {
  const std::uint32_t number = record.info->topic_number;
  if (untaken_.contains(number)) return nullptr;
  if (auto done = database_.execute("SAVEPOINT topic"); !done) return std::move(done).error();
  auto table = TopicTable::prepare(database_, *record.info, run_, escaped_, ranges_);
  // What SQLite itself refuses (there is something else of that name) stays so; all else may get better.
  const bool is_refused = !table && (sqlite3_errcode(database_.raw()) == SQLITE_ERROR ||
                                     table.error().code == Errc::bad_description);
  if (!table && !is_refused) return std::move(table).error();
  if (is_refused) {
    Error why = std::move(table).error();
    why.what = "cannot make a table for topic " + record.info->topic;
    why.advice = "give the topic another name, or record into another file";
    untaken_.emplace(number, std::move(why));
    if (auto undone = database_.execute("ROLLBACK TO topic"); !undone) return std::move(undone).error();
  }
  if (auto done = database_.execute("RELEASE topic"); !done) return std::move(done).error();
  if (is_refused) return nullptr;
  if (number >= tables_.size()) tables_.resize(number + 1);
  tables_[number] = std::make_unique<TopicTable>(std::move(*table));
  return tables_[number].get();
}

Result<void> SqliteWriter::write_checksums(const Account* account) {
  const bool is_last = account != nullptr && account->is_last;
  const auto which = is_last              ? ValueRanges::Close::all
                     : account != nullptr ? ValueRanges::Close::aged
                                          : ValueRanges::Close::full;
  if (auto done = ranges_.write(database_, which, account != nullptr ? account->at : Time{}); !done) return done;
  if (is_last) {
    if (auto done = sums_.write_lines(database_, run_); !done) return done;
  }
  return sums_.write_changes(database_);
}

void SqliteWriter::stage() {
  ranges_.stage(live_);
  if (live_) live_.sums().stage(sums_.sums_of(run_));
}

void SqliteWriter::committed() {
  ranges_.committed(live_);
  sums_.committed();
  if (live_) live_.sums().settle();
  log_bytes_ = std::max<std::int64_t>(log_size(), 0);
}

void SqliteWriter::rolled_back() {
  ranges_.rolled_back(live_);
  sums_.rolled_back();
}

Result<void> SqliteWriter::tend_log() {
  if (is_log_cut_off()) {
    // What the file has is whole, up to the last checkpoint: with what is left of the log it would not be.
    (void)sqlite3_db_config(database_.raw(), SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, 1, nullptr);
    is_log_lost_ = true;
    return Error{Errc::closed, "recording has ended", config_.path,
                 "its log, " + config_.path + "-wal, was cut off: what was only there is gone",
                 "leave it alone while it is recorded into; the next start seals the run"};
  }
  const std::uint64_t limit = pruner_.log_bytes();
  std::uint64_t most = rows_in_last_ >= rows_when_fast ? log_bytes_when_fast : log_bytes_at_most;
  if (limit != 0) most = std::min(most, limit / 2);
  const auto bytes = static_cast<std::uint64_t>(log_pages_) * static_cast<std::uint64_t>(page_bytes_);
  const SteadyTime now = std::chrono::steady_clock::now();
  if (bytes >= most) {
    if (auto done = checkpoint(SQLITE_CHECKPOINT_PASSIVE); !done) return done;
    log_pages_ = 0;
    // A reader that always has something to read keeps the log from beginning anew: wait for a moment without one.
    if (limit != 0 && bytes >= limit && now - readers_waited_for_at_ >= reader_wait_interval) {
      readers_waited_for_at_ = now;
      sqlite3_busy_timeout(database_.raw(), reader_wait_ms);
      auto done = checkpoint(SQLITE_CHECKPOINT_RESTART);
      sqlite3_busy_timeout(database_.raw(), busy_ms);
      if (!done) return done;
    }
  }
  if (config_.max_bytes != 0) look_at_size();
  return {};
}

Result<void> SqliteWriter::checkpoint(int mode) {
  const int status = sqlite3_wal_checkpoint_v2(database_.raw(), nullptr, mode, nullptr, nullptr);
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
  return Error{Errc::io_failed, "cannot force the recording's log onto the disk", config_.path + "-wal", "", ""};
}

Result<void> SqliteWriter::flush() {
  // What a transaction does not delete at once follows in others, for as long as it takes to come near to the limit.
  constexpr int most_transactions = 100;
  if (auto done = tend_log(); !done) return done;
  for (int i = 0; i < most_transactions && pruner_.has_more(); ++i) {
    if (auto done = prune(); !done) return done;
  }
  return {};
}

Result<void> SqliteWriter::prune() {
  Result<void> done;
  try {
    done = begin_.run();
    if (done) done = pruner_.make_room(database_, ranges_, now_);
    if (done) done = sums_.write_changes(database_);
    if (done) stage();
    if (done) done = commit_.run();
  } catch (...) {  // no memory
    roll_back();
    throw;
  }
  if (!done) {
    roll_back();
    return done;
  }
  committed();
  return tend_log();
}

/// A limit that does not hold is told, once until it holds again.
void SqliteWriter::look_at_size() {
  std::uint64_t total = 0;
  for (const char* part : {"", "-wal", "-shm"}) {
    struct stat status {};
    if (::stat((config_.path + part).c_str(), &status) == 0) total += static_cast<std::uint64_t>(status.st_size);
  }
  const bool is_too_large = total > config_.max_bytes + config_.max_bytes / 10;
  if (is_too_large && !is_too_large_ && !pruner_.has_more()) {
    warning_ = Error{Errc::storage_full, "the recording is larger than `max_bytes`", config_.path,
                     std::to_string(total) + " bytes" +
                         (pruner_.is_exhausted() ? ": its accounts alone take as much"
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

Result<void> SqliteWriter::close() {
  if (is_closed_) return {};
  tables_.clear();
  pruner_.close();
  account_.close();
  begin_ = Statement();
  commit_ = Statement();
  if (!is_log_lost_)
    (void)checkpoint(SQLITE_CHECKPOINT_TRUNCATE);  // what stays in the log is read from there: nothing is lost
  database_ = Database();
  if (!is_log_lost_) {  // otherwise the next start needs them
    live_.remove();
    lock_.remove();
  }
  is_closed_ = true;
  return {};
}

}  // namespace rtdata::sqlite
