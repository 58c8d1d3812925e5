#include "postgresql/account_copy.hpp"

#include <algorithm>
#include <charconv>
#include <map>
#include <set>

#include "postgresql/layout.hpp"
#include "recording/checksum.hpp"
#include "recording/schema.hpp"
#include "rtdata/data/value.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::postgresql {
namespace {

using sqlite::account_tables;

/// The format of COPY: one line for each row, tabs between the values.
void append_text(std::string& out, std::string_view text) {
  for (const char c : text) {
    switch (c) {
      case '\\':
        out += "\\\\";
        break;
      case '\t':
        out += "\\t";
        break;
      case '\n':
        out += "\\n";
        break;
      case '\r':
        out += "\\r";
        break;
      case '\0':  // no text of the server has one
        out += "\\\\x00";
        break;
      default:
        out += c;
    }
  }
}

void append_value(std::string& out, sqlite3_stmt* row, int column) {
  switch (sqlite3_column_type(row, column)) {
    case SQLITE_NULL:
      out += "\\N";
      break;
    case SQLITE_INTEGER:
      out += std::to_string(sqlite3_column_int64(row, column));
      break;
    case SQLITE_FLOAT:
      out += to_string(Value{sqlite3_column_double(row, column)});
      break;
    default:
      append_text(out, {reinterpret_cast<const char*>(sqlite3_column_text(row, column)),
                        static_cast<std::size_t>(sqlite3_column_bytes(row, column))});
  }
}

class RunCopy {
 public:
  struct Run {
    std::int64_t local = 0, server = 0;  ///< its numbers
    bool has_ended = false;
  };
  RunCopy(const sqlite::Database& database, const AccountCopy& copy, const Run& run,
          const std::vector<std::vector<AccountColumn>>& columns)
      : database_(database),
        copy_(copy),
        local_(run.local),
        run_(run.server),
        has_ended_(run.has_ended),
        columns_(columns) {}

  /// False: the server has not all rows yet.
  bool read(const Positions& positions);
  /// In one round trip and transaction.
  void write(Connection& connection) const;

 private:
  bool read_table(std::size_t table, const Positions& positions);
  bool takes(const std::string& topic);
  /// Finds topics that the sink does not take but that are sources of topics that it takes.
  void find_sources();
  /// How many rows of the origin the server refused, as far as the recording remembers.
  std::uint64_t refused(std::string_view topic, std::string_view origin) const;
  /// True if the sink is done with all rows of the origin that are in the recording.
  bool is_done_with(std::string_view topic, std::string_view origin) const;

  const sqlite::Database& database_;
  const AccountCopy& copy_;
  const std::int64_t local_, run_;
  const bool has_ended_;
  const std::vector<std::vector<AccountColumn>>& columns_;
  std::vector<std::string> rows_;
  std::vector<sqlite::RowSum> sums_;
  std::map<std::string, bool> takes_;  // by topic
  std::set<std::string> sources_;
};

bool RunCopy::read(const Positions& positions) {
  find_sources();
  for (std::size_t table = 0; table < account_tables.size(); ++table) {
    if (!read_table(table, positions)) return false;
  }
  return true;
}

bool RunCopy::takes(const std::string& topic) {
  const auto [takes, is_new] = takes_.try_emplace(topic, false);
  if (is_new) {
    takes->second = std::any_of(copy_.topics.begin(), copy_.topics.end(),
                                [&](const std::string& pattern) { return topic_matches(pattern, topic); });
  }
  return takes->second;
}

void RunCopy::find_sources() {
  auto query = database_.prepare("SELECT topic, made_of FROM rtdata_ledger WHERE run = ? AND made_of IS NOT NULL");
  query.bind(1, local_);
  std::multimap<std::string, std::string> made_of;
  std::vector<std::string> next;
  while (query.step()) {
    const std::string topic(query.text(0));
    std::string_view all = query.text(1);
    for (std::size_t end; !all.empty(); all.remove_prefix(std::min(end + 1, all.size()))) {
      end = std::min(all.find(' '), all.size());
      made_of.emplace(topic, all.substr(0, end));
    }
    if (takes(topic)) next.push_back(topic);
  }
  while (!next.empty()) {
    const std::string topic = std::move(next.back());
    next.pop_back();
    for (auto [at, end] = made_of.equal_range(topic); at != end; ++at)
      if (!takes(at->second) && sources_.insert(at->second).second) next.push_back(at->second);
  }
}

std::uint64_t RunCopy::refused(std::string_view topic, std::string_view origin) const {
  auto count = database_.prepare(
      "SELECT count(*) FROM rtdata_refused WHERE sink = ? AND topic = ? AND origin = ? AND run = (SELECT uuid FROM "
      "rtdata_run WHERE run = ?)");
  count.bind(1, copy_.sink).bind(2, topic).bind(3, origin).bind(4, local_).step();
  return static_cast<std::uint64_t>(count.integer(0));
}

bool RunCopy::is_done_with(std::string_view topic, std::string_view origin) const {
  auto tables = database_.prepare(
      "SELECT t.table_name, p.row FROM rtdata_topic t LEFT JOIN rtdata_position p ON p.table_name = t.table_name AND "
      "p.sink = ? WHERE t.topic = ?");
  tables.bind(1, copy_.sink).bind(2, topic);
  while (tables.step()) {
    if (tables.is_null(1)) return false;
    auto left = database_.prepare("SELECT 1 FROM " + sqlite::quoted(tables.text(0)) +
                                  " WHERE _rowid_ > ? AND run = ? AND origin = ? LIMIT 1");
    if (left.bind(1, tables.integer(1)).bind(2, local_).bind(3, origin).step()) return false;
  }
  return true;
}

bool RunCopy::read_table(std::size_t table, const Positions& positions) {
  const std::string_view name = account_tables[table];
  std::map<std::string_view, int> at;
  for (const AccountColumn& column : columns_[table]) at.emplace(column.name, static_cast<int>(at.size()));
  auto query = database_.prepare("SELECT " + names_of(columns_[table]) + " FROM " + std::string(name) +
                                 " WHERE run = ?");
  query.bind(1, local_);
  const auto topic = at.find("topic");
  const bool is_ledger = name == "rtdata_ledger";
  std::string& rows = rows_.emplace_back();
  sqlite::RowSum& sum = sums_.emplace_back();
  sqlite::RowHash hash;
  const int width = static_cast<int>(columns_[table].size());
  while (query.step()) {
    bool is_source = false;
    if (topic != at.end()) {
      const std::string of(query.text(topic->second));
      is_source = !takes(of) && sources_.contains(of);
      if (!takes(of) && !is_source) continue;
    }
    std::map<int, std::int64_t> replaced;                                                  // by column
    if (is_ledger) replaced[at.at("seconds_from")] = replaced[at.at("minutes_from")] = 0;  // steps do not go along
    if (is_ledger && is_source) {  // none of its rows is there: as in a recording that does not take it
      replaced[at.at("filtered")] = query.integer(at.at("filtered")) + query.integer(at.at("published"));
      for (const char* column : {"published", "offered", "stored", "dropped_newest", "dropped_oldest",
                                 "dropped_refused", "dropped_unsaved", "first_sequence", "last_sequence", "pruned"})
        replaced[at.at(column)] = 0;
    } else if (is_ledger) {
      // Rows deleted in the recording are on the server if they were sent before. Rows are missing here if they were
      // deleted before they were sent, or if the sink was attached later: the server counts these as pruned.
      const auto number = [&](const char* column) { return static_cast<std::uint64_t>(query.integer(at.at(column))); };
      const std::string_view of_topic = query.text(at.at("topic")), of_origin = query.text(at.at("origin"));
      const auto found = positions.find({std::string(of_topic), std::string(of_origin)});
      const std::uint64_t stored = number("stored");
      const std::uint64_t here = found != positions.end() ? found->second.rows : 0;
      const std::uint64_t missing = stored - std::min(stored, here);
      std::uint64_t refused_here = missing > 0 ? std::min(refused(of_topic, of_origin), missing) : 0;
      const std::uint64_t dropped = number("dropped_newest") + number("dropped_oldest") + number("dropped_refused") +
                                    number("dropped_unsaved") + refused_here;
      const bool has_first = stored == 0 ||
                             (found != positions.end() && found->second.first <= number("first_sequence") + dropped);
      const bool is_whole = has_first && number("pruned") == 0;
      if (missing > refused_here && is_whole && !has_ended_) return false;
      if (missing > 0 && has_ended_) {
        if (!is_done_with(of_topic, of_origin)) return false;
        if (is_whole) refused_here = missing;  // the recording has forgotten the keys of the oldest rows
      }
      replaced[at.at("stored")] = static_cast<std::int64_t>(stored - refused_here);
      replaced[at.at("dropped_refused")] = static_cast<std::int64_t>(number("dropped_refused") + refused_here);
      replaced[at.at("pruned")] = is_whole ? 0 : static_cast<std::int64_t>(missing - refused_here);
    }
    rows += std::to_string(run_);
    hash.begin();
    for (int column = 1; column < width; ++column) {
      rows += '\t';
      if (const auto other = replaced.find(column); other != replaced.end()) {
        rows += std::to_string(other->second);
        hash.integer(other->second);
      } else {
        append_value(rows, query.raw(), column);
        hash.column(query.raw(), column);
      }
    }
    rows += '\n';
    sum.add(hash.hash());
  }
  return true;
}

void RunCopy::write(Connection& connection) const {
  std::string sql = "BEGIN;SELECT 1 FROM rtdata_run WHERE run = " + std::to_string(run_) + " FOR UPDATE;";
  std::vector<std::string_view> data;
  std::string sums;
  const std::string run = std::to_string(run_);
  const auto add_sum = [&](const std::string& name, std::size_t columns, const sqlite::RowSum& sum) {
    sums += (sums.empty() ? "(" : ",(") + run + ",'" + name + "'," + std::to_string(columns) + "," +
            std::to_string(sum.rows) + "," + std::to_string(static_cast<std::int64_t>(sum.sum)) + ")";
  };
  add_sum("rtdata_position", position_columns, sum_of_positions(connection, run_));
  for (std::size_t table = 0; table < account_tables.size(); ++table) {
    const std::string name(account_tables[table]);
    const bool is_run = name == "rtdata_run";
    const std::string columns = names_of(columns_[table]);
    // Its row is there already: the values come by way of a table of this transaction alone.
    const std::string into = is_run ? "rtdata_run_copy" : name;
    if (is_run) {
      sql += "CREATE TEMP TABLE rtdata_run_copy ON COMMIT DROP AS SELECT " + columns + " FROM rtdata_run LIMIT 0;";
    } else {
      sql += "DELETE FROM " + name + " WHERE run = " + run + ";";
    }
    if (!rows_[table].empty()) {
      sql += "COPY " + into + "(" + columns + ") FROM STDIN;";
      data.push_back(rows_[table]);
    }
    if (is_run) {
      sql += "UPDATE rtdata_run r SET ";
      for (std::size_t i = 1; i < columns_[table].size(); ++i) {
        if (columns_[table][i].name == "uuid") continue;
        sql += quoted_name(columns_[table][i].name) + "=c." + quoted_name(columns_[table][i].name) + ",";
      }
      sql += "account_at = c.ended FROM rtdata_run_copy c WHERE r.run = c.run;";
    }
    add_sum(name, columns_[table].size(), sums_[table]);
  }
  sql += "DELETE FROM rtdata_checksum WHERE run = " + run +
         ";INSERT INTO rtdata_checksum(run, table_name, columns, rows, sum) VALUES " + sums + ";COMMIT";
  connection.copy(sql, data);
}

/// The tables of the account on the server, with all columns.
void make_tables(Connection& connection, const std::vector<std::vector<AccountColumn>>& columns) {
  const Reply there = connection.run(
      "SELECT c.relname || ' ' || a.attname FROM pg_attribute a JOIN pg_class c ON c.oid = a.attrelid WHERE "
      "pg_table_is_visible(c.oid) AND c.relname LIKE 'rtdata\\_%' AND a.attnum > 0 AND NOT a.attisdropped");
  std::set<std::string, std::less<>> known;
  for (int row = 0; row < there.rows(); ++row) known.emplace(there.text(row, 0));
  std::string sql;
  for (std::size_t table = 0; table < account_tables.size(); ++table) {
    const std::string name(account_tables[table]);
    if (!known.contains(name + " run"))
      sql += "CREATE TABLE IF NOT EXISTS " + name + "(run bigint NOT NULL);CREATE INDEX ON " + name + "(run);";
    for (const AccountColumn& column : columns[table]) {
      if (column.name == "run" || known.contains(name + " " + column.name)) continue;
      sql += "ALTER TABLE " + name + " ADD COLUMN IF NOT EXISTS " + quoted_name(column.name) + " " + column.type + ";";
    }
  }
  if (!known.contains("rtdata_checksum run"))
    sql +=
        "CREATE TABLE IF NOT EXISTS rtdata_checksum(run bigint NOT NULL, table_name text NOT NULL, columns integer NOT "
        "NULL, rows bigint NOT NULL, sum bigint NOT NULL, PRIMARY KEY(run, table_name));";
  if (!sql.empty()) in_transaction(connection, [&] { connection.run(sql); });
}

}  // namespace

std::vector<std::vector<AccountColumn>> account_columns() {
  const auto database = sqlite::Database::open("", sqlite::Database::Mode::write);  // in memory
  database.execute(sqlite::schema);
  std::vector<std::vector<AccountColumn>> all;
  for (const std::string_view table : account_tables) {
    auto query = database.prepare("SELECT name, type FROM pragma_table_info(?) ORDER BY cid");
    query.bind(1, table);
    std::vector<AccountColumn>& columns = all.emplace_back();
    while (query.step()) {
      if (query.text(0) == sqlite::checksum_column) continue;  // the server has its own
      const std::string_view type = query.text(1);
      columns.push_back({std::string(query.text(0)), type == "INTEGER" ? "bigint"
                                                     : type == "REAL"  ? "double precision"
                                                                       : "text"});
    }
  }
  return all;
}

std::string names_of(const std::vector<AccountColumn>& columns) {
  std::string names;
  for (const AccountColumn& column : columns) names += (names.empty() ? "" : ",") + quoted_name(column.name);
  return names;
}

sqlite::RowSum sum_of_positions(Connection& connection, std::int64_t run) {
  const Reply rows = connection.run(
      "SELECT r.machine, p.topic, p.origin, p.table_name, p.first_sequence, p.last_sequence, p.rows, p.sum, "
      "(extract(epoch FROM p.stored_at) * 1000000)::bigint, t.first_run FROM rtdata_run r LEFT JOIN rtdata_position p "
      "ON p.run = r.run LEFT JOIN rtdata_topic t ON t.table_name = p.table_name WHERE r.run = " +
      std::to_string(run));
  sqlite::RowSum sum;
  sqlite::RowHash hash;
  for (int row = 0; row < rows.rows(); ++row) {
    hash.begin();
    for (int column = 0; column < position_columns; ++column)
      rows.is_null(row, column) ? hash.null() : hash.text(rows.text(row, column));
    sum.add(hash.hash());
  }
  return sum;
}

void copy_accounts(Connection& connection, const AccountCopy& copy) {
  const auto database = sqlite::Database::open(copy.recording, sqlite::Database::Mode::read);
  const auto columns = account_columns();
  make_tables(connection, columns);

  const Reply ended = connection.run("SELECT uuid FROM rtdata_run WHERE state IN ('closed', 'sealed')");
  std::set<std::string, std::less<>> done;
  for (int row = 0; row < ended.rows(); ++row) done.emplace(ended.text(row, 0));
  struct Wanted {
    std::int64_t run;
    std::string uuid;
    bool has_ended;
  };
  std::vector<Wanted> wanted;
  std::int64_t last = 0;
  auto runs = database.prepare("SELECT run, uuid, state FROM rtdata_run ORDER BY run");
  while (runs.step()) {
    last = runs.integer(0);
    if (!done.contains(runs.text(1))) wanted.push_back({last, std::string(runs.text(1)), runs.text(2) != "recording"});
  }
  runs.reset();
  for (const Wanted& one : wanted) {
    // A run without a row here does not belong to this sink, except the last run, which may have only gaps.
    if (one.run == last) add_run(connection, one.uuid, copy.machine);
    const std::int64_t run = number_of_run(connection, one.uuid);
    if (run == 0) continue;
    const Positions positions = positions_of(connection, run);
    // All of it at one moment, into memory: the recording's log is not held while the network is waited for.
    database.execute("BEGIN");
    RunCopy account(database, copy, {one.run, run, one.has_ended}, columns);
    const bool has_all = account.read(positions);
    database.execute("COMMIT");
    if (has_all) account.write(connection);
  }
}

}  // namespace rtdata::postgresql
