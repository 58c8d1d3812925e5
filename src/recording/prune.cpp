#include "recording/prune.hpp"

#include <algorithm>
#include <iterator>
#include <limits>
#include <utility>

#include "recording/deleted_runs.hpp"
#include "recording/schema.hpp"
#include "recording/step.hpp"

namespace rtdata::sqlite {
namespace {

constexpr std::int64_t most_rows = 10'000;     // in a step, of all tables together
constexpr std::int64_t least_rows = 500;       // and of each
constexpr std::int64_t steps_of_a_span = 128;  // rows are deleted in steps of this part of the recorded time
constexpr int most_shift = 8;
constexpr std::int64_t least_pages = 16;  // freed in one transaction, if there are as many

}  // namespace

Pruner::Pruner(std::uint64_t max_bytes, Duration max_age)
    : max_bytes_(max_bytes), max_age_(max_age), share_(max_bytes) {}

/// Each run has its own clock, which may have started wrong. The conversion to the present run's clock uses the latest
/// UTC data of both.
void Pruner::find_lines(Database& database, std::int64_t now) {
  lines_.clear();
  auto query = database.prepare(
      "SELECT r.run, r.clock_offset, coalesce((SELECT u.\"offset\" FROM rtdata_utc u WHERE u.boot_id = r.boot_id ORDER "
      "BY u.since DESC LIMIT 1), r.clock_offset), r.started, max(coalesce(r.ended, r.started) - r.started, 0) "
      "FROM rtdata_run r ORDER BY r.run DESC");
  std::int64_t present = 0, run_since = run_for_;
  while (query.step()) {
    const std::int64_t run = query.integer(0), to_utc = query.integer(2) - query.integer(1);
    if (run == run_) {
      present = to_utc;
      run_for_ = std::max<std::int64_t>(now - query.integer(3), 0);
      run_since = run_for_;
      continue;
    }
    lines_[run] = {to_utc, run_since};
    run_since += query.integer(4);
  }
  for (auto& [run, line] : lines_) line.shift -= present;
}

Pruner::Line Pruner::line_of(std::int64_t run) const {
  const auto found = lines_.find(run);
  return found != lines_.end() ? found->second : Line{};
}

bool Pruner::is_beyond(std::int64_t time, std::int64_t run, const Limit& limit) const {
  return time < limit.time || line_of(run).run_since > limit.age;
}

bool Pruner::is_beyond(const Table& table, const Limit& limit) const {
  return table.has_rows() && is_beyond(table.first_time, table.first_run, limit);
}

void Pruner::find_tables(Database& database, std::int64_t now) {
  find_lines(database, now);
  auto count = database.integer("SELECT count(*) FROM sqlite_schema WHERE type = 'table'");
  if (!count_pruned_) {
    count_pruned_ = database.prepare(
        "UPDATE rtdata_ledger SET pruned = pruned + ?4 WHERE run = ?1 AND topic = ?2 AND origin = ?3 RETURNING *");
    ledger_before_ = database.prepare("SELECT * FROM rtdata_ledger WHERE run = ?1 AND topic = ?2 AND origin = ?3");
  }
  if (found_tables_ != count) {
    tables_.clear();
    auto query = database.prepare("SELECT topic, table_name FROM rtdata_topic");
    while (query.step()) {
      Table table;
      table.topic = query.text(0);
      table.name = query.text(1);
      const std::string name = rtdata::sqlite::quoted(table.name);
      const std::string ends = "SELECT _rowid_ FROM " + name + " WHERE " + rtdata::sqlite::quoted(checksum_column) +
                               " IS NOT NULL ";
      const std::pair<Statement*, std::string> all[] = {
          {&table.first, "SELECT _rowid_, time, run FROM " + name + " ORDER BY _rowid_ LIMIT 1"},
          {&table.last, ends + "ORDER BY _rowid_ DESC LIMIT 1 OFFSET 1"},
          {&table.at, "SELECT time, run FROM " + name + " WHERE _rowid_ >= ? ORDER BY _rowid_ LIMIT 1"},
          // Up to the first row that is not older, without regard to later rows, because a later run's clock may have
          // been wrong.
          {&table.up_to,
           "SELECT min(CASE WHEN time >= ?2 OR run <> ?3 THEN _rowid_ - 1 END), max(_rowid_) FROM (SELECT _rowid_, "
           "time, run "
           "FROM " +
               name + " ORDER BY _rowid_ LIMIT ?1)"},
          {&table.ends[0], ends + "AND _rowid_ >= ? ORDER BY _rowid_ LIMIT 1"},
          {&table.ends[1], ends + "AND _rowid_ < ? ORDER BY _rowid_ DESC LIMIT 1"},
          {&table.count, "SELECT run, origin, count(*), max(time), max(sequence) FROM " + name +
                             " WHERE _rowid_ <= ? GROUP BY run, origin"},
          {&table.remove, "DELETE FROM " + name + " WHERE _rowid_ <= ?"},
      };
      for (const auto& [statement, sql] : all) *statement = database.prepare(sql);
      for (const StepLength& length : step_lengths) {
        const std::string steps = step_table(table.name, length);
        if (!has_table(database, steps)) continue;
        table.remove_steps.push_back(
            database.prepare("DELETE FROM " + rtdata::sqlite::quoted(steps) +
                             " WHERE run = ? AND origin = ? AND time <= ? AND last_sequence <= ?"));
      }
      tables_.push_back(std::move(table));
    }
    found_tables_ = count;
  }
  for (Table& table : tables_) look_at(table);
}

void Pruner::look_at(Table& table) {
  const bool first = table.first.step();
  table.first_rowid = first ? table.first.integer(0) : 0;
  const std::int64_t run = first ? table.first.integer(2) : 0;
  if (std::exchange(table.first_run, run) != run) may_have_runs_ = true;
  table.first_time = first ? table.first.integer(1) + line_of(run).shift : 0;
  table.first.reset();
  const bool last = table.last.step();
  table.last_rowid = last ? table.last.integer(0) : 0;
  table.last.reset();
}

Pruner::Pages Pruner::pages(Database& database) {
  Pages now;
  if (!page_count_) {
    page_count_ = database.prepare("PRAGMA page_count");
    free_pages_ = database.prepare("PRAGMA freelist_count");
  }
  now.bytes = database.integer("PRAGMA page_size");
  for (auto& [statement, number] : {std::pair{&page_count_, &now.all}, std::pair{&free_pages_, &now.free}}) {
    statement->step();
    *number = statement->integer(0);
    statement->reset();
  }
  return now;
}

std::int64_t Pruner::delete_rows(const Work& on, Table& table, std::int64_t row, const Limit& limit) {
  std::int64_t up_to = 0;
  for (Statement& end : table.ends) {
    const bool found = end.bind(1, row).step();
    up_to = found ? end.integer(0) : 0;
    end.reset();
    if (up_to == 0 || !limit.is_exact) break;
    table.at.bind(1, up_to).step();
    const std::int64_t run = table.at.integer(1), time = table.at.integer(0) + line_of(run).shift;
    table.at.reset();
    if (is_beyond(time, run, limit)) break;
  }
  up_to = std::min(up_to, table.last_rowid);
  if (up_to < table.first_rowid) return 0;
  if (on.positions != nullptr) on.positions->count_unsent(on.database, on.sums, table.topic, table.name, up_to);
  std::int64_t deleted = 0;
  table.count.bind(1, up_to);
  while (table.count.step()) {
    const std::string origin(table.count.text(1));
    for (Statement* statement : {&ledger_before_, &count_pruned_})
      statement->bind(1, table.count.integer(0)).bind(2, table.topic).bind(3, origin);
    count_pruned_.bind(4, table.count.integer(2));
    on.sums.replace(ledger_before_, count_pruned_);
    for (Statement& steps : table.remove_steps) {
      steps.bind(1, table.count.integer(0)).bind(2, std::string_view(origin));
      steps.bind(3, table.count.integer(3)).bind(4, table.count.integer(4)).run();
    }
    deleted += table.count.integer(2);
  }
  table.count.reset();
  table.remove.bind(1, up_to);
  table.remove.run();
  if (deleted > 0) deleted_.push_back({table.topic, table.name, up_to});
  look_at(table);
  return deleted;
}

std::int64_t Pruner::delete_beyond(const Work& on, const Limit& limit) {
  const std::int64_t most = std::max(least_rows, most_rows / std::max<std::int64_t>(std::ssize(tables_), 1));
  std::int64_t deleted = 0;
  for (Table& table : tables_) {
    for (std::int64_t left = most; left > 0 && is_beyond(table, limit);) {  // run by run
      const bool is_whole_run = table.first_time >= limit.time;
      const std::int64_t shift = line_of(table.first_run).shift;
      table.up_to.bind_all(left, is_whole_run ? std::numeric_limits<std::int64_t>::max() : limit.time - shift,
                           table.first_run);
      table.up_to.step();
      const std::int64_t last = table.up_to.integer(table.up_to.is_null(0) ? 1 : 0);
      table.up_to.reset();
      auto count = delete_rows(on, table, std::min(last, table.last_rowid), limit);
      if (count == 0) break;
      deleted += count;
      left -= count;
    }
  }
  return deleted;
}

std::int64_t Pruner::delete_part_of_future(const Work& on, std::int64_t now) {
  std::int64_t deleted = 0;
  for (Table& table : tables_) {
    if (!table.has_rows() || table.first_time < now) continue;
    const std::int64_t part = (table.last_rowid - table.first_rowid) / steps_of_a_span;
    deleted += delete_rows(on, table, std::min(table.first_rowid + std::min(part, most_rows), table.last_rowid), {now});
  }
  return deleted;
}

std::int64_t Pruner::end_of_step(std::int64_t time, const Pages& now, std::int64_t goal) {
  std::int64_t rows = 0;
  for (const Table& table : tables_)
    if (table.has_rows()) rows += table.last_rowid - table.first_rowid + 1;
  const auto part = static_cast<double>(now.used() - goal) / static_cast<double>(now.used());
  const auto most = static_cast<std::int64_t>(static_cast<double>(rows) * part) + 1;
  for (Table& table : tables_) {
    if (!table.has_rows() || table.first_time >= time || table.first_rowid + most >= table.last_rowid) continue;
    table.at.bind(1, table.first_rowid + most);
    if (table.at.step()) time = std::min(time, table.at.integer(0) + line_of(table.at.integer(1)).shift);
    table.at.reset();
  }
  return time;
}

void Pruner::make_room(Database& database, AccountSums& sums, Positions& positions, Time now) {
  has_more_ = is_exhausted_ = false;
  const std::int64_t at = to_nanoseconds(now);
  share_.hold(database, sums);
  auto begin = pages(database);
  Pages left = begin;
  if (used_before_ == 0) used_before_ = left.used();
  // Reserves 1/10 of the limit for the WAL file, and 1/20 for rows that are written before the next call.
  const auto of_limit = [&](std::uint64_t part) {
    return static_cast<std::int64_t>(max_bytes_ / part / static_cast<std::uint64_t>(left.bytes));
  };
  const std::int64_t most = max_bytes_ == 0 ? std::numeric_limits<std::int64_t>::max()
                                            : of_limit(1) - of_limit(10) - of_limit(20);
  const bool is_too_large = left.used() > most;
  const bool is_time = max_age_.count() > 0 && at >= next_look_;
  Work on{database, sums, nullptr};
  if (is_too_large || is_time) {
    find_tables(database, at);
    if (database.integer("SELECT EXISTS(SELECT 1 FROM rtdata_position)") != 0) on.positions = &positions;
  }
  // Deletes about as much as came since the last call, so that one transaction writes little to the WAL file; later
  // transactions delete the rest.
  const std::int64_t enough = std::max({least_pages, 2 * (left.used() - used_before_), of_limit(40)});
  if (is_time) {
    const Limit limit{at - max_age_.count(), max_age_.count(), true};
    auto deleted = delete_beyond(on, limit);
    has_more_ = deleted > 0 && std::any_of(tables_.begin(), tables_.end(),
                                           [&](const Table& table) { return is_beyond(table, limit); });
    if (!has_more_) delete_runs(database, at - max_age_.count(), 0, enough);
    // Once for many rows: each write costs a page.
    if (!has_more_) next_look_ = at + max_age_.count() / 100;
  }
  if (is_too_large) {
    const std::int64_t goal = most - of_limit(64);
    int shift = 0;  // of the step: grows while nothing is found to be deleted
    while (left.used() > goal) {
      if (may_have_runs_) {
        constexpr std::int64_t at_any_time = std::numeric_limits<std::int64_t>::max();
        delete_runs(database, at_any_time, goal, enough);
        left = pages(database);
        if (has_more_ || left.used() <= goal) break;
      }
      std::int64_t first = std::numeric_limits<std::int64_t>::max();
      for (const Table& table : tables_) {
        if (table.has_rows()) first = std::min(first, table.first_time);
      }
      is_exhausted_ = first == std::numeric_limits<std::int64_t>::max() || shift == most_shift;
      if (is_exhausted_) break;
      std::int64_t deleted = 0;
      if (first < at) {
        const std::int64_t step = std::max<std::int64_t>(1, (at - first) / steps_of_a_span);
        auto end = end_of_step(first + step * (std::int64_t{1} << shift), left, goal);
        deleted += delete_beyond(on, {std::max(end, first + 1)});
      }
      deleted += delete_part_of_future(on, at);
      shift = deleted > 0 ? 0 : shift + 1;
      left = pages(database);
      if (begin.used() - left.used() >= enough && left.used() > goal) {
        has_more_ = true;
        break;
      }
    }
  }
  if (max_bytes_ > 0) shrink(database, left);
  used_before_ = left.used();
}

void Pruner::delete_runs(Database& database, std::int64_t ended_before, std::int64_t goal, std::int64_t enough) {
  auto begin = pages(database);
  auto runs = runs_without_rows(database, ended_before);
  for (const std::int64_t run : runs) {
    delete_run(database, run);
    auto left = pages(database);
    if (left.used() <= goal) return;
    has_more_ = begin.used() - left.used() >= enough && run != runs.back();
    if (has_more_) return;
  }
  if (ended_before == std::numeric_limits<std::int64_t>::max()) may_have_runs_ = false;
}

/// New rows reuse free pages; pages beyond the limit of the file are released.
void Pruner::shrink(Database& database, const Pages& now) {
  const auto most = static_cast<std::int64_t>((max_bytes_ - max_bytes_ / 10) / static_cast<std::uint64_t>(now.bytes));
  const std::int64_t too_many = std::min(now.all - most, now.free);
  if (too_many <= 0) return;
  const std::int64_t at_once = std::max(least_pages, static_cast<std::int64_t>(max_bytes_ / 40) / now.bytes);
  database.execute("PRAGMA incremental_vacuum(" + std::to_string(std::min(too_many, at_once)) + ")");
  if (too_many <= at_once) return;
  auto after = pages(database);
  has_more_ = has_more_ || after.all < now.all;  // a file made without auto_vacuum stays as large as it is
}

}  // namespace rtdata::sqlite
