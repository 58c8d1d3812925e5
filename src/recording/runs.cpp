#include "rtdata/recording/runs.hpp"

#include <algorithm>

#include "data/number_text.hpp"
#include "recording/changed_file.hpp"
#include "recording/deleted_runs.hpp"
#include "recording/positions.hpp"
#include "recording/recording_file.hpp"
#include "recording/schema.hpp"
#include "recording/sqlite_writer.hpp"
#include "recording/step.hpp"
#include "rtdata/data/problem.hpp"

namespace rtdata {
namespace {

constexpr std::size_t most_listed = 10;

/// Such as 1 "cold", 2 "hot": the newest runs.
std::string list_of(std::span<const RunInfo> runs) {
  std::string text;
  const std::size_t first = runs.size() - std::min(runs.size(), most_listed);
  for (const RunInfo& run : runs.subspan(first))
    text += (text.empty() ? "" : ", ") + std::to_string(run.run) + (run.name.empty() ? "" : " \"" + run.name + "\"");
  return (first == 0 ? "" : "..., ") + text;
}

}  // namespace

Result<RunInfo> find_run(std::span<const RunInfo> runs, std::string_view which, const std::string& path) {
  constexpr const char* doing = "cannot find the run";
  std::int64_t number = 0;
  const bool is_number = detail::read_number(which, number) == std::errc{};
  if (is_number && number < 0 && static_cast<std::uint64_t>(-(number + 1)) < runs.size())
    return runs[runs.size() - static_cast<std::size_t>(-number)];
  std::vector<RunInfo> found;
  for (const RunInfo& run : runs) {
    if (is_number && run.run == number) return run;
    if (!which.empty() && run.name == which) found.push_back(run);
  }
  if (found.size() == 1) return found.front();
  if (!found.empty())
    return Error{Errc::bad_argument, doing, path, "several runs have the name \"" + std::string(which) + "\"",
                 "name one by its number: " + list_of(found)};
  if (runs.empty()) return Error{Errc::not_found, doing, path, "it has no run", ""};
  std::vector<std::string> names;
  for (const RunInfo& run : runs) names.push_back(run.name);
  const std::string nearest = is_number ? "" : nearest_name(which, names);
  return Error{Errc::not_found, doing, path,
               "there is no run " + (is_number ? std::string(which) : "\"" + std::string(which) + "\"") +
                   (nearest.empty() ? "" : " (did you mean \"" + nearest + "\"?)") + "; its runs are " + list_of(runs),
               ""};
}

Result<std::vector<std::string>> seal(const std::string& path) try {
  sqlite::ChangedFile file(path, "cannot seal");
  std::vector<std::string> remarks;
  std::vector<sqlite::LiveFile> used;
  file.transaction([&](sqlite::AccountSums& sums) {
    remarks = sqlite::seal_runs(file.database(), file.real_path(), file.lock().noted(), sums, used);
  });
  for (sqlite::LiveFile& one : used) one.remove();
  sqlite::LiveFile::remove_left(file.real_path());
  file.tidy();
  file.lock().remove();
  return remarks;
} catch (const SetupError& error) {
  return error.error();
}

namespace {

using sqlite::Database;
using sqlite::quoted;

constexpr const char* deleting = "cannot delete the run";

/// Deletes a run, within a transaction.
class Deletion {
 public:
  Deletion(Database& database, sqlite::AccountSums& sums, std::int64_t run)
      : database_(database), sums_(sums), run_(run) {}

  RunDeletion all(Unsent unsent) {
    for (const auto& [topic, table] : topics()) look_at(topic, table);
    if (unsent == Unsent::refused && !found_.unsent.empty()) refuse_unsent();
    check_account();
    for (const auto& [topic, table] : topics()) {
      if (unsent == Unsent::discarded) count_unsent(topic, table);
      move_positions(topic, table);
      for (const std::string& one : sqlite::tables_of_topic(table))
        if (sqlite::has_table(database_, one)) run_with("DELETE FROM " + quoted(one) + " WHERE run = ?");
    }
    run_with("UPDATE rtdata_ledger SET pruned = stored WHERE run = ?");
    keep_clock();
    sqlite::delete_run(database_, run_);
    return std::move(found_);
  }

 private:
  using Topic = std::pair<std::string, std::string>;  // and its table

  [[noreturn]] void refuse(std::string why, std::string advice) const {
    throw SetupError({Errc::bad_argument, deleting, database_.path() + ", run " + std::to_string(run_), std::move(why),
                      std::move(advice)});
  }

  void run_with(const std::string& sql) {
    auto statement = database_.prepare(sql);
    statement.bind(1, run_).run();
  }

  std::vector<Topic> topics() {
    std::vector<Topic> all;
    auto query = database_.prepare("SELECT topic, table_name FROM rtdata_topic ORDER BY topic, version");
    while (query.step()) all.emplace_back(query.text(0), query.text(1));
    return all;
  }

  std::uint64_t rows_after(const std::string& table, std::int64_t row) {
    auto rows = database_.prepare("SELECT count(*) FROM " + quoted(table) + " WHERE run = ? AND _rowid_ > ?");
    rows.bind(1, run_).bind(2, row).step();
    return static_cast<std::uint64_t>(rows.integer(0));
  }

  void look_at(const std::string& topic, const std::string& table) {
    auto rows = database_.prepare("SELECT origin, count(*) FROM " + quoted(table) + " WHERE run = ? GROUP BY origin");
    rows.bind(1, run_);
    while (rows.step()) {
      const auto count = static_cast<std::uint64_t>(rows.integer(1));
      rows_[{topic, std::string(rows.text(0))}] += count;
      found_.rows += count;
    }
    for (const sqlite::SinkPosition& of : sqlite::sink_positions(database_, topic, table)) {
      const std::uint64_t waits = rows_after(table, sqlite::row_of(database_, table, of.position));
      if (waits != 0) found_.unsent[of.sink] += waits;
    }
  }

  [[noreturn]] void refuse_unsent() const {
    std::string sinks;
    for (const auto& [sink, count] : found_.unsent)
      sinks += (sinks.empty() ? "" : ", ") + std::to_string(count) + " for sink " + sink;
    refuse("peers do not have all events of the run: " + sinks,
           "send them (`rtdata run`, `rtdata forward`), or give them up: --discard-backlog");
  }

  /// The sums must balance after the account is added.
  void check_account() {
    auto ledger = database_.prepare("SELECT topic, origin, stored - pruned FROM rtdata_ledger WHERE run = ?");
    ledger.bind(1, run_);
    std::string differs;
    while (ledger.step()) {
      const auto rows = rows_.find({std::string(ledger.text(0)), std::string(ledger.text(1))});
      const std::uint64_t there = rows == rows_.end() ? 0 : rows->second;
      if (static_cast<std::uint64_t>(ledger.integer(2)) != there) differs = ledger.text(0);
      if (rows != rows_.end()) rows_.erase(rows);
    }
    if (!rows_.empty()) differs = rows_.begin()->first.first;
    if (!differs.empty())
      refuse("it does not balance: the number of rows of " + differs + " differs from its account",
             "see `rtdata verify`; keep the file as it is, and record into another one");
  }

  void count_unsent(const std::string& topic, const std::string& table) {
    for (const sqlite::SinkPosition& of : sqlite::sink_positions(database_, topic, table)) {
      const std::uint64_t waits = rows_after(table, sqlite::row_of(database_, table, of.position));
      if (waits != 0) sqlite::add_unsent(database_, sums_, of.sink, topic, static_cast<std::int64_t>(waits));
    }
  }

  /// Moves a position from a deleted row to the last row before it that stays.
  void move_positions(const std::string& topic, const std::string& table) {
    auto move = database_.prepare(
        "INSERT OR REPLACE INTO rtdata_position SELECT ?1, ?2, coalesce(r._rowid_, 0), coalesce(r.run, 0), "
        "coalesce(r.origin, ''), coalesce(r.sequence, 0), p.host FROM rtdata_position p LEFT JOIN (SELECT _rowid_, "
        "run, origin, sequence FROM " +
        quoted(table) +
        " WHERE _rowid_ <= ?3 AND run <> ?4 ORDER BY _rowid_ DESC LIMIT 1) r WHERE p.sink = ?1 AND p.table_name = ?2");
    for (const sqlite::SinkPosition& of : sqlite::sink_positions(database_, topic, table)) {
      if (of.position.run != run_) continue;
      move.bind(1, of.sink).bind(2, table).bind(3, sqlite::row_of(database_, table, of.position)).bind(4, run_);
      move.run();
    }
  }

  /// Gives its clock pairs to another run of its boot: the UTC of that boot's runs may come from them.
  void keep_clock() {
    auto other = database_.integer(
        "SELECT o.run FROM rtdata_run d JOIN rtdata_run o ON o.boot_id = d.boot_id AND o.run <> d.run WHERE d.run = " +
        std::to_string(run_) + " ORDER BY o.run DESC LIMIT 1");
    if (other == 0) return;
    sums_.add_run(database_, other, sqlite::AccountSums::Rows::go);
    run_with("UPDATE rtdata_clock SET run = " + std::to_string(other) + " WHERE run = ?");
    sums_.add_run(database_, other);
  }

  Database& database_;
  sqlite::AccountSums& sums_;
  const std::int64_t run_;
  RunDeletion found_;
  std::map<Topic, std::uint64_t> rows_;  // by topic and origin
};

}  // namespace

Result<RunDeletion> delete_run(const std::string& path, std::int64_t run, Unsent unsent) try {
  sqlite::ChangedFile file(path, deleting);
  RunDeletion deleted;
  file.transaction([&](sqlite::AccountSums& sums) {
    auto state = file.database().prepare("SELECT state FROM rtdata_run WHERE run = ?");
    if (!state.bind(1, run).step())
      throw SetupError({Errc::not_found, deleting, path, "there is no run " + std::to_string(run), ""});
    if (state.text(0) == name_of(RunState::recording))
      throw SetupError({Errc::bad_argument, deleting, path + ", run " + std::to_string(run),
                        "it ended without closing, and what it lost is not written down yet",
                        "`rtdata seal` does that: then it can be deleted"});
    state.reset();
    deleted = Deletion(file.database(), sums, run).all(unsent);
  });
  file.tidy();
  return deleted;
} catch (const SetupError& error) {
  return error.error();
}

Result<std::map<std::int64_t, std::uint64_t>> hashes_of_runs(const Recording& recording) try {
  const detail::Snapshot snapshot(recording.file());
  std::map<std::int64_t, std::uint64_t> hashes;
  const std::string sum = sqlite::quoted(sqlite::checksum_column);
  auto accounts = recording.file()->prepare("SELECT run, " + sum + " FROM rtdata_run");
  while (accounts.step()) hashes[accounts.integer(0)] = static_cast<std::uint64_t>(accounts.integer(1));
  for (const RecordedTopic& topic : recording.topics().or_throw()) {
    auto rows = recording.file()->prepare("SELECT run, " + sum + " FROM " + sqlite::quoted(topic.table) + " WHERE " +
                                          sum + " IS NOT NULL");
    while (rows.step()) {
      const auto of_run = hashes.find(rows.integer(0));
      if (of_run != hashes.end()) of_run->second += static_cast<std::uint64_t>(rows.integer(1));
    }
  }
  return hashes;
} catch (const SetupError& error) {
  return error.error();
}

}  // namespace rtdata
