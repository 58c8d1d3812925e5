#include "postgresql/postgresql_writer.hpp"

#include <unistd.h>

#include <cstdio>
#include <random>

#ifdef RTDATA_WITH_SQLITE
#include "postgresql/account_copy.hpp"
#endif

namespace rtdata::postgresql {
namespace {

constexpr std::size_t transaction_bytes = std::size_t{4} << 20;
#ifdef RTDATA_WITH_SQLITE
constexpr std::chrono::seconds account_interval{30};
constexpr std::chrono::seconds last_account_time{1};
#endif

std::string host_name() {
  char name[256] = {};
  return ::gethostname(name, sizeof name - 1) == 0 ? name : "";
}

std::string number(std::uint64_t value) { return std::to_string(static_cast<std::int64_t>(value)); }

/// A session name that is unique for this writer on all machines: a node may be a copy of another's disk, and processes
/// in two containers may have the same number.
std::string session_name(const std::string& sink) {
  std::random_device random;
  char digits[17] = {};
  std::snprintf(digits, sizeof digits, "%08x%08x", random(), random());
  std::string name = "rtdata ";
  for (const char c : sink.substr(0, 38)) name += c > ' ' && c <= '~' ? c : '?';  // as the server would have it
  return name + " " + digits;
}

Address with_session(Address address, const std::string& sink) {
  address.name = session_name(sink);
  return address;
}

}  // namespace

Address address_of(const PostgresqlConfig& config) {
  return {config.url,      config.host,   config.database, config.user,
          config.password, config.schema, config.port,     config.timeout};
}

PostgresqlWriter::PostgresqlWriter(const PostgresqlConfig& config)
    : config_(config),
      address_(with_session(address_of(config), config.sink.name)),
      machine_(config.machine.empty() ? host_name() : config.machine) {
  if (!password_in(config.url).empty())
    throw SetupError({Errc::bad_argument, "cannot connect", "`url`", "it has a password in it, which would be recorded",
                      "give it as `password`, or put it into ~/.pgpass"});
}

Result<void> PostgresqlWriter::failed() {
  connection_.roll_back();
  forget();
  try {
    throw;
  } catch (const SetupError& error) {
    return error.error();
  }
}

Result<void> PostgresqlWriter::open() try {
  if (connection_) return {};
  Connection made(address_);
  make_layout(made, config_.schema);
  connection_ = std::move(made);
  return {};
} catch (...) {
  return failed();
}

void PostgresqlWriter::forget() noexcept {
  runs_.clear();
  positions_.clear();
  slots_.clear();
  touched_.clear();
  tables_.clear();
  waiting_bytes_ = waiting_rows_ = 0;
}

std::int64_t PostgresqlWriter::run_of(const std::string& uuid) {
  if (const auto known = runs_.find(uuid); known != runs_.end()) return known->second;
  add_run(connection_, uuid, machine_);
  const std::int64_t run = number_of_run(connection_, uuid);
  if (run == 0)
    throw SetupError(
        {Errc::damaged, "cannot store", "rtdata_run", "run " + uuid + " is not there after it was added", ""});
  positions_[run] = positions_of(connection_, run);
  runs_.emplace(uuid, run);
  return run;
}

void PostgresqlWriter::prepare(Slot& slot, const SlotInfo& info) {
  const std::int64_t run = run_of(info.run);
  ServerTable& table = tables_.try_emplace({info.topic, info.description->serial()}, connection_, info, run)
                           .first->second;
  const Position& stored = positions_[run][{info.topic, info.origin}];
  slot = {&info, run, &table, stored, stored, false};
}

Result<void> PostgresqlWriter::write(Batch& batch) try {
  for (bool is_table_known = false;; is_table_known = true) {
    try {
      store(batch);
      break;
    } catch (const SetupError& error) {
      if (error.error().code != Errc::does_not_fit || waiting_rows_ == 0) throw;
      connection_.roll_back();
      if (is_table_known)
        narrow(error.error());
      else
        forget();  // every row may fail so, because a column now has another type
    }
  }
  if (!refused_.empty() || has_unfit_topic_) refuse_rows(batch);
  return {};
} catch (...) {
  return failed();
}

void PostgresqlWriter::narrow(const Error& why) {
  if (waiting_rows_ == 1) refused_.emplace(std::pair(touched_.front(), slots_[touched_.front()].pending.last), why);
  most_rows_ = std::max<std::size_t>(waiting_rows_ / 2, 1);
  for (const std::uint32_t number : touched_) {
    slots_[number].pending = slots_[number].stored;
    slots_[number].is_touched = false;
  }
  begin_transaction();
}

void PostgresqlWriter::store(const Batch& batch) {
  has_unfit_topic_ = false;
  for (const Record& record : batch) {
    if (record.slot >= slots_.size()) slots_.resize(record.slot + 1);
    Slot& slot = slots_[record.slot];
    if (slot.info != record.info) [[unlikely]] {
      if (!check_columns(record.info->topic, *record.info->description)) {
        has_unfit_topic_ = true;
        continue;
      }
      if (slot.is_touched) send();  // its place has gone to another
      prepare(slot, *record.info);
    }
    Position& position = slot.pending;
    if (position.is_there && record.header.sequence <= position.last) continue;  // the server has it
    if (!refused_.empty() && refused_.contains({record.slot, record.header.sequence})) [[unlikely]]
      continue;
    const std::size_t before = slot.table->rows().size();
    position.sum += slot.table->append(record, slot.run);
    if (!position.is_there) position.first = record.header.sequence;
    position.is_there = true;
    position.last = record.header.sequence;
    ++position.rows;
    if (!slot.is_touched) {
      slot.is_touched = true;
      touched_.push_back(record.slot);
    }
    waiting_bytes_ += slot.table->rows().size() - before;
    if (++waiting_rows_ >= most_rows_ || waiting_bytes_ >= transaction_bytes) send();
  }
  send();
}

void PostgresqlWriter::begin_transaction() {
  touched_.clear();
  for (auto& [key, table] : tables_) table.begin();
  waiting_bytes_ = waiting_rows_ = 0;
}

void PostgresqlWriter::refuse_rows(Batch& batch) {
  for (const Record& record : batch) {
    if (auto fits = check_columns(record.info->topic, *record.info->description); !fits)
      batch.refuse_topic(record, fits.error());
    else if (const auto why = refused_.find({record.slot, record.header.sequence}); why != refused_.end())
      batch.refuse(record, why->second);
  }
  refused_.clear();
}

void PostgresqlWriter::send() {
  if (touched_.empty()) return;
  std::string sql = "BEGIN;";
  std::vector<std::string_view> data;
  for (auto& [key, table] : tables_) {
    if (table.is_empty()) continue;
    table.finish();
    sql += table.copy() + ";";
    data.push_back(table.rows().view());
  }
  // One round trip: after a failure the server skips the rest, COMMIT included.
  sql += positions_sql() + ";COMMIT";
  connection_.copy(sql, data);
  for (const std::uint32_t number : touched_) {
    Slot& slot = slots_[number];
    positions_[slot.run][{slot.info->topic, slot.info->origin}] = slot.stored = slot.pending;
    slot.is_touched = false;
  }
  begin_transaction();
  if (most_rows_ != every_row) most_rows_ = most_rows_ <= every_row / 2 ? 2 * most_rows_ : every_row;
}

/// Updates only from the positions that were read. If another program has changed one meanwhile, the count differs, and
/// a division by zero rolls the transaction back.
std::string PostgresqlWriter::positions_sql() const {
  std::string sql = "WITH v(run, topic, origin, table_name, first, last, rows, sum, before) AS (VALUES ";
  for (const std::uint32_t index : touched_) {
    const Slot& slot = slots_[index];
    const Position& now = slot.pending;
    const std::string type = index == touched_.front() ? "::bigint" : "";
    const std::string next = type + ",";
    sql += (type.empty() ? ",(" : "(") + std::to_string(slot.run) + next + literal(slot.info->topic) + "," +
           literal(slot.info->origin) + "," + literal(slot.table->name()) + "," + number(now.first) + next +
           number(now.last) + next + number(now.rows) + next + number(now.sum) + next +
           (slot.stored.is_there ? number(slot.stored.last) : "NULL") + type + ")";
  }
  return sql +
         "), moved AS (UPDATE rtdata_position p SET last_sequence = v.last, rows = v.rows, sum = v.sum, stored_at = "
         "now() FROM v WHERE p.run = v.run AND p.topic = v.topic AND p.origin = v.origin AND p.last_sequence = "
         "v.before RETURNING 1), made AS (INSERT INTO rtdata_position(run, topic, origin, table_name, first_sequence, "
         "last_sequence, rows, sum) SELECT run, topic, origin, table_name, first, last, rows, sum FROM v WHERE before "
         "IS NULL RETURNING 1) SELECT 1 / ((SELECT count(*) FROM moved) + (SELECT count(*) FROM made) = " +
         std::to_string(touched_.size()) + ")::integer";
}

std::function<std::string()> PostgresqlWriter::goes_through([[maybe_unused]] const std::string& recording) {
#ifdef RTDATA_WITH_SQLITE
  recording_ = recording;
  // The last account is written after this sink has closed. It is sent now if the server was available, otherwise at
  // the next start.
  Address address = address_;
  address.timeout = std::min<Duration>(address.timeout, last_account_time);
  return [address, copy = AccountCopy{recording_, machine_, config_.sink.name, config_.sink.topics},
          is_there = is_there_]() -> std::string {
    try {
      if (!*is_there) return {};
      Connection connection(address);
      copy_accounts(connection, copy);
      return {};
    } catch (const SetupError& error) {
      return "the server gets the last account of this run with the next start: " + error.error().text();
    }
  };
#else
  return {};
#endif
}

Result<void> PostgresqlWriter::flush() try {
#ifdef RTDATA_WITH_SQLITE
  if (recording_.empty() || !connection_ || Clock::now() < account_due_) return {};
  const auto begun = Clock::now();
  copy_accounts(connection_, {recording_, machine_, config_.sink.name, config_.sink.topics});
  // A long account is copied less often.
  account_due_ = Clock::now() + std::max<Clock::duration>(account_interval, 50 * (Clock::now() - begun));
#endif
  return {};
} catch (...) {
  return failed();
}

Result<void> PostgresqlWriter::close() {
  is_there_->store(static_cast<bool>(connection_));
  connection_.close();
  return {};
}

}  // namespace rtdata::postgresql
