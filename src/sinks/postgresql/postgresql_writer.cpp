#include "sinks/postgresql/postgresql_writer.hpp"

#include <unistd.h>

#include <cstdio>
#include <random>

#ifdef RTDATA_WITH_SQLITE
#include "sinks/postgresql/account_copy.hpp"
#endif
#include "sinks/postgresql/layout.hpp"

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

std::string key_of(std::string_view topic, std::string_view origin) {
  return std::string(topic).append("\n").append(origin);
}

std::string number(std::uint64_t value) { return std::to_string(static_cast<std::int64_t>(value)); }

/// What the server calls the sessions of this writer, and of no other, on whatever machine: a node may be a copy of
/// another's disk, and processes of two containers may have one number.
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
  auto parts = look_at_url(config.url);
  if (!parts) throw SetupError(std::move(parts).error());
  if (parts->has_password) {
    throw SetupError({Errc::bad_argument, "cannot connect", "`url`", "it has a password in it, which would be recorded",
                      "give it as `password`, or put it into ~/.pgpass"});
  }
}

Result<void> PostgresqlWriter::open() {
  if (connection_) return {};
  forget();
  auto made = Connection::open(address_);
  if (!made) return std::move(made).error();
  connection_ = std::move(*made);
  auto done = make_layout(connection_, config_.schema);
  if (!done) connection_.close();
  return done;
}

void PostgresqlWriter::forget() noexcept {
  runs_.clear();
  positions_.clear();
  slots_.clear();
  touched_.clear();
  tables_.clear();
  waiting_bytes_ = waiting_rows_ = 0;
}

Result<std::int64_t> PostgresqlWriter::run_of(const std::string& uuid) {
  if (const auto known = runs_.find(uuid); known != runs_.end()) return known->second;
  std::string sql = "INSERT INTO rtdata_run(uuid, machine) VALUES($1, $2) ON CONFLICT (uuid) DO NOTHING";
  if (auto made = connection_.query(sql, {{uuid, machine_}}); !made) return std::move(made).error();
  auto found = connection_.query("SELECT run FROM rtdata_run WHERE uuid = $1", {{uuid}});
  if (!found) return std::move(found).error();
  if (found->rows() != 1)
    return Error{Errc::damaged, "cannot store", "rtdata_run", "run " + uuid + " is not there after it was added", ""};
  const std::int64_t run = found->integer(0, 0);
  auto rows = connection_.query(
      "SELECT topic, origin, first_sequence, last_sequence, rows, sum FROM rtdata_position WHERE run = $1",
      {{std::to_string(run)}});
  if (!rows) return std::move(rows).error();
  auto& of_run = positions_[run];
  for (int row = 0; row < rows->rows(); ++row) {
    const auto at = [&](int column) { return static_cast<std::uint64_t>(rows->integer(row, column)); };
    of_run[key_of(rows->text(row, 0), rows->text(row, 1))] = {true, at(2), at(3), at(4), at(5)};
  }
  runs_.emplace(uuid, run);
  return run;
}

Result<void> PostgresqlWriter::prepare(Slot& slot, const SlotInfo& info) {
  auto run = run_of(info.run);
  if (!run) return std::move(run).error();
  const auto key = std::pair(info.topic, info.description->serial());
  auto table = tables_.find(key);
  if (table == tables_.end()) {
    auto made = ServerTable::prepare(connection_, info, *run);
    if (!made) return std::move(made).error();
    table = tables_.emplace(key, std::move(*made)).first;
  }
  slot.info = &info;
  slot.run = *run;
  slot.table = &table->second;
  slot.stored = positions_[*run][key_of(info.topic, info.origin)];
  slot.pending = slot.stored;
  return {};
}

Result<void> PostgresqlWriter::write(Batch& batch) {
  for (bool is_table_known = false;;) {
    Result<void> done;
    try {
      done = store(batch);
    } catch (...) {  // no memory
      connection_.roll_back();
      forget();
      throw;
    }
    if (done) break;
    connection_.roll_back();
    const bool is_row = done.error().code == Errc::does_not_fit && connection_ && waiting_rows_ > 0;
    if (!is_row) {
      forget();
      return done;
    }
    if (!std::exchange(is_table_known, true)) {  // or of every row, since a column has another type now
      forget();
      continue;
    }
    // One row of the transaction is not to be stored. Smaller ones, of what the server has not yet, tell which.
    if (waiting_rows_ == 1) {
      const std::uint32_t slot = touched_.front();
      slots_[slot].refused_to = slots_[slot].pending.last;
      refused_.emplace(std::pair(slot, slots_[slot].pending.last), std::move(done).error());
    }
    most_rows_ = std::max<std::size_t>(waiting_rows_ / 2, 1);
    undo();
  }
  if (!refused_.empty() || has_unfit_topic_) refuse_rows(batch);
  return {};
}

Result<void> PostgresqlWriter::store(const Batch& batch) {
  has_unfit_topic_ = false;
  for (const Record& record : batch) {
    if (record.slot >= slots_.size()) slots_.resize(record.slot + 1);
    Slot& slot = slots_[record.slot];
    if (slot.info != record.info) [[unlikely]] {
      if (!check_columns(record.info->topic, *record.info->description)) {
        has_unfit_topic_ = true;
        continue;
      }
      if (slot.is_touched) {  // its place has gone to another
        if (auto done = send(); !done) return done;
      }
      if (auto done = prepare(slots_[record.slot], *record.info); !done) return done;
    }
    Position& position = slot.pending;
    if (position.is_there && record.header.sequence <= position.last) continue;  // the server has it
    if (record.header.sequence <= slot.refused_to) continue;
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
    if (++waiting_rows_ < most_rows_ && waiting_bytes_ < transaction_bytes) continue;
    if (auto done = send(); !done) return done;
  }
  return send();
}

void PostgresqlWriter::undo() {
  for (const std::uint32_t number : touched_) {
    slots_[number].pending = slots_[number].stored;
    slots_[number].is_touched = false;
  }
  begin_transaction();
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

Result<void> PostgresqlWriter::send() {
  if (touched_.empty()) return {};
  std::string sql = "BEGIN;";
  std::vector<std::string_view> data;
  for (auto& [key, table] : tables_) {
    if (table.is_empty()) continue;
    table.finish();
    sql += table.copy() + ";";
    data.push_back(table.rows().view());
  }
  // One round trip: what fails keeps the server from what follows, COMMIT included.
  sql += positions_sql() + ";COMMIT";
  if (auto done = connection_.copy(sql, data); !done) return done;
  for (const std::uint32_t number : touched_) {
    Slot& slot = slots_[number];
    slot.stored = slot.pending;
    slot.is_touched = false;
    positions_[slot.run][key_of(slot.info->topic, slot.info->origin)] = slot.stored;
  }
  begin_transaction();
  if (most_rows_ != every_row) most_rows_ = most_rows_ <= every_row / 2 ? 2 * most_rows_ : every_row;
  return {};
}

/// Only from the positions that were read: where another program has moved one on meanwhile, such as one whose
/// connection was thought to be dead, the count is another, and dividing by zero undoes the transaction.
std::string PostgresqlWriter::positions_sql() const {
  std::string sql = "WITH v(run, topic, origin, table_name, first, last, rows, sum, before) AS (VALUES ";
  bool is_first = true;
  for (const std::uint32_t index : touched_) {
    const Slot& slot = slots_[index];
    const Position& now = slot.pending;
    if (!is_first) sql += ",";
    sql += "(" + std::to_string(slot.run) + (is_first ? "::bigint," : ",") + connection_.literal(slot.info->topic) +
           "," + connection_.literal(slot.info->origin) + "," + connection_.literal(slot.table->name()) + "," +
           number(now.first) + (is_first ? "::bigint," : ",") + number(now.last) + (is_first ? "::bigint," : ",") +
           number(now.rows) + (is_first ? "::bigint," : ",") + number(now.sum) + (is_first ? "::bigint," : ",") +
           (slot.stored.is_there ? number(slot.stored.last) : "NULL") + (is_first ? "::bigint)" : ")");
    is_first = false;
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
  // The last account is written after this sink has closed. Where the server was there until then it gets it now, else
  // with the next start.
  Address address = address_;
  address.timeout = std::min<Duration>(address.timeout, last_account_time);
  return [address, copy = AccountCopy{recording_, machine_, config_.sink.name, config_.sink.topics},
          is_there = is_there_]() -> std::string {
    if (!*is_there) return {};
    auto connection = Connection::open(address);
    const auto copied = connection ? copy_accounts(*connection, copy) : Result<void>(std::move(connection).error());
    if (copied) return {};
    return "the server gets the last account of this run with the next start: " + copied.error().text();
  };
#else
  return {};
#endif
}

Result<void> PostgresqlWriter::flush() {
#ifdef RTDATA_WITH_SQLITE
  if (recording_.empty() || !connection_ || Clock::now() < account_due_) return {};
  const auto begun = Clock::now();
  auto copied = copy_accounts(connection_, {recording_, machine_, config_.sink.name, config_.sink.topics});
  if (!copied) {
    forget();
    return copied;
  }
  // A long account is copied less often.
  account_due_ = Clock::now() + std::max<Clock::duration>(account_interval, 50 * (Clock::now() - begun));
#endif
  return {};
}

Result<void> PostgresqlWriter::close() {
  is_there_->store(static_cast<bool>(connection_));
  connection_.close();
  return {};
}

}  // namespace rtdata::postgresql
