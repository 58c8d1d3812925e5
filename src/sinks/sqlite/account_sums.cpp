#include "sinks/sqlite/account_sums.hpp"

#include <new>
#include <string>

#include "sinks/sqlite/value_ranges.hpp"

namespace rtdata::sqlite {
namespace {

constexpr std::size_t topics = account_tables.size();  // the number of rtdata_topic among the watched

std::string_view name_of_table(std::size_t table) { return table == topics ? topic_table_name : account_tables[table]; }

/// Where its hashed columns begin: the run is not among them.
int first_hashed(std::size_t table) { return table == topics ? 0 : 1; }

void add(RowSum& to, const RowSum& what) {
  to.rows += what.rows;
  to.sum += what.sum;
}

Result<RowSum> sum_found(const Database& database, std::size_t table, std::int64_t run) {
  auto query = database.prepare("SELECT * FROM " + std::string(name_of_table(table)) +
                                (table == topics ? "" : " WHERE run = ?"));
  if (!query) return std::move(query).error();
  if (table != topics) query->bind(1, run);
  const int end = sqlite3_column_count(query->raw());
  RowSum sum;
  RowHash hash;
  for (;;) {
    auto row = query->step();
    if (!row) return std::move(row).error();
    if (!*row) return sum;
    sum.add(hash_of(hash, query->raw(), first_hashed(table), end));
  }
}

}  // namespace

Result<RunSums> sums_found(const Database& database, std::int64_t run) {
  RunSums sums;
  for (std::size_t table = 0; table < sums.size(); ++table) {
    auto sum = sum_found(database, table, run);
    if (!sum) return std::move(sum).error();
    sums[table] = *sum;
  }
  return sums;
}

/// rtdata_account(table, 1 or -1, run, values...)
void AccountSums::changed(sqlite3_context* context, int count, sqlite3_value** values) {
  auto& self = *static_cast<AccountSums*>(sqlite3_user_data(context));
  try {
    const auto table = static_cast<std::size_t>(sqlite3_value_int(values[0]));
    Change& change = self.pending_[sqlite3_value_int64(values[2])];
    self.hash_.begin();
    for (int i = 3; i < count; ++i) self.hash_.value(values[i]);
    RowSum& sum = table == topics ? change.topics : change.sums[table];
    if (sqlite3_value_int(values[1]) > 0) {
      sum.add(self.hash_.hash());
    } else {
      sum.subtract(self.hash_.hash());
    }
  } catch (const std::bad_alloc&) {
    sqlite3_result_error_nomem(context);
  }
}

Result<void> AccountSums::watch(Database& database) {
  auto line = database.integer("SELECT count(*) FROM rtdata_checksum WHERE run = 0 AND table_name = 'rtdata_topic'");
  if (!line) return std::move(line).error();
  if (sqlite3_create_function_v2(database.raw(), "rtdata_account", -1, SQLITE_UTF8 | SQLITE_INNOCUOUS, this, changed,
                                 nullptr, nullptr, nullptr) != SQLITE_OK) {
    return error_of(database.raw(), "cannot use the recording");
  }
  for (std::size_t table = 0; table <= topics; ++table) {
    const std::string name(name_of_table(table));
    auto columns = columns_of(database, name);
    if (!columns) return std::move(columns).error();
    columns_[table] = static_cast<int>(columns->size());
    const auto call = [&](const char* row, int sign) {
      std::string sql = "rtdata_account(" + std::to_string(table) + "," + std::to_string(sign) + "," +
                        (table == topics ? std::to_string(all_runs)
                                         : std::string(row) + "." + quoted(columns->front()));
      for (std::size_t i = static_cast<std::size_t>(first_hashed(table)); i < columns->size(); ++i)
        sql += std::string(",") + row + "." + quoted((*columns)[i]);
      return sql + ")";
    };
    const auto trigger = [&](const char* suffix, const char* event, const std::string& calls) {
      return "CREATE TEMP TRIGGER " + name + suffix + " AFTER " + event + " ON main." + name + " BEGIN SELECT " +
             calls + "; END;";
    };
    const std::string sql = trigger("_added", "INSERT", call("new", 1)) +
                            trigger("_removed", "DELETE", call("old", -1)) +
                            trigger("_changed", "UPDATE", call("old", -1) + ", " + call("new", 1));
    if (auto made = database.execute(sql); !made) return made;
  }
  if (*line != 0) return {};
  auto found = sum_found(database, topics, all_runs);
  if (!found) return std::move(found).error();
  return insert_line(database, {all_runs, topic_table_name, "", 0, 0, columns_[topics], *found});
}

RunSums AccountSums::sums_of(std::int64_t run) const {
  RunSums sums = run == open_run_ ? settled_ : RunSums{};
  if (const auto change = pending_.find(run); change != pending_.end()) {
    for (std::size_t table = 0; table < sums.size(); ++table) add(sums[table], change->second.sums[table]);
  }
  return sums;
}

Result<void> AccountSums::write_changes(Database& database) {
  Statement query, update;
  for (auto& [run, change] : pending_) {
    if (run == open_run_) continue;
    for (std::size_t table = 0; table <= topics; ++table) {
      const RowSum& sum = table == topics ? change.topics : change.sums[table];
      if (sum == RowSum{}) continue;
      if (!query) {
        auto made = database.prepare(
            "SELECT _rowid_, rows, sum FROM rtdata_checksum WHERE run = ? AND table_name = ? AND origin = ''");
        if (!made) return std::move(made).error();
        query = std::move(*made);
      }
      query.bind(1, run).bind(2, name_of_table(table));
      auto row = query.step();
      if (!row) return std::move(row).error();
      RowSum now;
      const std::int64_t rowid = *row ? query.integer(0) : 0;
      if (*row) now = {static_cast<std::uint64_t>(query.integer(1)), static_cast<std::uint64_t>(query.integer(2))};
      query.reset();
      if (rowid == 0) continue;  // of a format without checksums
      add(now, sum);
      if (!update) {
        auto made = database.prepare("UPDATE rtdata_checksum SET rows = ?, sum = ? WHERE _rowid_ = ?");
        if (!made) return std::move(made).error();
        update = std::move(*made);
      }
      update.bind(1, static_cast<std::int64_t>(now.rows)).bind(2, static_cast<std::int64_t>(now.sum)).bind(3, rowid);
      if (auto done = update.run(); !done) return done;
    }
    change = {};  // what the transaction changes after this is written by another call
  }
  return {};
}

Result<void> AccountSums::write_lines(Database& database, std::int64_t run) {
  const RunSums sums = sums_of(run);
  for (std::size_t table = 0; table < sums.size(); ++table) {
    if (auto made = insert_line(database, {run, account_tables[table], "", 0, 0, columns_[table], sums[table]}); !made)
      return made;
  }
  if (run == open_run_) {
    pending_[run].has_ended = true;
  } else {
    pending_.erase(run);
  }
  return {};
}

void AccountSums::committed() {
  if (const auto change = pending_.find(open_run_); open_run_ != 0 && change != pending_.end()) {
    for (std::size_t table = 0; table < settled_.size(); ++table) add(settled_[table], change->second.sums[table]);
    if (change->second.has_ended) open_run_ = 0;
  }
  pending_.clear();
}

}  // namespace rtdata::sqlite
