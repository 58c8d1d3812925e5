// One thing after the other is changed in a recording, by seed: verify sees it.
#include <cstdlib>
#include <random>
#include <set>

#include "recording/checksum.hpp"
#include "recordings.hpp"
#include "sinks/scripted_peer.hpp"

using namespace recordings;
using namespace std::chrono_literals;

namespace {

/// A closed run with something in each table: failures, missed ticks, changes of rate, a feed, one that is silent, a
/// set clock; and another run after it.
void record(const std::string& path) {
  for (int run = 0; run < 2; ++run) {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    loop.runtime().on_log([](const LogRecord&) {});
    SqliteSink sink(loop, {.path = path});
    int n = 0;
    Sensor<Climate> room(loop, {.name = "room", .topic = "climate", .rate = 100_Hz}, [&]() -> Reading<Climate> {
      ++n;
      if (n > 30 && n < 33) return Error{Errc::io_failed, "no answer", "", "", ""};
      if (n == 90) loop.manual_clock().pass(55ms);
      if (run == 1 && n % 7 == 0) return nothing_new;
      return Climate{0.5 * n, 40};
    });
    Sensor<Climate> hall(loop, {.name = "hall", .topic = "climate", .rate = 40_Hz}, [&] {
      return Climate{1.0 * n, 1};
    });
    Feed<Everything> feed(loop, {.name = "feed", .topic = "every/thing"});
    Feed<Climate> silent(loop, {.name = "silent"});
    loop.advance(1s);
    feed.publish(full());
    feed.publish(Everything{});
    hall.set_rate(60_Hz);
    loop.advance(1s);
    loop.close();
  }
}

std::vector<std::string> list(const sqlite::Database& database, const std::string& query) {
  std::vector<std::string> found;
  auto statement = database.prepare(query);
  while (statement.step()) found.emplace_back(statement.text(0));
  return found;
}

/// Of all that is in it, free of order.
std::uint64_t content(const sqlite::Database& database, const std::vector<std::string>& tables) {
  sqlite::RowHash hash;
  std::uint64_t sum = 0;
  for (const std::string& table : tables) {
    auto rows = database.prepare("SELECT '" + table + "', * FROM " + sqlite::quoted(table));
    const int columns = sqlite3_column_count(rows.raw());
    while (rows.step()) sum += sqlite::hash_of(hash, rows.raw(), 0, columns);
  }
  return sum;
}

/// A change at random. Empty: it would break a rule of the table.
class Mutation {
 public:
  Mutation(sqlite::Database& database, const std::vector<std::string>& tables, unsigned long seed)
      : database_(database), random_(seed) {
    // Each table alike, so that the small ones have their turn.
    table_ = tables[below(tables.size())];
    columns_ = sqlite::columns_of(database, table_);
    column_ = columns_[below(columns_.size())];
    keys_ = list(database, "SELECT name FROM pragma_table_info('" + table_ + "') WHERE pk > 0 ORDER BY pk");
    if (keys_.empty()) keys_ = {"rowid"};
  }

  /// What it did, or nothing.
  std::string make() {
    const std::string table = sqlite::quoted(table_), column = sqlite::quoted(column_);
    const std::string here = row(), there = row();
    if (here.empty()) return "";
    switch (below(9)) {
      case 0:
        return run("DELETE FROM " + table + " WHERE " + here);
      case 1:
        return duplicate(here);
      case 2:
        return run("UPDATE " + table + " SET " + column + " = " + column + " + 1 WHERE " + here);
      case 3:
        return run("UPDATE " + table + " SET " + column + " = " + column + " * 2 WHERE " + here);
      case 4:
        return run("UPDATE " + table + " SET " + column + " = " + column + " || 'x' WHERE " + here);
      case 5:
        return run("UPDATE " + table + " SET " + column + " = (SELECT " + column + " FROM " + table + " WHERE " +
                   there + ") WHERE " + here);
      case 6:
        return swap(here, there);
      case 7:  // of many rows
        return run("UPDATE " + table + " SET " + column + " = " + column + " + " +
                   std::to_string(1 + below(1'000'000'000)) + " WHERE " + (below(2) == 0 ? "1" : "rowid % 3 = 1"));
      default:
        return run("UPDATE " + table + " SET " + column + " = NULL WHERE " + here);
    }
  }

 private:
  std::size_t below(std::size_t n) { return static_cast<std::size_t>(random_() % n); }

  /// One row, in SQL.
  std::string row() {
    std::string condition;
    for (const std::string& key : keys_) {
      condition += (condition.empty() ? "'" : " || ' AND ") + sqlite::quoted(key) + " = ' || quote(" +
                   sqlite::quoted(key) + ")";
    }
    const auto rows = list(database_, "SELECT " + condition + " FROM " + sqlite::quoted(table_));
    return rows.empty() ? "" : rows[below(rows.size())];
  }
  std::string duplicate(const std::string& here) {
    std::string names;
    for (const std::string& column : columns_) names += (names.empty() ? "" : ", ") + sqlite::quoted(column);
    return run("INSERT INTO " + sqlite::quoted(table_) + "(" + names + ") SELECT " + names + " FROM " +
               sqlite::quoted(table_) + " WHERE " + here);
  }
  std::string swap(const std::string& here, const std::string& there) {
    const std::string table = sqlite::quoted(table_), column = sqlite::quoted(column_);
    return run("CREATE TEMP TABLE kept AS SELECT " + column + " AS v FROM " + table + " WHERE " + here + "; UPDATE " +
               table + " SET " + column + " = (SELECT " + column + " FROM " + table + " WHERE " + there + ") WHERE " +
               here + "; UPDATE " + table + " SET " + column + " = (SELECT v FROM kept) WHERE " + there);
  }
  std::string run(const std::string& statements) try {
    database_.execute(statements);
    return statements;
  } catch (const SetupError&) {
    return "";
  }

  sqlite::Database& database_;
  std::mt19937_64 random_;
  std::string table_, column_;
  std::vector<std::string> columns_, keys_;
};

std::string seen_as(const std::string& path) {
  auto recording = Recording::open(path);
  if (!recording) return std::string(recording.error().id());
  auto report = verify(*recording);
  if (!report) return std::string(report.error().id());
  return report->exit_code() == 0 ? "" : problems_of(*report);
}

/// A copy of the recording, changed so, is not what it says; `make` makes the change.
void check_seen(const std::string& path, const std::string& changed, const std::string& change,
                void (*make)(const std::string& path, const std::string& statements)) {
  CAPTURE(change);
  std::filesystem::copy_file(path, changed, std::filesystem::copy_options::overwrite_existing);
  make(changed, change);
  CHECK(!seen_as(changed).empty());
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("US-26 whatever is changed in a recording, verify sees it") {
    const char* const wanted = std::getenv("RTDATA_MUTATION_SEEDS");  // "FIRST COUNT", to look for more
    char* rest = nullptr;
    const unsigned long first = wanted != nullptr ? std::strtoul(wanted, &rest, 10) : 1;
    const unsigned long count = wanted != nullptr ? std::strtoul(rest, nullptr, 10) : 100;
    const Folder folder;
    const std::string path = folder / "run.db", changed = folder / "changed.db";
    record(path);
    check_balanced(path);
    std::vector<std::string> tables;
    std::uint64_t before = 0;
    {
      auto database = sqlite::Database::open(path, sqlite::Database::Mode::read);
      tables = list(database, "SELECT name FROM sqlite_schema WHERE type = 'table' ORDER BY name");
      before = content(database, tables);
    }
    CHECK(tables.size() >= 12);
    for (unsigned long seed = first; seed < first + count; ++seed) {
      CAPTURE(seed);
      std::filesystem::copy_file(path, changed, std::filesystem::copy_options::overwrite_existing);
      std::string change;
      {
        auto database = sqlite::Database::open(changed, sqlite::Database::Mode::write);
        database.execute("PRAGMA synchronous = OFF");
        for (unsigned long again = 0; again < 50 && change.empty(); ++again) {
          change = Mutation(database, tables, seed * 1000 + again).make();
          if (content(database, tables) == before) change.clear();
        }
      }
      REQUIRE(!change.empty());
      CAPTURE(change);
      CHECK(!seen_as(changed).empty());
    }
  }

  TEST_CASE("US-26 whatever is changed in what a recording keeps of its senders, verify sees it") {
    const Folder folder;
    const std::string path = folder / "run.db", changed = folder / "changed.db";
    {  // the peer is away until a limit has deleted rows, then it refuses more than are remembered
      bool is_away = true;
      const auto peer = std::make_shared<sinks::ScriptedPeer::Script>();
      peer->on_send = [&](const Parcel& parcel, Answer answer) {
        if (is_away) return answer.again({Errc::disconnected, "cannot send", "peer", "it is away", ""});
        for (std::size_t i = 0; i < parcel.rows().size(); ++i)
          answer.refuse(i, {Errc::bad_data, "refused", "peer", "it takes none", ""});
        answer.acknowledge();
      };
      Loop loop{Loop::Manual{}};
      loop.on_error([](const ErrorReport&) {});
      loop.runtime().on_log([](const LogRecord&) {});
      SqliteSink recording(loop, {.path = path, .max_bytes = 4 << 20, .max_age = 5s, .sink = {.name = "recording"}});
      Sink sink(loop, {.name = "peer", .retry_longest = 1s, .through = "recording"},
                std::make_unique<sinks::ScriptedPeer>(peer));
      for (int i = 0; i < 20; ++i) {
        const auto topic = loop.topic<Climate>(i % 3 == 0 ? "b" : "a");
        for (int n = 0; n < 500; ++n) topic.publish({1.0 * n, 40});
        loop.advance(1s);
        is_away = i < 10;
      }
      CHECK(loop.close(5s) == 0);
    }
    check_balanced(path);
    const std::vector<std::string> tables(sqlite::sender_tables.begin(), sqlite::sender_tables.end());
    for (const std::string& table : tables) CHECK(number(path, "SELECT count(*) FROM " + table) > 0);
    for (unsigned long seed = 1; seed <= 60; ++seed) {
      CAPTURE(seed);
      std::filesystem::copy_file(path, changed, std::filesystem::copy_options::overwrite_existing);
      std::string change;
      {
        auto database = sqlite::Database::open(changed, sqlite::Database::Mode::write);
        const std::uint64_t before = content(database, tables);
        for (unsigned long again = 0; again < 50 && change.empty(); ++again) {
          change = Mutation(database, tables, seed * 1000 + again).make();
          if (content(database, tables) == before) change.clear();
        }
      }
      REQUIRE(!change.empty());
      CAPTURE(change);
      CHECK(seen_as(changed).find("the senders' rows") != std::string::npos);
    }
  }

  TEST_CASE("US-26 gaps, rows and schedule that do not fit each other are seen without any checksum") {
    const Folder folder;
    const std::string path = folder / "run.db";
    record(path);
    check_balanced(path);
    const std::string changed = folder / "changed.db";
    for (const std::string change : {
             "UPDATE rtdata_gap SET first = first + 400000000, last = last + 400000000 WHERE kind = 'missed'",
             "UPDATE rtdata_gap SET first = first - 200000000, last = last - 200000000 WHERE kind = 'missed'",
             "UPDATE rtdata_gap SET first = first + 3600000000000, last = last + 3600000000000",
             "UPDATE rtdata_gap SET first = first - 3600000000000, last = last - 3600000000000",
             "UPDATE rtdata_gap SET first = (SELECT min(first) FROM rtdata_gap g WHERE g.run = rtdata_gap.run), last = "
             "(SELECT min(last) FROM rtdata_gap g WHERE g.run = rtdata_gap.run), count = 2",
             "UPDATE rtdata_gap SET last = last + 10000000, count = count + 1 WHERE kind = 'failed';"
             "UPDATE rtdata_gap SET last = last - 10000000, count = count - 1 WHERE kind = 'missed';"
             "UPDATE rtdata_ledger SET failed = failed + 1, missed = missed - 1 WHERE origin = 'room'",
             "UPDATE rtdata_gap SET last = last + 50000000 WHERE kind = 'missed'",
             "UPDATE climate SET time = (SELECT started FROM rtdata_run r WHERE r.run = climate.run) + sequence * 1000",
             "UPDATE climate SET time = time - 100000000 WHERE sequence > 80 AND origin = 'hall'",
             "UPDATE climate SET time = time - 15000000 WHERE sequence = 40 AND origin = 'room'",
             "UPDATE climate SET time = time + 25000000 WHERE sequence > 150 AND origin = 'room'",
             "UPDATE rtdata_gap SET first = first + 10000000, last = last + 10000000 WHERE kind = 'missed' AND run = 1",
             "UPDATE rtdata_gap SET first = first - 10000000, last = last - 10000000 WHERE kind = 'missed' AND run = 1",
             "UPDATE rtdata_ledger SET late = late + 1 WHERE origin = 'room' AND run = 1",
             "UPDATE rtdata_ledger SET lateness = lateness + 1 WHERE origin = 'hall'",
             "UPDATE rtdata_schedule SET late_after = 1000000000 WHERE origin = 'room' AND run = 1",
             "UPDATE climate SET time = time + 1000 WHERE origin = 'hall' AND sequence = 70",
             // A tick in two gaps of different kinds, and another one in none.
             "UPDATE rtdata_gap SET first = first + 10000000, last = last + 10000000 WHERE kind = 'failed';"
             "UPDATE rtdata_gap SET first = (SELECT last FROM rtdata_gap g WHERE g.run = rtdata_gap.run AND g.kind = "
             "'failed'), last = last - first + (SELECT last FROM rtdata_gap g WHERE g.run = rtdata_gap.run AND g.kind "
             "= "
             "'failed') WHERE kind = 'missed'",
             "UPDATE rtdata_schedule SET first_due = first_due + 3600000000000, end = end + 3600000000000",
             "UPDATE rtdata_schedule SET first_due = first_due + 100000000, end = end + 100000000",
             "UPDATE rtdata_schedule SET period = period / 2, end = first_due + (end - first_due) / 2",
         }) {
      check_seen(path, changed, change, written_as);
    }
  }

  TEST_CASE("US-26 only the checksums see what nothing else says again") {
    const Folder folder;
    const std::string path = folder / "run.db";
    record(path);
    const std::string changed = folder / "changed.db";
    for (const std::string change : {
             "UPDATE rtdata_ledger SET lost = 3 WHERE origin = 'feed'",
             "UPDATE rtdata_gap SET reason = 'nothing'",
             "DELETE FROM rtdata_clock",
             "DELETE FROM rtdata_ledger WHERE origin = 'silent'",
             "UPDATE rtdata_run SET state = 'sealed', lost = 0",
             "UPDATE rtdata_run SET state = 'recording'",
             "DELETE FROM rtdata_error",
             "UPDATE climate SET temperature = 1",
         }) {
      check_seen(path, changed, change, sql);
    }
  }

  TEST_CASE("US-26 what says that a recording is of something else is seen") {
    const Folder folder;
    const std::string path = folder / "run.db";
    record(path);
    check_balanced(path);
    const std::string changed = folder / "changed.db";
    for (const std::string change : {
             "UPDATE rtdata_run SET format = 2",
             "PRAGMA user_version = 0",
             "PRAGMA application_id = 0x52544441",
             // Of another type, which reads alike.
             "UPDATE climate SET origin = CAST(origin AS BLOB) WHERE sequence % 2",
             "UPDATE climate SET origin = CAST(origin AS BLOB)",
             "UPDATE climate SET \"checksum~\" = CAST(\"checksum~\" AS BLOB)",
             "UPDATE rtdata_checksum SET sum = CAST(sum AS BLOB)",
             "UPDATE rtdata_run SET \"checksum~\" = CAST(\"checksum~\" AS BLOB)",
             // A whole transaction, its checksum with it: the last, one in the middle, one twice, one of another run.
             "DELETE FROM climate WHERE rowid > (SELECT rowid FROM climate WHERE \"checksum~\" IS NOT NULL ORDER BY "
             "rowid DESC LIMIT 1 OFFSET 1)",
             "DELETE FROM climate WHERE rowid <= (SELECT min(rowid) FROM climate WHERE \"checksum~\" IS NOT NULL)",
             "INSERT INTO climate SELECT * FROM climate WHERE rowid > (SELECT rowid FROM climate WHERE \"checksum~\" "
             "IS "
             "NOT NULL ORDER BY rowid DESC LIMIT 1 OFFSET 1)",
             "UPDATE climate SET run = 2 WHERE run = 1",
             // What came after the rows.
             "ALTER TABLE climate ADD COLUMN pressure REAL; UPDATE climate SET pressure = 1 WHERE sequence = 7",
             // What is beside the tables.
             "DROP VIEW \"climate~utc\"",
             "DROP VIEW rtdata_run_utc",
             "DROP VIEW rtdata_field",
             // Views that say something else.
             "DROP VIEW \"climate~utc\"; CREATE VIEW \"climate~utc\" AS SELECT run, time, origin, sequence, '' AS utc, "
             "time AS utc_ns, temperature, humidity FROM climate",
             "DROP VIEW rtdata_run_utc; CREATE VIEW rtdata_run_utc AS SELECT run, name, host, state, '' AS started, '' "
             "AS "
             "ended, started AS started_ns, ended AS ended_ns FROM rtdata_run",
             "DROP VIEW \"rtdata_gap~utc\"; CREATE VIEW \"rtdata_gap~utc\" AS SELECT *, first AS first_utc_ns, last AS "
             "last_utc_ns, '' AS first_utc, '' AS last_utc FROM rtdata_gap",
             "DROP VIEW rtdata_field; CREATE VIEW rtdata_field AS SELECT topic, version, table_name, 1 AS number, 'x' "
             "AS "
             "field, 'f64' AS type, 'V' AS unit, 0 AS optional FROM rtdata_topic",
             "PRAGMA writable_schema = ON; UPDATE sqlite_schema SET sql = replace(sql, 'humidity', 'temperature') "
             "WHERE "
             "name = 'climate~utc'",
             "CREATE TRIGGER t AFTER INSERT ON rtdata_gap BEGIN DELETE FROM rtdata_gap; END",
         }) {
      check_seen(path, changed, change, sql);
    }
    // What users add for themselves is none of this.
    std::filesystem::copy_file(path, changed, std::filesystem::copy_options::overwrite_existing);
    sql(changed,
        "CREATE INDEX i ON climate(time); CREATE VIEW mine AS SELECT * FROM climate; CREATE TABLE notes(text)");
    check_balanced(changed);
  }
}
