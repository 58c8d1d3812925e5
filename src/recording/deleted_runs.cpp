#include "recording/deleted_runs.hpp"

#include <map>
#include <string>
#include <utility>

#include "recording/checksum.hpp"
#include "recording/recording_file.hpp"
#include "recording/schema.hpp"
#include "recording/utc_line.hpp"

namespace rtdata {
namespace sqlite {
namespace {

constexpr const char* add_up =
    " ON CONFLICT(topic, origin) DO UPDATE SET runs = runs + excluded.runs, first_run = min(first_run, "
    "excluded.first_run), "
    "last_run = max(last_run, excluded.last_run), started = min(started, excluded.started), "
    "ended = max(ended, excluded.ended), sealed = sealed + excluded.sealed, scheduled = scheduled + "
    "excluded.scheduled, "
    "missed = missed + excluded.missed, failed = failed + excluded.failed, late = late + excluded.late, "
    "received = received + excluded.received, published = published + excluded.published, "
    "unreadable = unreadable + excluded.unreadable, lost = lost + excluded.lost, "
    "not_detectable = not_detectable + excluded.not_detectable, offered = offered + excluded.offered, "
    "stored = stored + excluded.stored, dropped_newest = dropped_newest + excluded.dropped_newest, "
    "dropped_oldest = dropped_oldest + excluded.dropped_oldest, "
    "dropped_refused = dropped_refused + excluded.dropped_refused, "
    "dropped_unsaved = dropped_unsaved + excluded.dropped_unsaved, pruned = pruned + excluded.pruned, "
    "outages = outages + excluded.outages, outage_time = outage_time + excluded.outage_time, "
    "outages_joined = max(outages_joined, excluded.outages_joined)";

std::string sum_of_run() {
  return std::string("INSERT INTO rtdata_deleted SELECT '', '', 1, run, run, ") + utc_of("d.started", "d.run") + ", " +
         utc_of("coalesce(d.ended, d.started)", "d.run") +
         ", state = 'sealed', 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, "
         "max(0, coalesce(lost, 0) - (SELECT coalesce(sum(l.dropped_unsaved), 0) FROM rtdata_ledger l "
         "WHERE l.run = d.run)), 0, 0, 0, 0 FROM rtdata_run d WHERE run = ?1" +
         add_up;
}

std::string sums_of_origins() {
  // As detail::outages_of().
  const auto of_gaps = [](const char* what) {
    return std::string("(SELECT coalesce(") + what +
           ", 0) FROM rtdata_gap g WHERE g.run = l.run AND g.topic = l.topic AND g.origin = l.origin AND "
           "NOT l.has_schedule AND g.kind IN ('joined', 'disconnected', 'silent'))";
  };
  return "INSERT INTO rtdata_deleted SELECT l.topic, l.origin, 1, d.run, d.run, " + utc_of("d.started", "d.run") +
         ", " + utc_of("coalesce(d.ended, d.started)", "d.run") +
         ", 0, l.scheduled, l.missed, l.failed, l.late, l.received, l.published, "
         "l.unreadable, coalesce(l.lost, 0), NOT l.has_schedule AND l.lost IS NULL AND l.published + l.repeated + "
         "l.filtered > 0, l.offered, "
         "l.stored, l.dropped_newest, l.dropped_oldest, l.dropped_refused, l.dropped_unsaved, l.pruned, " +
         of_gaps("sum(iif(g.kind = 'joined', coalesce(g.count, 1), 1))") + ", " +
         of_gaps("sum(max(g.last - g.first, 0))") + ", " + of_gaps("max(g.kind = 'joined')") +
         " FROM rtdata_ledger l JOIN rtdata_run d ON d.run = l.run WHERE l.run = ?1" + add_up;
}

void run_with(Database& database, const std::string& sql, std::int64_t run) {
  auto statement = database.prepare(sql);
  statement.bind(1, run);
  statement.run();
}

}  // namespace

void add_deleted(Database& database, const Statement& row, std::int64_t base) {
  const int columns = sqlite3_column_count(row.raw());
  std::string parameters = "?";
  for (int i = 1; i < columns; ++i) parameters += ",?";
  auto insert = database.prepare("INSERT INTO rtdata_deleted VALUES(" + parameters + ")" + add_up);
  for (int i = 0; i < columns; ++i) {
    const std::string_view name = sqlite3_column_name(row.raw(), i);
    if (name == "first_run" || name == "last_run") {
      insert.bind(i + 1, row.integer(i) + base);
    } else {
      sqlite3_bind_value(insert.raw(), i + 1, sqlite3_column_value(row.raw(), i));
    }
  }
  insert.run();
}

std::vector<std::int64_t> runs_without_rows(const Database& database, std::int64_t ended_before) {
  std::vector<std::int64_t> found;
  auto count = database.integer("SELECT count(*) FROM rtdata_run");
  if (count <= kept_runs) return found;
  auto query = database.prepare(
      "SELECT run, boot_id, state <> 'recording' AND coalesce(ended, started) < ?2 AND run <= (SELECT "
      "run FROM rtdata_run ORDER BY run DESC LIMIT 1 OFFSET ?1) AND run NOT IN (SELECT run FROM rtdata_ledger WHERE "
      "stored <> pruned) "
      "FROM rtdata_run ORDER BY run");
  query.bind(1, std::int64_t{kept_runs}).bind(2, ended_before);
  struct Boot {
    std::int64_t newest = 0;
    bool has_kept = false;  // a run that stays, before `newest` too
  };
  std::map<std::string, Boot, std::less<>> boots;
  std::vector<std::pair<std::int64_t, std::string>> without;
  while (query.step()) {
    Boot& boot = boots[std::string(query.text(1))];
    boot.newest = query.integer(0);
    if (query.integer(2) != 0) {
      without.emplace_back(query.integer(0), query.text(1));
    } else {
      boot.has_kept = true;
    }
  }
  for (const auto& [run, boot] : without) {
    const Boot& of = boots.find(boot)->second;
    if (run != of.newest || !of.has_kept) found.push_back(run);
  }
  return found;
}

void delete_run(Database& database, std::int64_t run) {
  for (const std::string& sum : {sums_of_origins(), sum_of_run()}) run_with(database, sum, run);
  std::string boot;
  {
    auto query = database.prepare("SELECT boot_id FROM rtdata_run WHERE run = ?");
    query.bind(1, run);
    query.step();
    boot = query.text(0);
  }
  for (const std::string_view table : account_tables) {
    run_with(database, "DELETE FROM " + std::string(table) + " WHERE run = ?", run);
  }
  write_utc_line(database, boot);
}

}  // namespace sqlite

Result<DeletedRuns> Recording::deleted_runs() const try {
  DeletedRuns deleted;
  auto query = file_->prepare(
      "SELECT topic, origin, runs, first_run, last_run, started, ended, sealed, scheduled, missed, failed, late, "
      "received, published, unreadable, lost, offered, stored, dropped_newest, dropped_oldest, dropped_refused, "
      "dropped_unsaved, pruned, not_detectable, outages, outage_time, outages_joined FROM rtdata_deleted "
      "ORDER BY topic, origin");
  while (query.step()) {
    const auto count = [&](int column) { return static_cast<std::uint64_t>(query.integer(column)); };
    if (query.text(0).empty()) {
      deleted.runs = count(2);
      deleted.first_run = query.integer(3);
      deleted.last_run = query.integer(4);
      deleted.started = from_nanoseconds(query.integer(5));
      deleted.ended = from_nanoseconds(query.integer(6));
      deleted.sealed = count(7);
      deleted.unsaved = count(21);
      continue;
    }
    DeletedOrigin& of = deleted.origins.emplace_back();
    LedgerEntry& entry = of.account;
    entry.topic = query.text(0);
    entry.origin = query.text(1);
    SensorCounts& sensor = entry.sensor;
    std::uint64_t* const counts[] = {
        &sensor.scheduled,     &sensor.missed,        &sensor.failed,         &sensor.late,           &sensor.received,
        &sensor.published,     &sensor.unreadable,    &sensor.lost,           &entry.offered,         &entry.stored,
        &entry.dropped_newest, &entry.dropped_oldest, &entry.dropped_refused, &entry.dropped_unsaved, &entry.pruned};
    int column = 8;
    for (std::uint64_t* one : counts) *one = count(column++);
    sensor.has_schedule = sensor.scheduled != 0;
    sensor.is_one_a_read = false;  // not known any more
    sensor.lost_is_known = query.integer(23) == 0;
    of.outages = {count(24), Duration{query.integer(25)}, query.integer(26) != 0};
  }
  return deleted;
} catch (const SetupError& error) {
  return error.error();
}

}  // namespace rtdata
