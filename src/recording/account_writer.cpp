// The tables of a recording's account: ledger, schedule, gaps, clock, errors, health.
#include "recording/account_writer.hpp"

#include <string_view>

#include "recording/utc_line.hpp"

namespace rtdata::sqlite {
namespace {

/// For columns that are NULL instead of 0.
std::optional<std::uint64_t> unless_zero(std::uint64_t count) {
  return count != 0 ? std::optional(count) : std::nullopt;
}

/// The last row of the topic's table; 0: it has none.
std::int64_t last_row_of(const SlotInfo& slot, const TopicTables& tables) {
  const bool has_table = slot.topic_number < tables.size() && tables[slot.topic_number] != nullptr;
  return has_table ? tables[slot.topic_number]->last_rowid() : 0;
}

}  // namespace

void AccountWriter::prepare(Database& database, AccountSums& sums, std::int64_t run, const std::string& boot_id) {
  database_ = &database;
  sums_ = &sums;
  run_ = run;
  boot_id_ = boot_id;
  struct Prepared {
    Statement& statement;
    const char* sql;
  };
  const Prepared all[] = {
      {ledger_,
       "INSERT INTO rtdata_ledger(run, topic, origin, slot, has_schedule, scheduled, taken, missed, failed, in_flight, "
       "late, received, "
       "published, repeated, filtered, lost, offered, stored, dropped_newest, dropped_oldest, dropped_refused, "
       "first_sequence, "
       "last_sequence, rows_up_to, carried, unreadable, one_a_read, lateness, first_lines) "
       "VALUES(?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?) "
       "ON CONFLICT(run, topic, origin) DO UPDATE SET slot=excluded.slot, has_schedule=excluded.has_schedule, "
       "scheduled=excluded.scheduled, taken=excluded.taken, missed=excluded.missed, failed=excluded.failed, "
       "in_flight=excluded.in_flight, late=excluded.late, received=excluded.received, published=excluded.published, "
       "repeated=excluded.repeated, filtered=excluded.filtered, lost=excluded.lost, offered=excluded.offered, "
       "stored=excluded.stored, "
       "dropped_newest=excluded.dropped_newest, dropped_oldest=excluded.dropped_oldest, "
       "dropped_refused=excluded.dropped_refused, "
       "first_sequence=excluded.first_sequence, last_sequence=excluded.last_sequence, rows_up_to=excluded.rows_up_to, "
       "carried=excluded.carried, unreadable=excluded.unreadable, one_a_read=excluded.one_a_read, "
       "lateness=excluded.lateness, first_lines=excluded.first_lines RETURNING *"},
      {ledger_before_, "SELECT * FROM rtdata_ledger WHERE run = ? AND topic = ? AND origin = ?"},
      {schedule_,
       "INSERT INTO rtdata_schedule(run, origin, topic, first_due, period, end, scheduled, late_after) "
       "VALUES(?,?,?,?,?,?,?,?) "
       "ON CONFLICT(run, origin, first_due) DO UPDATE SET end=excluded.end, scheduled=excluded.scheduled, "
       "period=excluded.period, late_after=excluded.late_after RETURNING *"},
      {schedule_before_, "SELECT * FROM rtdata_schedule WHERE run = ? AND origin = ? AND first_due = ?"},
      {slot_,
       "INSERT OR IGNORE INTO rtdata_ledger(run, topic, origin, slot, has_schedule, scheduled, taken, missed, failed, "
       "in_flight, late, "
       "received, published, repeated, filtered, offered, stored, dropped_newest, dropped_oldest, dropped_refused, "
       "first_sequence, "
       "last_sequence, rows_up_to) VALUES(?,?,?,?,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,?) RETURNING *"},
      {gap_,
       "INSERT INTO rtdata_gap(run, topic, origin, kind, reason, first, last, count) VALUES(?,?,?,?,?,?,?,?) RETURNING "
       "*"},
      {grown_gap_,
       "UPDATE rtdata_gap SET run = ?, topic = ?, origin = ?, kind = ?, reason = ?, first = ?, last = ?, count = ? "
       "WHERE _rowid_ = ?9 AND run = ?1 AND topic = ?2 AND origin = ?3 AND first = ?10 RETURNING *"},
      {gap_before_,
       "SELECT * FROM rtdata_gap WHERE _rowid_ = ?9 AND run = ?1 AND topic = ?2 AND origin = ?3 AND first = ?10"},
      {clock_,
       "INSERT INTO rtdata_clock(run, monotonic, realtime, source, occasion, accuracy, suspended) "
       "VALUES(?,?,?,?,?,?,?) RETURNING *"},
      {error_, "INSERT INTO rtdata_error(run, time, object, id, text, count, last) VALUES(?,?,?,?,?,?,?) RETURNING *"},
      {health_,
       "INSERT INTO rtdata_health(run, time, kind, name, state, reason, count, last) VALUES(?,?,?,?,?,?,?,?) RETURNING "
       "*"},
      {configuration_, "INSERT INTO rtdata_configuration(run, time, object, text) VALUES(?,?,?,?) RETURNING *"},
      {made_of_, "UPDATE rtdata_ledger SET made_of = ? WHERE run = ? AND topic = ? AND origin = ? RETURNING *"},
      {run_end_, "UPDATE rtdata_run SET ended = ?, state = ?, remark = ? WHERE run = ? RETURNING *"},
      {run_before_, "SELECT * FROM rtdata_run WHERE run = ?"},
  };
  for (const Prepared& one : all) {
    if (one.statement) continue;
    one.statement = database.prepare(one.sql);
  }
}

void AccountWriter::write_slots(const Batch& batch, const TopicTables& tables) {
  // Each origin has its place in the ledger before it has rows: sealing finds its live counts by the slot.
  slots_in_transaction_ = static_cast<std::uint32_t>(batch.slots());  // the loop adds more meanwhile
  for (std::uint32_t i = known_slots_; i < slots_in_transaction_; ++i) {
    const SlotInfo& slot = batch.slot(i);
    slot_.bind_all(run_, slot.topic, slot.origin, i, last_row_of(slot, tables));
    sums_->run(slot_);
  }
}

void AccountWriter::write(const Batch& batch, const Account& account, const TopicTables& tables) {
  next_gaps_ = grown_gaps_;
  const auto put_segment = [&](const SlotInfo& slot, const Segment& segment) {
    const std::int64_t first_due = to_nanoseconds(segment.first_due);
    schedule_.bind_all(run_, slot.origin, slot.topic, first_due, segment.period.count(), to_nanoseconds(segment.end),
                       segment.scheduled, segment.late_after.count());
    schedule_before_.bind_all(run_, slot.origin, first_due);
    sums_->replace(schedule_before_, schedule_);
  };
  for (const Account::SegmentEntry& entry : account.segments) put_segment(batch.slot(entry.slot), entry.segment);
  for (const OriginAccount& origin : account.origins) {
    const SlotInfo& slot = batch.slot(origin.slot);
    const SensorCounts& s = origin.sensor;
    ledger_.bind_all(run_, slot.topic, slot.origin, origin.slot, s.has_schedule, s.scheduled, s.taken, s.missed,
                     s.failed, s.in_flight, s.late, s.received, s.published, s.repeated, s.filtered,
                     s.lost_is_known ? std::optional(s.lost) : std::nullopt, origin.offered,
                     batch.stored_after(origin.slot), origin.dropped_newest, origin.dropped_oldest,
                     batch.refused_after(origin.slot), origin.first_sequence, origin.last_sequence,
                     last_row_of(slot, tables), origin.carried, s.unreadable, s.has_schedule && s.is_one_a_read,
                     s.lateness, unless_zero(s.first_lines));
    ledger_before_.bind_all(run_, slot.topic, slot.origin);
    sums_->replace(ledger_before_, ledger_);
    if (origin.segment.scheduled > 0) {  // a segment without ticks has no information
      put_segment(slot, origin.segment);
    }
  }
  for (const Account::MadeOfEntry& entry : account.made_of) {
    const SlotInfo& slot = batch.slot(entry.slot);
    made_of_.bind_all(entry.topics, run_, slot.topic, slot.origin);
    ledger_before_.bind_all(run_, slot.topic, slot.origin);
    sums_->replace(ledger_before_, made_of_);
  }
  for (const Account::GapEntry& entry : account.gaps) {
    write_gap(entry.slot, batch.slot(entry.slot), entry.gap, GapIs::closed);
  }
  for (const OriginAccount& origin : account.origins) {  // those that are under way are the last
    if (!origin.has_gap) continue;
    write_gap(origin.slot, batch.slot(origin.slot), origin.gap, GapIs::under_way);
  }
  for (const ClockPair& pair : account.clock) {
    clock_.bind_all(run_, pair.monotonic.time_since_epoch().count(), to_nanoseconds(pair.realtime), pair.source,
                    pair.occasion, pair.accuracy ? std::optional(pair.accuracy->count()) : std::nullopt,
                    pair.suspended.count());
    sums_->run(clock_);
  }
  if (!account.clock.empty()) write_utc_line(*database_, boot_id_);
  for (const Account::ErrorEntry& entry : account.errors) {
    error_.bind_all(run_, to_nanoseconds(entry.time), entry.object, entry.id, entry.text, entry.count,
                    to_nanoseconds(entry.last));
    sums_->run(error_);
  }
  for (const Account::HealthEntry& entry : account.health) {
    health_.bind_all(run_, to_nanoseconds(entry.time), entry.change.kind.view(), entry.change.name.view(),
                     name_of(entry.change.state), entry.change.reason.view(), entry.count, to_nanoseconds(entry.last));
    sums_->run(health_);
  }
  for (const ConfigurationChange& change : account.configurations) {
    configuration_.bind_all(run_, to_nanoseconds(change.time), change.object, change.text);
    sums_->run(configuration_);
  }
  const std::string_view state = !account.is_last ? "recording" : account.unknown.empty() ? "closed" : "sealed";
  run_end_.bind_all(to_nanoseconds(account.at), state, account.unknown, run_);
  run_before_.bind(1, run_);
  sums_->replace(run_before_, run_end_);
}

/// A gap that was stored while it was open has a row, which is updated.
void AccountWriter::write_gap(std::uint32_t number, const SlotInfo& slot, const Gap& gap, GapIs what) {
  const auto run_with = [&](Statement& statement) {
    statement.bind_all(run_, slot.topic, slot.origin, name_of(gap.kind), gap.reason, to_nanoseconds(gap.first),
                       to_nanoseconds(gap.last), unless_zero(gap.count));
    sums_->run(statement);
  };
  const auto known = next_gaps_.find(number);
  // Gaps of an origin do not overlap; one that is joined may begin earlier than it did.
  if (known != next_gaps_.end() && gap.first <= known->second.first && known->second.first <= gap.last) {
    const Time before = std::exchange(known->second.first, gap.first);
    const auto grow = [&] {
      for (Statement* statement : {&gap_before_, &grown_gap_})
        statement->bind(9, known->second.second).bind(10, to_nanoseconds(before));
      gap_before_.bind_all(run_, slot.topic, slot.origin);
      sums_->run(gap_before_, AccountSums::Rows::go);
      run_with(grown_gap_);
    };
    grow();
    if (sqlite3_changes(database_->raw()) == 0) {  // VACUUM has given it another number
      auto row = database_->prepare(
          "SELECT _rowid_ FROM rtdata_gap WHERE run = ? AND topic = ? AND origin = ? AND first = ?");
      row.bind_all(run_, slot.topic, slot.origin, to_nanoseconds(before));
      known->second.second = row.step() ? row.integer(0) : 0;
      grow();
    }
    if (what == GapIs::closed) next_gaps_.erase(known);
    return;
  }
  run_with(gap_);
  if (what == GapIs::under_way) next_gaps_[number] = {gap.first, database_->last_rowid()};
}

void AccountWriter::committed(const Batch& batch) noexcept {
  if (batch.account() != nullptr) grown_gaps_.swap(next_gaps_);
}

void AccountWriter::close() noexcept {
  for (Statement* statement :
       {&slot_, &ledger_, &schedule_, &gap_, &grown_gap_, &clock_, &error_, &health_, &configuration_, &run_end_,
        &made_of_, &ledger_before_, &schedule_before_, &gap_before_, &run_before_})
    *statement = Statement();
}

}  // namespace rtdata::sqlite
