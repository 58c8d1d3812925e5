// Runs that ended without closing.
#include <algorithm>
#include <limits>
#include <optional>
#include <string_view>
#include <unordered_map>

#include "recording/schema.hpp"
#include "recording/seal_account.hpp"
#include "recording/sqlite_writer.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::sqlite {
namespace {

struct OpenRun {
  std::int64_t run;
  std::string uuid;
  std::int64_t ended;
  std::string remark;  // not empty: its account is incomplete anyway
  std::optional<LiveFile> live = {};
  bool had_row = true;
};

/// The tables of a topic that may hold rows of the run, newest version first.
std::vector<std::string> tables_of(Database& database, const std::string& topic) {
  auto query = database.prepare("SELECT table_name FROM rtdata_topic WHERE topic = ? ORDER BY version DESC");
  return query.bind(1, topic).texts();
}

/// The last row of a data table that belongs to an earlier run; 0: there is none. Found by bisection, because runs
/// follow each other, so sealing does not read the rows of other runs.
std::int64_t rows_before(const Database& database, const std::string& table, std::int64_t run) {
  auto last = database.integer("SELECT max(_rowid_) FROM " + quoted(table));
  auto next = database.prepare("SELECT _rowid_, run FROM " + quoted(table) +
                               " WHERE _rowid_ >= ? ORDER BY _rowid_ LIMIT 1");
  std::int64_t before = 0;
  for (std::int64_t end = last + 1; end - before > 1;) {
    const std::int64_t middle = before + (end - before) / 2;
    next.reset();
    next.bind(1, middle);
    if (next.step() && next.integer(1) < run) {
      before = next.integer(0);
    } else {
      end = middle;
    }
  }
  return before;
}

struct LedgerRow {
  std::string origin;
  std::int64_t slot, offered, stored, dropped, first_sequence, last_sequence, rows_up_to, pruned;
  std::int64_t added = 0;  // rows stored after the account was written
  std::int64_t there = 0;  // rows, if some were pruned
};

std::vector<LedgerRow> ledger_of(Database& database, std::int64_t run, const std::string& topic) {
  auto query = database.prepare(
      "SELECT origin, slot, offered, stored, dropped_newest + dropped_oldest + dropped_refused, first_sequence, "
      "last_sequence, rows_up_to, pruned "
      "FROM rtdata_ledger WHERE run = ? AND topic = ?");
  query.bind(1, run).bind(2, topic);
  std::vector<LedgerRow> rows;
  while (query.step()) {
    rows.push_back({std::string(query.text(0)), query.integer(1), query.integer(2), query.integer(3), query.integer(4),
                    query.integer(5), query.integer(6), query.integer(7), query.integer(8)});
  }
  return rows;
}

/// Counts the rows of the run that are newer than the ledger's account of their origin.
void add_later_rows(Database& database, const std::string& table, std::int64_t run, std::vector<LedgerRow>& ledger,
                    std::int64_t& last_time) {
  std::unordered_map<std::string_view, LedgerRow*> by_origin;
  std::int64_t above = std::numeric_limits<std::int64_t>::max();
  for (LedgerRow& row : ledger) {
    by_origin[row.origin] = &row;
    above = std::min(above, row.rows_up_to);
  }
  auto before = rows_before(database, table, run);  // for an origin without an account, `above` belongs to no run
  above = std::max(above, before);
  auto query = database.prepare("SELECT _rowid_, origin, sequence, time FROM " + quoted(table) +
                                " WHERE _rowid_ > ? AND run = ?");
  query.bind(1, above).bind(2, run);
  while (query.step()) {
    const auto found = by_origin.find(query.text(1));
    if (found == by_origin.end() || query.integer(0) <= found->second->rows_up_to) continue;
    LedgerRow& row = *found->second;
    const std::int64_t sequence = query.integer(2);
    ++row.added;
    if (row.first_sequence == 0) row.first_sequence = sequence;
    row.last_sequence = std::max(row.last_sequence, sequence);
    last_time = std::max(last_time, query.integer(3));
  }
}

/// A limit may also have deleted rows newer than the account.
void add_pruned_rows(Database& database, const std::vector<std::string>& tables, std::int64_t run,
                     std::vector<LedgerRow>& ledger) {
  if (std::none_of(ledger.begin(), ledger.end(), [](const LedgerRow& row) { return row.pruned > 0; })) return;
  for (const std::string& table : tables) {
    auto before = rows_before(database, table, run);
    auto query = database.prepare("SELECT origin, count(*) FROM " + quoted(table) +
                                  " WHERE _rowid_ > ? AND run = ? GROUP BY origin");
    query.bind(1, before).bind(2, run);
    while (query.step()) {
      for (LedgerRow& row : ledger)
        if (row.origin == query.text(0)) row.there += query.integer(1);
    }
  }
  for (LedgerRow& row : ledger) {
    if (row.pruned == 0) continue;
    const std::int64_t missing = row.pruned + row.there - row.stored - row.added;
    if (missing <= 0) continue;
    if (row.stored == 0 && row.first_sequence != 0) row.first_sequence -= std::min(missing, row.first_sequence - 1);
    row.added += missing;
  }
}

/// Corrects the ledger of one topic to match its rows. Adds to `lost`, which stays unknown (negative) without live
/// counts. A removed or failed disk may lose transactions that it had confirmed: adds committed but missing rows to
/// `lost_by_disk`.
void seal_topic(Database& database, const OpenRun& run, const std::string& topic, LiveFile* live, std::int64_t& lost,
                std::int64_t& lost_by_disk, std::int64_t& last_time) {
  auto rows = ledger_of(database, run.run, topic);
  if (rows.empty()) return;
  auto tables = tables_of(database, topic);
  for (const std::string& table : tables) add_later_rows(database, table, run.run, rows, last_time);
  add_pruned_rows(database, tables, run.run, rows);
  // Its account may be older than its rows, or missing: it published at least what was offered.
  auto update = database.prepare(
      "UPDATE rtdata_ledger SET offered = ?1, stored = ?2, published = max(published, ?1), "
      "received = max(received, ?1 + repeated + filtered + unreadable), "
      "dropped_newest = dropped_newest + ?3, "
      "dropped_unsaved = ?4, first_sequence = ?5, last_sequence = ?6 WHERE run = ?7 AND topic = ?8 AND origin = ?9");
  for (const LedgerRow& row : rows) {
    std::int64_t first_sequence = row.first_sequence;
    std::int64_t last_sequence = row.last_sequence;
    std::int64_t offered = row.stored + row.added + row.dropped;
    std::int64_t unsaved = 0;
    std::int64_t dropped_more = 0;
    if (live != nullptr && row.slot >= 0 && live->has(static_cast<std::uint32_t>(row.slot))) {
      const LiveCounts& counts = live->counts(static_cast<std::uint32_t>(row.slot));
      const auto refused = row.dropped - std::min(row.dropped, static_cast<std::int64_t>(counts.dropped));
      dropped_more = std::max<std::int64_t>(0, static_cast<std::int64_t>(counts.dropped) - (row.dropped - refused));
      offered = std::max(offered + dropped_more, static_cast<std::int64_t>(counts.offered));
      unsaved = offered - (row.stored + row.added) - row.dropped - dropped_more;
      lost += unsaved;
      const LiveSlot& slot = live->slot(static_cast<std::uint32_t>(row.slot));
      lost_by_disk += std::max<std::int64_t>(0, static_cast<std::int64_t>(slot.committed) - row.stored - row.added);
      if (const auto kept = slot.account.value()) {
        const KilledOrigin killed{run.run, topic, row.origin, offered};
        seal_account(database, killed, *kept, last_time);
        if (first_sequence == 0) first_sequence = static_cast<std::int64_t>(kept->first_sequence);
      }
      if (first_sequence != 0) last_sequence = std::max(last_sequence, first_sequence + offered - 1);
    }
    update.bind_all(offered, row.stored + row.added, dropped_more, unsaved, first_sequence, last_sequence, run.run,
                    topic, row.origin);
    update.run();
  }
}

std::string seal_run(Database& database, OpenRun& run, AccountSums& sums) {
  LiveFile* const live = run.live ? &*run.live : nullptr;
  const bool is_known = live != nullptr && !live->lacks_room();
  sums.add_run(database, run.run, AccountSums::Rows::go);
  auto query = database.prepare("SELECT DISTINCT topic FROM rtdata_ledger WHERE run = ?");
  auto topics = query.bind(1, run.run).texts();
  std::int64_t lost = 0, lost_by_disk = 0;
  std::int64_t last_time = run.ended;
  for (const std::string& topic : topics) seal_topic(database, run, topic, live, lost, lost_by_disk, last_time);
  std::uint64_t unnamed = 0;  // events of origins that have no place in the ledger yet
  if (live != nullptr) {
    auto next = database.prepare("SELECT coalesce(max(slot) + 1, 0) FROM rtdata_ledger WHERE run = ?");
    next.bind(1, run.run);
    next.step();
    for (auto slot = static_cast<std::uint32_t>(next.integer(0)); slot < live->slots() && live->has(slot); ++slot) {
      unnamed += live->counts(slot).offered;
      lost_by_disk += static_cast<std::int64_t>(live->slot(slot).committed);
    }
  }
  std::string remark = (run.remark.empty() ? "" : run.remark + "; ") + "run " + std::to_string(run.run) +
                       " ended without closing";
  const std::string lost_text = "; lost " + std::to_string(lost) + (lost == 1 ? " event, " : " events, ");
  remark += !is_known     ? "; what was published after that is unknown"
            : unnamed > 0 ? lost_text + "and " + std::to_string(unnamed) +
                                " more of sensors whose names are unknown because they had only begun"
                          : lost_text + "published and not yet committed";
  if (lost_by_disk != 0) {
    remark += "; at least " + std::to_string(lost_by_disk) +
              " of them had been committed, and the disk has lost them: it has the data up to an earlier transaction";
  }
  if (!run.had_row) remark += "; it was killed before it had opened this file, so its configuration is unknown";
  auto update = database.prepare(
      "UPDATE rtdata_run SET state = 'sealed', ended = ?, lost = ?, remark = ? WHERE run = ?");
  const bool is_counted = is_known && run.remark.empty();
  update.bind_all(last_time, is_counted ? std::optional(lost + static_cast<std::int64_t>(unnamed)) : std::nullopt,
                  remark, run.run);
  update.run();
  sums.add_run(database, run.run);
  return remark;
}

}  // namespace

void insert_run(const Database& database, const RunInfo& run, AccountSums& sums) {
  auto insert = database.prepare(
      "INSERT INTO rtdata_run(run, uuid, name, notes, configuration, program, host, boot_id, pid, started, ended, "
      "clock_offset, state, format) "
      "SELECT 1 + max((SELECT coalesce(max(run), 0) FROM rtdata_run), (SELECT coalesce(max(last_run), 0) FROM "
      "rtdata_deleted)), ?,?,?,?,?,?,?,?,?,?,?,'recording',? RETURNING *");
  const std::string host = host_name();
  const std::string program = "rtdata " RTDATA_VERSION;
  const std::int64_t started = to_nanoseconds(run.started);
  insert.bind_all(run.uuid, run.name, run.notes, run.configuration, program, host, run.boot_id, run.pid, started,
                  started, run.clock_offset.count(), schema_version);
  sums.run(insert);
}

std::vector<std::string> seal_runs(Database& database, const std::string& recording, const std::string& noted,
                                   AccountSums& sums, std::vector<LiveFile>& used) {
  std::vector<OpenRun> open;
  {
    auto query = database.prepare("SELECT run, uuid, ended, remark FROM rtdata_run WHERE state = 'recording'");
    while (query.step()) {
      open.push_back({query.integer(0), std::string(query.text(1)), query.integer(2), std::string(query.text(3))});
    }
  }
  for (OpenRun& run : open) run.live = LiveFile::find(recording, run.uuid, noted).or_throw();
  auto row_of = database.prepare("SELECT 1 FROM rtdata_run WHERE uuid = ?");
  for (LiveFile& live : LiveFile::without_row(recording, noted)) {
    const RunInfo run = live.run();
    row_of.reset();
    if (row_of.bind(1, run.uuid).step()) continue;
    insert_run(database, run, sums);
    open.push_back({database.last_rowid(), run.uuid, to_nanoseconds(run.started), "", std::move(live), false});
  }
  std::vector<std::string> remarks;
  for (OpenRun& run : open) {
    remarks.push_back(seal_run(database, run, sums));
    if (run.live) used.push_back(std::move(*run.live));
  }
  return remarks;
}

}  // namespace rtdata::sqlite
