#include "sinks/sqlite/value_ranges.hpp"

#include <algorithm>
#include <map>
#include <utility>

namespace rtdata::sqlite {

void ValueRanges::begin(std::int64_t run, Time started) {
  run_ = run;
  closed_at_ = pending_closed_at_ = started;
}

void ValueRanges::open(Slot& slot, const Record& record, const std::string& table, int columns) {
  slot.info = record.info;
  slot.table = table;
  slot.columns = columns;
  slot.pending.first_sequence = record.header.sequence;
}

void ValueRanges::remove(sqlite3_stmt* row, const std::string& table, RowHash& hash) {
  const std::string_view origin(reinterpret_cast<const char*>(sqlite3_column_text(row, 2)),
                                static_cast<std::size_t>(sqlite3_column_bytes(row, 2)));
  const auto sequence = static_cast<std::uint64_t>(sqlite3_column_int64(row, 3));
  for (std::uint32_t number = 0; number < slots_.size(); ++number) {
    const Slot& found = slots_[number];
    if (found.pending.rows == 0 || found.table != table || found.info->origin != origin) continue;
    Slot& slot = touch(number);
    slot.pending.first_sequence = sequence + 1;
    --slot.pending.rows;
    slot.pending.sum -= hash_of(hash, row, 1, slot.columns);
    return;
  }
}

Result<void> ValueRanges::write(Database& database, Close which, Time at) {
  const auto close = [&](std::uint32_t number) -> Result<void> {
    const LiveRange range = slots_[number].pending;
    if (range.rows == 0) return {};
    Slot& slot = touch(number);
    slot.pending = {};
    return insert_line(database, {run_,
                                  slot.table,
                                  slot.info->origin,
                                  range.first_sequence,
                                  range.last_sequence,
                                  slot.columns,
                                  {range.rows, range.sum}});
  };
  const bool is_aged = which == Close::aged && at - closed_at_ >= longest;
  if (which == Close::all || is_aged) {
    if (which != Close::all || at > pending_closed_at_) pending_closed_at_ = at;
    for (std::uint32_t number = 0; number < slots_.size(); ++number) {
      if (auto closed = close(number); !closed) return closed;
    }
    return {};
  }
  for (std::size_t i = 0; i < touched_.size(); ++i) {
    if (slots_[touched_[i]].pending.rows < most_rows) continue;
    if (auto closed = close(touched_[i]); !closed) return closed;
  }
  return {};
}

void ValueRanges::stage(LiveFile& live) const {
  for (const std::uint32_t number : touched_) {
    if (live.has(number)) live.slot(number).range.stage(slots_[number].pending);
  }
}

void ValueRanges::committed(LiveFile& live) {
  for (const std::uint32_t number : touched_) {
    slots_[number].settled = slots_[number].pending;
    slots_[number].is_touched = false;
    if (live.has(number)) live.slot(number).range.settle();
  }
  touched_.clear();
  closed_at_ = pending_closed_at_;
}

void ValueRanges::rolled_back(LiveFile& live) {
  for (const std::uint32_t number : touched_) {
    slots_[number].pending = slots_[number].settled;
    slots_[number].is_touched = false;
    if (live.has(number)) live.slot(number).range.set(slots_[number].settled);
  }
  touched_.clear();
  pending_closed_at_ = closed_at_;
}

Result<void> insert_line(Database& database, const ChecksumLine& line) {
  auto insert = database.prepare(
      "INSERT INTO rtdata_checksum(run, table_name, origin, first_sequence, last_sequence, columns, rows, sum) "
      "VALUES(?,?,?,?,?,?,?,?)");
  if (!insert) return std::move(insert).error();
  insert->bind(1, line.run).bind(2, line.table).bind(3, line.origin);
  insert->bind(4, static_cast<std::int64_t>(line.first_sequence));
  insert->bind(5, static_cast<std::int64_t>(line.last_sequence));
  insert->bind(6, std::int64_t{line.columns}).bind(7, static_cast<std::int64_t>(line.sum.rows));
  if (line.is_known) {
    insert->bind(8, static_cast<std::int64_t>(line.sum.sum));
  } else {
    insert->bind_null(8);
  }
  return insert->run();
}

Result<std::vector<std::string>> columns_of(const Database& database, std::string_view table) {
  auto query = database.prepare("SELECT name FROM pragma_table_info(?) ORDER BY cid");
  if (!query) return std::move(query).error();
  return query->bind(1, table).texts();
}

namespace {

struct StoredRange {
  std::int64_t rowid;
  std::uint64_t first_sequence, last_sequence;
  int columns;
  RowSum sum;
  bool is_known;
  bool is_changed = false;
};

/// The rows of one origin that are deleted, and the ranges that they are in.
struct Deletion {
  std::uint64_t rows = 0;
  std::vector<StoredRange> ranges = {};
  std::size_t current = 0;
};
using Deletions = std::map<std::pair<std::int64_t, std::string>, Deletion>;

Result<void> load_ranges(Database& database, const std::string& table, Deletions& deletions) {
  auto query = database.prepare(
      "SELECT _rowid_, run, origin, first_sequence, last_sequence, columns, rows, sum FROM rtdata_checksum WHERE "
      "table_name = ? ORDER BY _rowid_");
  if (!query) return std::move(query).error();
  query->bind(1, table);
  for (;;) {
    auto row = query->step();
    if (!row) return std::move(row).error();
    if (!*row) return {};
    const auto of = deletions.find({query->integer(1), std::string(query->text(2))});
    if (of == deletions.end()) continue;
    of->second.ranges.push_back(
        {query->integer(0),
         static_cast<std::uint64_t>(query->integer(3)),
         static_cast<std::uint64_t>(query->integer(4)),
         static_cast<int>(query->integer(5)),
         {static_cast<std::uint64_t>(query->integer(6)), static_cast<std::uint64_t>(query->integer(7))},
         !query->is_null(7)});
  }
}

Result<void> store_ranges(Database& database, const Deletions& deletions) {
  auto remove = database.prepare("DELETE FROM rtdata_checksum WHERE _rowid_ = ?");
  if (!remove) return std::move(remove).error();
  auto update = database.prepare("UPDATE rtdata_checksum SET rows = ?, sum = ? WHERE _rowid_ = ?");
  if (!update) return std::move(update).error();
  for (const auto& [key, deletion] : deletions) {
    for (const StoredRange& range : deletion.ranges) {
      if (!range.is_changed) continue;
      if (range.sum.rows == 0) {
        remove->bind(1, range.rowid);
        if (auto done = remove->run(); !done) return done;
        continue;
      }
      update->bind(1, static_cast<std::int64_t>(range.sum.rows)).bind(3, range.rowid);
      if (range.is_known) {
        update->bind(2, static_cast<std::int64_t>(range.sum.sum));
      } else {
        update->bind_null(2);
      }
      if (auto done = update->run(); !done) return done;
    }
  }
  return {};
}

/// Takes a row out of its range; false when that is not written yet.
bool subtract(Deletion& deletion, sqlite3_stmt* row, RowHash& hash) {
  ++deletion.rows;
  const auto sequence = static_cast<std::uint64_t>(sqlite3_column_int64(row, 3));
  std::vector<StoredRange>& ranges = deletion.ranges;
  while (deletion.current < ranges.size() && ranges[deletion.current].last_sequence < sequence) ++deletion.current;
  if (deletion.current == ranges.size() || sequence < ranges[deletion.current].first_sequence) return false;
  StoredRange& range = ranges[deletion.current];
  range.is_changed = true;
  if (range.is_known) {
    range.sum.subtract(hash_of(hash, row, 1, std::min(range.columns, sqlite3_column_count(row))));
  } else {
    --range.sum.rows;
  }
  return true;
}

}  // namespace

Result<std::vector<DeletedRows>> sums_before_delete(Database& database, const std::string& table, std::int64_t up_to,
                                                    ValueRanges& open) {
  Deletions deletions;
  {
    auto query = database.prepare("SELECT DISTINCT run, origin FROM " + quoted(table) + " WHERE _rowid_ <= ?");
    if (!query) return std::move(query).error();
    query->bind(1, up_to);
    for (;;) {
      auto row = query->step();
      if (!row) return std::move(row).error();
      if (!*row) break;
      deletions[{query->integer(0), std::string(query->text(1))}];
    }
  }
  if (auto loaded = load_ranges(database, table, deletions); !loaded) return std::move(loaded).error();
  auto rows = database.prepare("SELECT t.* FROM " + quoted(table) + " t WHERE _rowid_ <= ? ORDER BY _rowid_");
  if (!rows) return std::move(rows).error();
  rows->bind(1, up_to);
  RowHash hash;
  std::pair<const std::pair<std::int64_t, std::string>, Deletion>* current = nullptr;
  for (;;) {
    auto row = rows->step();
    if (!row) return std::move(row).error();
    if (!*row) break;
    const std::int64_t run = rows->integer(0);
    const std::string_view origin = rows->text(2);
    if (current == nullptr || current->first.first != run || current->first.second != origin)
      current = &*deletions.find({run, std::string(origin)});
    if (!subtract(current->second, rows->raw(), hash) && run == open.run()) open.remove(rows->raw(), table, hash);
  }
  if (auto stored = store_ranges(database, deletions); !stored) return std::move(stored).error();
  std::vector<DeletedRows> deleted;
  for (const auto& [key, deletion] : deletions) deleted.push_back({key.first, key.second, deletion.rows});
  return deleted;
}

}  // namespace rtdata::sqlite
