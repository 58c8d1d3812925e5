#include "recording/sqlite_writer.hpp"

#include <algorithm>
#include <filesystem>
#include <system_error>

#include "data/permissions.hpp"
#include "recording/sqlite_feed.hpp"
#include "rtdata/recording/verify.hpp"

namespace rtdata::sqlite {
namespace {

constexpr Duration log_sync_interval = std::chrono::seconds{30};
constexpr std::size_t batch_bytes = std::size_t{1} << 20;
constexpr std::uint64_t account_events = 5000;
constexpr Duration account_interval = std::chrono::seconds{30};
constexpr Duration account_interval_of_card = std::chrono::seconds{60};
constexpr std::size_t
    most_new_tables = 200;  // in a transaction: the more tables there are, the longer SQLite takes for each

}  // namespace

SqliteWriter::SqliteWriter(const SqliteConfig& config, RunInfo run)
    : config_(config),
      info_(std::move(run)),
      permissions_(detail::permissions_of(config.permissions, config.path).or_throw()),
      pruner_(config.max_bytes, config.max_age) {
  constexpr std::uint64_t share_of_refusals = 16;
  positions_->limit_refusals(config.max_bytes / share_of_refusals);
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
  std::error_code failed;
  if (auto made = LiveFile::make(std::filesystem::absolute(config_.path, failed), info_)) {
    live_ = *std::move(made);
  } else {
    tell_of_live_file(made.error());
  }
}

SqliteWriter::~SqliteWriter() {
  if (run_ == 0) live_.remove();  // the sink has told what it did not store
}

Result<void> SqliteWriter::open() try {
  if (run_ == 0) {
    try {
      begin();
    } catch (...) {
      forget();
      throw;
    }
  }
  if (!has_begun_) end_beginning();
  // Writes the run into the database itself. An error here occurs again, and is reported, when the WAL file is full.
  if (!checkpoint(SQLITE_CHECKPOINT_PASSIVE)) log_bytes_ = std::max<std::int64_t>(log_size(), 0);
  for (auto [statement, sql] : {std::pair{&begin_, "BEGIN IMMEDIATE"}, std::pair{&commit_, "COMMIT"}}) {
    if (*statement) continue;
    *statement = database_.prepare(sql);
  }
  account_.prepare(database_, sums_, run_, info_.boot_id);
  return {};
} catch (const SetupError& error) {
  return error.error();
}

void SqliteWriter::forget() noexcept {
  run_ = 0;
  is_in_transaction_ = false;
  database_ = Database();
  sums_.clear();
  positions_->rolled_back();
  remarks_.clear();
  if (lock_.noted().empty()) lock_.remove();
  lock_ = RecordingLock();
}

StorePace SqliteWriter::pace() const {
  const bool is_card = config_.profile == SqliteProfile::card;
  const std::uint64_t of_limit = config_.max_bytes == 0 ? batch_bytes : config_.max_bytes / 20;
  Duration account_time = is_card ? account_interval_of_card : account_interval;
  // The age limit uses the account's time, because an event's time may come from a device with a wrong clock.
  if (config_.max_age.count() > 0)
    account_time = std::clamp<Duration>(config_.max_age / 50, std::chrono::seconds{1}, account_time);
  return {static_cast<std::size_t>(std::min<std::uint64_t>(batch_bytes, of_limit)), account_time, account_events,
          config_.profile == SqliteProfile::normal ? log_sync_interval : Duration{0}};
}

LiveCounts* SqliteWriter::live_counts(std::uint32_t slot) {
  return live_.reserve(slot) ? &live_.counts(slot) : nullptr;  // the lane reports a failure
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
  warning_ = Error{why.code, "if the program is killed, what it lost will not be known", config_.path,
                   why.what + " " + why.where + ": " + why.why, why.advice};
}

Result<void> SqliteWriter::add_topic(std::uint32_t, std::string_view topic, const Description& description) {
  return check_columns(topic, description);
}

std::optional<Error> SqliteWriter::take_warning() {
  if (warning_) return std::exchange(warning_, std::nullopt);
  if (auto warning = open_steps_.take_warning()) return warning;
  const std::string sinks = positions_->take_losing();
  if (sinks.empty()) return no_utf8_.take_warning();
  return Error{Errc::storage_full, "events are deleted before they are sent", config_.path,
               "`max_bytes` or `max_age` deletes what the peer of " + sinks + " does not have yet",
               "check why the peer is away or slow, or raise the limit; `rtdata info` counts them"};
}

Result<void> SqliteWriter::write(Batch& batch) try {
  if (has_moved()) {
    (void)checkpoint(
        SQLITE_CHECKPOINT_TRUNCATE);  // the WAL file stays at the old path: copies its content into the file
    throw SetupError({Errc::closed, "recording has ended", config_.path, "the file was deleted or moved",
                      "do not move or delete it during recording; start again"});
  }
  if (log_inode_ != 0 && log_inode() != log_inode_) {
    (void)checkpoint(SQLITE_CHECKPOINT_TRUNCATE);  // this connection still has it
    throw SetupError({Errc::closed, "recording has ended", config_.path,
                      "its WAL file, " + config_.path + "-wal, was deleted, moved or replaced",
                      "do not change it during recording; the next start seals the run"});
  }
  auto next = batch.begin();
  // The batch comes again, after a part of it was stored.
  for (std::size_t row = 0; row < stored_rows_; ++row, ++next) {
    const Record record = *next;
    if (const auto refused = untaken_.find(record.info->topic_number); refused != untaken_.end())
      batch.refuse_topic(record, refused->second);
  }
  do {
    write_part(batch, next);
  } while (next != batch.end());
  stored_rows_ = 0;
  for (std::uint32_t slot = 0; slot < batch.slots() && live_.has(slot); ++slot)
    live_.slot(slot).committed = batch.stored_after(slot);
  account_.committed(batch);
  if (batch.account() != nullptr) now_ = std::max(now_, batch.account()->at);
  // It is stored: from here on it must not be stored again.
  try {
    look_at_space();
    if (batch.account() != nullptr && !has_told_of_live_file_ && live_.lacks_room()) tell_of_live_file(live_.no_room());
  } catch (...) {  // no memory for a warning
  }
  return {};
} catch (const SetupError& error) {
  return error.error();
}

void SqliteWriter::write_part(Batch& batch, Batch::Iterator& next) {
  // Before the rows, so that an error here does not repeat rows that are already stored.
  tend_log();
  no_utf8_.begin_batch();
  try {
    rows_in_last_ = store(batch, next);
  } catch (...) {
    roll_back();
    tables_.clear();  // tables that the transaction made were rolled back with it
    throw;
  }
  committed();
  account_.slots_committed();
  stored_rows_ += rows_in_last_;
  try {
    no_utf8_.end_batch(batch);
  } catch (...) {  // no memory for a warning
  }
}

void SqliteWriter::begin_transaction() {
  begin_.run();
  is_in_transaction_ = true;
}

void SqliteWriter::commit() {
  is_in_transaction_ = false;
  commit_.run();
}

void SqliteWriter::roll_back() noexcept {
  is_in_transaction_ = false;
  if (sqlite3_get_autocommit(database_.raw()) == 0)
    sqlite3_exec(database_.raw(), "ROLLBACK", nullptr, nullptr, nullptr);
  rolled_back();
  pruner_.close();
}

std::size_t SqliteWriter::store(Batch& batch, Batch::Iterator& next) {
  std::size_t rows = 0;
  begin_transaction();
  positions_->write_begins(database_);
  // Before the rows, so that new ones take the pages of the old ones within one transaction.
  if (pruner_.has_limits()) pruner_.make_room(database_, sums_, *positions_, now_);
  account_.write_slots(batch, tables_);
  write_rows(batch, next, rows);
  const Account* const account = next != batch.end() ? nullptr : batch.account();  // with the last of its rows
  if (account != nullptr) account_.write(batch, *account, tables_);
  positions_->write(database_, sums_);
  sums_.write(database_);
  commit();
  return rows;
}

void SqliteWriter::write_rows(Batch& batch, Batch::Iterator& next, std::size_t& rows) {
  std::size_t made = 0;
  for (; next != batch.end(); ++next, ++rows) {
    const Record record = *next;
    const std::uint32_t number = record.info->topic_number;
    TopicTable* table = number < tables_.size() ? tables_[number].get() : nullptr;
    if (table == nullptr) [[unlikely]] {
      if (made == most_new_tables) break;
      table = table_of(record);
      if (table == nullptr) {
        batch.refuse_topic(record, untaken_.at(number));
        continue;
      }
      ++made;
    }
    table->insert(record);
  }
  for (const auto& table : tables_)
    if (table != nullptr) table->flush();
  new_views_.make(database_);
}

TopicTable* SqliteWriter::table_of(const Record& record) {
  const std::uint32_t number = record.info->topic_number;
  if (untaken_.contains(number)) return nullptr;
  database_.execute("SAVEPOINT topic");
  auto sums_before = sums_.changes();
  std::unique_ptr<TopicTable> table;
  try {
    table = std::make_unique<TopicTable>(TopicTable::prepare(database_, *record.info, run_, no_utf8_, sums_, new_views_,
                                                             config_.steps ? &open_steps_ : nullptr));
  } catch (const SetupError& error) {
    // An error of SQLite itself (another object has the name) is permanent; other errors may pass.
    Error why = error.error();
    if (sqlite3_errcode(database_.raw()) != SQLITE_ERROR && why.code != Errc::bad_description) throw;
    why.what = "cannot make a table for topic " + record.info->topic;
    why.advice = "give the topic another name, or record into another file";
    untaken_.emplace(number, std::move(why));
    sums_.undo_to(std::move(sums_before));
    database_.execute("ROLLBACK TO topic");
  }
  database_.execute("RELEASE topic");
  if (table == nullptr) return nullptr;
  if (number >= tables_.size()) tables_.resize(number + 1);
  tables_[number] = std::move(table);
  return tables_[number].get();
}

void SqliteWriter::committed() {
  positions_->committed();
  open_steps_.committed();
  const std::vector<Pruner::Deleted> deleted = pruner_.take_deleted();
  if (has_feeds_.load(std::memory_order_relaxed)) {
    for (const Pruner::Deleted& rows : deleted) positions_->set_deleted_to(rows.table, rows.topic, rows.up_to);
    for (const auto& table : tables_)
      if (table != nullptr)
        positions_->set_last_row(table->name(), table->topic(), table->last_rowid(), table->payload_bytes());
  }
  log_bytes_ = std::max<std::int64_t>(log_size(), 0);
}

void SqliteWriter::rolled_back() {
  new_views_.clear();
  positions_->rolled_back();
  open_steps_.rolled_back();
  sums_.clear();
}

Result<void> SqliteWriter::flush() try {
  // Further transactions delete the rest until the limit is nearly reached.
  constexpr int most_transactions = 100;
  tend_log();
  for (int i = 0; i < most_transactions && pruner_.has_more(); ++i) prune();
  if (positions_->is_dirty()) write_positions();
  return {};
} catch (const SetupError& error) {
  return error.error();
}

std::unique_ptr<detail::RowFeed> SqliteWriter::feed(const detail::RowFeedConfig& config) {
  has_feeds_.store(true, std::memory_order_relaxed);
  return std::make_unique<SqliteFeed>(config_.path, positions_, config);
}

void SqliteWriter::write_positions() {
  transaction([this] { positions_->write(database_, sums_); });
}

void SqliteWriter::prune() {
  transaction([this] { pruner_.make_room(database_, sums_, *positions_, now_); });
  tend_log();
}

template <class Work>
void SqliteWriter::transaction(Work&& work) {
  try {
    begin_transaction();
    work();
    sums_.write(database_);
    commit();
  } catch (...) {
    roll_back();
    throw;
  }
  committed();
}

void SqliteWriter::read_account() noexcept try {
  auto recording = Recording::open(config_.path);
  if (!recording) return;
  auto report = account_of(*recording, run_);
  if (report) recorded_ = std::make_shared<const RunReport>(*std::move(report));
} catch (...) {  // no memory: there is no report
}

Result<void> SqliteWriter::close() {
  if (is_closed_) return {};
  tables_.clear();
  pruner_.close();
  account_.close();
  begin_ = Statement();
  commit_ = Statement();
  if (!is_log_lost_)
    (void)checkpoint(SQLITE_CHECKPOINT_TRUNCATE);  // what stays in the WAL file is read from there: nothing is lost
  read_account();                                  // as a reader has it from now on
  database_ = Database();
  if (!is_log_lost_) {  // otherwise the next start needs them
    live_.remove();
    lock_.remove();
  }
  is_closed_ = true;
  for (std::string& said : positions_->end()) remarks_.push_back(std::move(said));
  return {};
}

}  // namespace rtdata::sqlite
