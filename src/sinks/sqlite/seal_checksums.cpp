#include "sinks/sqlite/seal_checksums.hpp"

#include <algorithm>
#include <map>
#include <string>
#include <vector>

#include "sinks/sqlite/value_ranges.hpp"

namespace rtdata::sqlite {
namespace {

struct Origin {
  std::string topic, name;
  std::int64_t slot = 0;
  std::int64_t rows = 0;  // that are there
  std::uint64_t last_sequence = 0;
  std::string table = {};
  std::int64_t rows_before = 0;  // the last row of its table that is of an earlier run
  std::int64_t covered_rows = 0;
  std::uint64_t covered_up_to = 0;
};

Result<std::vector<Origin>> origins_of(Database& database, std::int64_t run) {
  auto query = database.prepare(
      "SELECT topic, origin, slot, stored - pruned, last_sequence FROM rtdata_ledger WHERE run = ?");
  if (!query) return std::move(query).error();
  query->bind(1, run);
  std::vector<Origin> origins;
  for (;;) {
    auto row = query->step();
    if (!row) return std::move(row).error();
    if (!*row) return origins;
    origins.push_back({std::string(query->text(0)), std::string(query->text(1)), query->integer(2), query->integer(3),
                       static_cast<std::uint64_t>(query->integer(4))});
  }
}

struct RunTable {
  std::string name;
  std::int64_t rows_before = 0;
};

/// Which table has the rows of a run's topic: of several, the one that has any.
Result<std::map<std::string, RunTable>> tables_of(Database& database, std::int64_t run) {
  std::map<std::string, RunTable> tables;
  auto query = database.prepare("SELECT topic, table_name FROM rtdata_topic ORDER BY topic, version DESC");
  if (!query) return std::move(query).error();
  std::map<std::string, bool> has_rows;
  for (;;) {
    auto row = query->step();
    if (!row) return std::move(row).error();
    if (!*row) return tables;
    const std::string topic(query->text(0));
    if (has_rows[topic]) continue;
    RunTable table{std::string(query->text(1))};
    auto before = rows_before(database, table.name, run);
    if (!before) return std::move(before).error();
    table.rows_before = *before;
    auto rows = database.prepare("SELECT 1 FROM " + quoted(table.name) + " WHERE _rowid_ > ? AND run = ? LIMIT 1");
    if (!rows) return std::move(rows).error();
    rows->bind(1, table.rows_before).bind(2, run);
    auto is_any = rows->step();
    if (!is_any) return std::move(is_any).error();
    has_rows[topic] = *is_any;
    if (*is_any || !tables.contains(topic)) tables[topic] = std::move(table);
  }
}

/// Whether the last transaction, of which the live file has both what was before it and what comes after it, is there.
Result<bool> was_committed(Database& database, std::int64_t run, const Origin& origin, const LiveRange& before,
                           const LiveRange& after) {
  const auto has_line = [&]() -> Result<bool> {
    auto line = database.prepare(
        "SELECT 1 FROM rtdata_checksum WHERE run = ? AND table_name = ? AND origin = ? AND first_sequence = ?");
    if (!line) return std::move(line).error();
    line->bind(1, run).bind(2, origin.table).bind(3, origin.name);
    line->bind(4, static_cast<std::int64_t>(before.first_sequence));
    return line->step();
  };
  const auto has_row = [&](std::uint64_t sequence) -> Result<bool> {
    auto row = database.prepare(
        "SELECT 1 FROM " + quoted(origin.table) +
        " WHERE _rowid_ > ? AND run = ? AND origin = ? AND sequence = ? ORDER BY _rowid_ DESC LIMIT 1");
    if (!row) return std::move(row).error();
    row->bind(1, origin.rows_before).bind(2, run).bind(3, origin.name);
    row->bind(4, static_cast<std::int64_t>(sequence));
    return row->step();
  };
  if (before.rows > 0) {
    auto closed = has_line();
    if (!closed || *closed) return closed;
  }
  if (after.rows > 0 && after.last_sequence > before.last_sequence) return has_row(after.last_sequence);
  if (before.rows == 0 || after.first_sequence <= before.first_sequence) return false;
  auto kept = has_row(before.first_sequence);  // it was pruned
  if (!kept) return kept;
  return !*kept;
}

Result<LiveRange> range_of(Database& database, std::int64_t run, const Origin& origin, LiveFile& live) {
  const Kept<LiveRange>& kept = live.slot(static_cast<std::uint32_t>(origin.slot)).range;
  const LiveRange settled = kept.settled().value_or(LiveRange{});
  const std::optional<LiveRange> staged = kept.staged();
  if (!staged) return settled;
  auto committed = was_committed(database, run, origin, settled, *staged);
  if (!committed) return std::move(committed).error();
  return *committed ? *staged : settled;
}

/// The sequence of the last row of an origin that is there; 0: none.
Result<std::uint64_t> last_row(Database& database, std::int64_t run, const Origin& origin) {
  auto row = database.prepare("SELECT sequence FROM " + quoted(origin.table) +
                              " WHERE _rowid_ > ? AND run = ? AND origin = ? ORDER BY _rowid_ DESC LIMIT 1");
  if (!row) return std::move(row).error();
  row->bind(1, origin.rows_before).bind(2, run).bind(3, origin.name);
  auto is_row = row->step();
  if (!is_row) return std::move(is_row).error();
  return *is_row ? static_cast<std::uint64_t>(row->integer(0)) : 0;
}

/// What the lines that there are cover.
Result<void> add_lines(Database& database, std::int64_t run, std::vector<Origin>& origins) {
  std::map<std::pair<std::string_view, std::string_view>, Origin*> by_name;
  for (Origin& origin : origins) by_name[{origin.table, origin.name}] = &origin;
  auto query = database.prepare("SELECT table_name, origin, last_sequence, rows FROM rtdata_checksum WHERE run = ?");
  if (!query) return std::move(query).error();
  query->bind(1, run);
  for (;;) {
    auto row = query->step();
    if (!row) return std::move(row).error();
    if (!*row) return {};
    const auto of = by_name.find({query->text(0), query->text(1)});
    if (of == by_name.end()) continue;
    of->second->covered_rows += query->integer(3);
    of->second->covered_up_to = std::max(of->second->covered_up_to, static_cast<std::uint64_t>(query->integer(2)));
  }
}

}  // namespace

Result<std::int64_t> rows_before(const Database& database, const std::string& table, std::int64_t run) {
  auto last = database.integer("SELECT max(_rowid_) FROM " + quoted(table));
  if (!last) return last;
  auto next = database.prepare("SELECT _rowid_, run FROM " + quoted(table) +
                               " WHERE _rowid_ >= ? ORDER BY _rowid_ LIMIT 1");
  if (!next) return std::move(next).error();
  // Runs follow each other: halves what may be the end of the one before.
  std::int64_t before = 0;
  for (std::int64_t end = *last + 1; end - before > 1;) {
    const std::int64_t middle = before + (end - before) / 2;
    next->reset();
    next->bind(1, middle);
    auto row = next->step();
    if (!row) return std::move(row).error();
    if (*row && next->integer(1) < run) {
      before = next->integer(0);
    } else {
      end = middle;
    }
  }
  return before;
}

Result<std::uint64_t> rows_lost_by_disk(Database& database, std::int64_t run, LiveFile* live) {
  std::uint64_t lost = 0;
  if (live == nullptr) return lost;
  auto origins = origins_of(database, run);
  if (!origins) return std::move(origins).error();
  auto tables = tables_of(database, run);
  if (!tables) return std::move(tables).error();
  for (Origin& origin : *origins) {
    if (origin.slot < 0 || !live->has(static_cast<std::uint32_t>(origin.slot))) continue;
    const auto table = tables->find(origin.topic);
    const auto& kept = live->slot(static_cast<std::uint32_t>(origin.slot)).range;
    if (table == tables->end()) {  // the transaction that made it is not there
      lost += kept.settled().value_or(LiveRange{}).rows;
      continue;
    }
    origin.table = table->second.name;
    origin.rows_before = table->second.rows_before;
    auto range = range_of(database, run, origin, *live);
    if (!range) return std::move(range).error();
    if (range->rows == 0) continue;
    auto last = last_row(database, run, origin);
    if (!last) return std::move(last).error();
    if (*last < range->last_sequence)
      lost += std::min(range->rows, range->last_sequence - std::max(*last, range->first_sequence - 1));
  }
  // Of an origin with rows even the transaction that named it is not there.
  for (std::uint32_t slot = 0; slot < live->slots(); ++slot) {
    const bool is_named = std::any_of(origins->begin(), origins->end(),
                                      [&](const Origin& origin) { return origin.slot == std::int64_t{slot}; });
    if (!is_named && live->has(slot)) lost += live->slot(slot).range.settled().value_or(LiveRange{}).rows;
  }
  return lost;
}

Result<void> take_over_sums(Database& database, std::int64_t run, LiveFile* live, AccountSums& sums,
                            std::uint64_t lost_by_disk) {
  auto found = sums_found(database, run);
  if (!found) return std::move(found).error();
  RunSums taken = *found;
  if (live != nullptr && lost_by_disk == 0) {  // otherwise the account is that of an earlier transaction
    const auto settled = live->sums().settled(), staged = live->sums().staged();
    // What is there is neither: then it was changed since, and verify is to see that.
    if (settled && *settled != *found && (!staged || *staged != *found)) taken = *settled;
  }
  sums.set(run, taken);
  return {};
}

Result<void> seal_ranges(Database& database, std::int64_t run, LiveFile* live) {
  auto origins = origins_of(database, run);
  if (!origins) return std::move(origins).error();
  auto tables = tables_of(database, run);
  if (!tables) return std::move(tables).error();
  std::erase_if(*origins, [&](const Origin& origin) { return !tables->contains(origin.topic); });
  for (Origin& origin : *origins) {
    origin.table = (*tables)[origin.topic].name;
    origin.rows_before = (*tables)[origin.topic].rows_before;
  }
  if (auto added = add_lines(database, run, *origins); !added) return added;
  for (const Origin& origin : *origins) {
    if (origin.rows <= 0) continue;
    auto columns = columns_of(database, origin.table);
    if (!columns) return std::move(columns).error();
    ChecksumLine line{
        .run = run, .table = origin.table, .origin = origin.name, .columns = static_cast<int>(columns->size())};
    std::int64_t rest = origin.rows - origin.covered_rows;
    std::uint64_t first = origin.covered_up_to + 1;
    if (live != nullptr && origin.slot >= 0 && live->has(static_cast<std::uint32_t>(origin.slot))) {
      auto range = range_of(database, run, origin, *live);
      if (!range) return std::move(range).error();
      std::uint64_t last = 0;
      if (range->rows > 0) {
        auto found = last_row(database, run, origin);
        if (!found) return std::move(found).error();
        last = *found;
      }
      if (range->rows > 0 && last < range->last_sequence) {  // of fewer rows no sum is known
        if (rest <= 0) continue;
        line.first_sequence = first;
        line.last_sequence = std::max(first, last);
        line.sum = {static_cast<std::uint64_t>(rest), 0};
        line.is_known = false;
        if (auto inserted = insert_line(database, line); !inserted) return inserted;
        continue;
      }
      if (range->rows > 0) {
        line.first_sequence = range->first_sequence;
        line.last_sequence = range->last_sequence;
        line.sum = {range->rows, range->sum};
        if (auto inserted = insert_line(database, line); !inserted) return inserted;
        rest -= static_cast<std::int64_t>(range->rows);
        first = range->last_sequence + 1;
      }
    }
    if (rest <= 0) continue;
    line.first_sequence = first;
    line.last_sequence = std::max(first, origin.last_sequence);
    line.sum = {static_cast<std::uint64_t>(rest), 0};
    line.is_known = false;
    if (auto inserted = insert_line(database, line); !inserted) return inserted;
  }
  return {};
}

}  // namespace rtdata::sqlite
