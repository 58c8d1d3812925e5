// What a recording takes on the disk, and what recording writes onto it.
#include <doctest/doctest.h>
#include <sqlite3.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <string>
#include <vector>

#include "recording/prune.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/system.hpp"
#include "sinks/killed.hpp"
#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using namespace recordings;
using sinks::fork_without_threads;
using sqlite::Database;

namespace {

struct Wide {
  text<2000> value;
  friend constexpr auto describe(type_tag<Wide>) { return record("wide", field("value", &Wide::value)); }
};
struct Number {
  double value = 0;
  friend constexpr auto describe(type_tag<Number>) { return record("number", field("value", &Number::value, "1")); }
};

/// Bytes that this process has passed to write and its kin.
std::uint64_t bytes_written() {
  std::FILE* file = std::fopen("/proc/self/io", "r");
  REQUIRE(file != nullptr);
  unsigned long long bytes = 0;
  char line[128];
  while (std::fgets(line, sizeof line, file) != nullptr) {
    if (std::sscanf(line, "wchar: %llu", &bytes) == 1) break;
  }
  std::fclose(file);
  return bytes;
}

std::uint64_t written_by(const SqliteConfig& config, unsigned topics, std::chrono::seconds time) {
  const std::uint64_t before = bytes_written();
  Loop loop{Loop::Manual{}};
  SqliteSink sink(loop, config);
  std::vector<Sensor<Number>> sensors;
  for (unsigned i = 0; i < topics; ++i) {
    const std::string name = "sensor" + std::to_string(i);
    sensors.emplace_back(loop, SensorConfig{.name = name, .topic = "topic/" + name, .rate = 1_Hz},
                         [] { return Number{1}; });
  }
  loop.advance(time);
  loop.close();
  return bytes_written() - before;
}

std::uint64_t size_of(const std::string& path) {
  std::uint64_t total = 0;
  for (const char* part : {"", "-wal", "-shm"}) {
    struct stat status {};
    if (::stat((path + part).c_str(), &status) == 0) total += static_cast<std::uint64_t>(status.st_size);
  }
  return total;
}

/// All rows that were stored and not pruned are there.
void check_counts(const std::string& path) {
  std::int64_t rows = 0;
  auto database = Database::open(path, Database::Mode::read);
  auto tables = database.prepare("SELECT table_name FROM rtdata_topic");
  while (tables.step()) {
    rows += database.integer("SELECT count(*) FROM " + sqlite::quoted(tables.text(0)));
  }
  CHECK(number(path, "SELECT sum(stored - pruned) FROM rtdata_ledger") == rows);
  check_balanced(path);
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("NFR-5 a row a second writes its page and little more, and with the profile card a fifth of that") {
    Folder folder;
    constexpr std::uint64_t page = 4096 + 24;  // with its header in the log
    constexpr std::uint64_t set_up = 400'000;  // tables, views, the first and the last account
    for (const unsigned topics : {1U, 10U}) {
      CAPTURE(topics);
      const std::string name = std::to_string(topics);
      const std::uint64_t normal = written_by({.path = folder / ("normal" + name)}, topics, 3600s);
      CHECK(normal < set_up + 3600 * page * topics * 115 / 100);
      const std::uint64_t card = written_by({.path = folder / ("card" + name), .profile = SqliteProfile::card}, topics,
                                            3600s);
      CHECK(card < normal / 10);
      for (const char* profile : {"normal", "card"}) {
        CHECK(number(folder / (profile + name), "SELECT sum(stored) FROM rtdata_ledger") == 3601 * topics);
        check_balanced(folder / (profile + name));
      }
    }
  }

  TEST_CASE("NFR-5 a transaction holds what came within batch_time, however many rows that are") {
    Folder folder;
    const std::string path = folder / "run.db";
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path, .sink = {.batch_rows = 10}});
    Sensor<Number> sensor(loop, {.name = "fast", .topic = "a", .rate = 1_kHz}, [] { return Number{1}; });
    loop.advance(1500ms);
    CHECK(number(path, "SELECT count(*) FROM a") == 1000);
    loop.advance(499ms);
    CHECK(number(path, "SELECT count(*) FROM a") == 1000);
    loop.advance(1ms);
    CHECK(number(path, "SELECT count(*) FROM a") == 2000);
    loop.close();
    check_balanced(path);
  }

  TEST_CASE("NFR-1 an account that is old is brought up to date by what survives a kill") {
    for (const auto profile : {SqliteProfile::normal, SqliteProfile::card, SqliteProfile::fast}) {
      CAPTURE(static_cast<int>(profile));
      Folder folder;
      const std::string path = folder / "run.db";
      const pid_t child = fork_without_threads();
      if (child == 0) {
        Loop loop{Loop::Manual{}};
        SqliteSink sink(loop, {.path = path, .profile = profile});
        Sensor<Number> sensor(loop, {.name = "slow", .topic = "a", .rate = 1_Hz}, [] { return Number{1}; });
        loop.advance(95'500ms);
        ::raise(SIGKILL);
      }
      int status = 0;
      REQUIRE(::waitpid(child, &status, 0) == child);
      REQUIRE(WIFSIGNALED(status));
      const std::int64_t stored = number(path, "SELECT count(*) FROM a");
      CHECK(stored >= 96 - (profile == SqliteProfile::card ? 10 : 1));
      {
        Loop loop{Loop::Manual{}};
        SqliteSink sink(loop, {.path = path, .profile = profile});
        loop.close();
      }
      CHECK(number(path, "SELECT offered FROM rtdata_ledger WHERE run = 1") == 96);
      CHECK(number(path, "SELECT stored FROM rtdata_ledger WHERE run = 1") == stored);
      CHECK(number(path, "SELECT lost FROM rtdata_run WHERE run = 1") == 96 - stored);
      CHECK(verified(path).verdict() == Verdict::sealed);
    }
  }

  TEST_CASE("US-26 the recording as a whole stays below max_bytes at every rate, and what is pruned is counted") {
    constexpr std::uint64_t max_bytes = SqliteConfig::least_max_bytes;
    for (const unsigned per_ms : {1U, 20U, 100U}) {
      CAPTURE(per_ms);
      Folder folder;
      const std::string path = folder / "run.db";
      std::uint64_t largest = 0;
      {
        Loop loop{Loop::Manual{}};
        SqliteSink sink(loop, {.path = path, .max_bytes = max_bytes});
        Feed<Number> feed(loop, {.name = "feed", .topic = "a"});
        Ticker ticker(loop, 1ms, [&](const Tick&) {
          for (unsigned i = 0; i < per_ms; ++i) feed.publish({1});
          largest = std::max(largest, size_of(path));
        });
        loop.advance(std::chrono::milliseconds{400'000 / per_ms});
        CHECK(sink.counts().all_dropped() == 0);
        ticker.close();
        feed.close();
        loop.close();
      }
      CHECK(largest < max_bytes * 11 / 10);
      CHECK(largest > max_bytes * 7 / 10);  // and the room is used
      CHECK(number(path, "SELECT pruned FROM rtdata_ledger") > 100'000);
      check_counts(path);
    }
  }

  TEST_CASE("US-26 a recording at its limit that is killed is sealed, and stays so when its rows are pruned") {
    Folder folder;
    const std::string path = folder / "run.db";
    const auto run = [&](bool is_killed) {
      Loop loop{Loop::Manual{}};
      loop.runtime().on_log([](const LogRecord&) {});
      SqliteSink sink(loop, {.path = path, .max_bytes = SqliteConfig::least_max_bytes});
      Feed<Number> feed(loop, {.name = "feed", .topic = "a"});
      Ticker ticker(loop, 1ms, [&](const Tick& tick) {
        for (int i = 0; i < 100; ++i) feed.publish({1});
        feed.set_numbered();
        if (tick.index % 100 == 0) feed.lost(1);
      });
      loop.advance(2500ms);
      if (is_killed) ::raise(SIGKILL);
      ticker.close();
      feed.close();
      loop.close();
    };
    for (int i = 0; i < 2; ++i) {
      CAPTURE(i);
      sinks::killed_in([&] { run(true); });
      sinks::killed_in([&] {  // sealed, and pruned by what seals it
        run(false);
        ::raise(SIGKILL);
      });
      const VerifyReport report = verified(path);
      INFO(problems_of(report));
      CHECK(report.exit_code() == 0);
    }
    CHECK(number(path, "SELECT count(*) FROM rtdata_run WHERE state = 'sealed'") > 0);
    CHECK(number(path, "SELECT sum(pruned) FROM rtdata_ledger") > 100'000);
  }

  TEST_CASE("US-26 of a killed run, rows that a limit deleted before the first account are counted") {
    for (const int kill_after : {50, 300, 700, 950}) {
      CAPTURE(kill_after);
      const Folder folder;
      const std::string path = folder / "run.db";
      sinks::killed_in([&] {
        Loop loop{Loop::Manual{}};
        loop.runtime().on_log([](const LogRecord&) {});
        SqliteSink sink(loop, {.path = path, .max_bytes = SqliteConfig::least_max_bytes, .sink = {.batch_time = 10ms}});
        Feed<Wide> feed(loop, {.name = "feed", .topic = "a"});
        Feed<Wide> other(loop, {.name = "other", .topic = "a"});
        for (int ms = 1; ms <= kill_after; ++ms) {
          for (int i = 0; i < 5; ++i) feed.publish({std::string(1900, 'x')});
          if (ms % 10 == 5) other.publish({"y"});
          loop.advance(1ms);
        }
        ::raise(SIGKILL);
      });
      start_again(path);
      const VerifyReport report = verified(path);
      INFO(problems_of(report));
      CHECK(report.exit_code() == 0);
      const std::string
          of = " FROM rtdata_ledger WHERE run = (SELECT max(run) - 1 FROM rtdata_run) AND origin = 'feed'";
      CHECK(number(path, "SELECT offered" + of) == 5 * kill_after);
      CHECK(number(path, "SELECT first_sequence" + of) == 1);
      CHECK(number(path, "SELECT offered - stored" + of) == number(path, "SELECT dropped_unsaved" + of));
      CHECK(number(path, "SELECT offered - stored" + of) <= 100);
      CHECK((number(path, "SELECT pruned" + of) > 0) == (kill_after >= 700));
    }
  }

  TEST_CASE("US-26 after a pause no more rows go than the limit needs, and nobody is blamed") {
    const Folder folder;
    const std::string path = folder / "run.db";
    std::uint64_t largest = 0;
    const auto run = [&](Duration before, int rows) {
      Loop loop{Loop::Manual{}};
      std::vector<std::string> errors;
      loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
      loop.runtime().on_log([](const LogRecord&) {});
      loop.advance(before);
      SqliteSink sink(loop, {.path = path, .max_bytes = SqliteConfig::least_max_bytes, .sink = {.batch_time = 100ms}});
      for (int i = 0; i < rows; ++i) {
        loop.topic<Wide>(i % 3 != 0 ? "a" : "b").publish({std::string(300, 'x')});
        if (i % 20 == 0) loop.advance(10ms);
        largest = std::max(largest, size_of(path));
      }
      loop.close();
      CHECK(errors == std::vector<std::string>{});
    };
    run(0s, 30'000);
    const auto rows = [&] { return number(path, "SELECT (SELECT count(*) FROM a) + (SELECT count(*) FROM b)"); };
    const std::int64_t before = rows();
    CHECK(before > 5000);
    for (int i = 0; i < 3; ++i) run(1h * (i + 1), 200);
    CHECK(rows() > before / 10 * 9);
    CHECK(largest < SqliteConfig::least_max_bytes * 11 / 10);
    CHECK(verified(path).exit_code() == 0);
  }

  TEST_CASE("US-26 a fast sensor does not take the room of a slow one: both are kept for the same time") {
    Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path, .max_bytes = SqliteConfig::least_max_bytes});
      Sensor<Number> fast(loop, {.name = "fast", .topic = "fast", .rate = 5_kHz}, [] { return Number{1}; });
      Sensor<Number> slow(loop, {.name = "slow", .topic = "slow", .rate = 1_Hz}, [] { return Number{1}; });
      loop.advance(60s);
      loop.close();
    }
    const std::int64_t first_fast = number(path, "SELECT min(time) FROM fast");
    const std::int64_t first_slow = number(path, "SELECT min(time) FROM slow");
    CHECK(std::abs(first_fast - first_slow) <= 1'500'000'000);
    CHECK(number(path, "SELECT count(*) FROM slow") > 10);
    check_counts(path);
  }

  TEST_CASE("US-26 a program that starts again and again keeps its recording below max_bytes, and its data") {
    constexpr std::uint64_t max_bytes = SqliteConfig::least_max_bytes;
    constexpr int starts = 150;
    for (const bool has_rows : {false, true}) {
      CAPTURE(has_rows);
      const Folder folder;
      const std::string path = folder / "run.db";
      std::uint64_t largest = 0;
      const auto run = [&](int events, bool is_killed) {
        Runtime runtime({.configuration = std::string(30'000, 'c')});
        runtime.on_log([](const LogRecord&) {});
        Loop loop(runtime, {});
        SqliteSink sink(loop, {.path = path, .profile = SqliteProfile::fast, .max_bytes = max_bytes});
        Feed<Number> feed(loop, {.name = "feed", .topic = "a"});
        for (int i = 0; i < events; ++i) feed.publish({1});
        feed.set_numbered();
        feed.lost(1);
        largest = std::max(largest, size_of(path));
        if (is_killed) ::raise(SIGKILL);
        feed.close();
        loop.close();
        largest = std::max(largest, size_of(path));
      };
      run(1000, false);
      for (int i = 0; i < starts; ++i) {
        if (i % 10 == 5) {
          const pid_t child = fork_without_threads();
          if (child == 0) run(has_rows ? 3 : 0, true);
          int status = 0;
          REQUIRE(::waitpid(child, &status, 0) == child);
          REQUIRE(WTERMSIG(status) == SIGKILL);
        } else {
          run(has_rows ? 3 : 0, false);
        }
      }
      CHECK(largest < max_bytes * 11 / 10);
      const VerifyReport report = verified(path);
      INFO(problems_of(report));
      CHECK(report.exit_code() == 0);
      const std::int64_t runs = number(path, "SELECT count(*) FROM rtdata_run");
      CHECK(runs >= 16);
      CHECK(runs < starts);
      // No run is gone without being counted, nor what it lost.
      CHECK(number(path, "SELECT runs FROM rtdata_deleted WHERE topic = ''") == starts + 1 - runs);
      REQUIRE(report.deleted);
      CHECK(report.deleted->runs.runs == static_cast<std::uint64_t>(starts + 1 - runs));
      std::uint64_t lost = 0;
      for (const RunReport& one : report.runs)
        for (const TopicLoss& loss : one.losses) lost += loss.by_source;
      for (const TopicLoss& loss : report.deleted->losses) lost += loss.by_source;
      CHECK(lost == 1 + starts * 9 / 10);  // of those that were killed, no account was written
      const std::int64_t offered = number(path,
                                          "SELECT coalesce((SELECT sum(offered) FROM rtdata_deleted), 0) + "
                                          "(SELECT sum(offered) FROM rtdata_ledger)");
      if (has_rows) {
        CHECK(offered == 1000 + starts * 9 / 10 * 3);  // none of those that were killed had committed a name
      } else {
        CHECK(offered == 1000);
        CHECK(number(path, "SELECT count(*) FROM a WHERE run = 1") == 1000);  // the data is all there
      }
      sql(path, "UPDATE rtdata_deleted SET runs = runs - 1 WHERE topic = ''");  // as if one more were missing
      CHECK(
          problems_of(verified(path)).find("rtdata_deleted counts " + std::to_string(starts - runs) + " runs from ") !=
          std::string::npos);
    }
  }

  TEST_CASE("US-26 a device that fails for years takes no other's room with its gaps, errors and changes of health") {
    // Bad fails at every second tick, which is a gap a minute; right goes on at its rate. Once without, once with it.
    std::int64_t rows[2] = {};
    for (const bool has_bad : {false, true}) {
      CAPTURE(has_bad);
      const Folder folder;
      const std::string path = folder / "run.db";
      SensorCounts counts;
      {
        Loop loop{Loop::Manual{}};
        loop.on_error([](const ErrorReport&) {});
        loop.runtime().on_log([](const LogRecord&) {});
        SqliteSink sink(loop,
                        {.path = path, .max_bytes = SqliteConfig::least_max_bytes, .sink = {.batch_time = 10min}});
        Sensor<Number> right(loop, {.name = "right", .rate = Rate::from_period(10s)}, [] { return Number{1}; });
        Sensor<Number> bad;
        if (has_bad) {
          bad = Sensor<Number>(loop, {.name = "bad", .rate = Rate::from_period(30s), .faulted_after = 3},
                               [n = 0]() mutable -> Reading<Number> {
                                 if (++n % 2 == 0) return Error{Errc::io_failed, "no answer", "", "", ""};
                                 return Number{2};
                               });
        }
        loop.advance(24h * 14);
        if (has_bad) counts = bad.counts();
        loop.close();
        CHECK(loop.runtime().sinks().front().counts.all_dropped() == 0);
      }
      rows[has_bad ? 1 : 0] = number(path, "SELECT count(*) FROM \"right\"");
      check_counts(path);
      if (!has_bad) continue;
      CHECK(counts.failed > 20'000);
      CHECK(number(path, "SELECT sum(count) FROM rtdata_gap") == static_cast<std::int64_t>(counts.failed));
      CHECK(number(path, "SELECT sum(count) FROM rtdata_error WHERE object = 'sensor bad'") ==
            static_cast<std::int64_t>(counts.failed));
      CHECK(number(path, "SELECT sum(count) FROM rtdata_health WHERE name = 'bad'") ==
            2 * static_cast<std::int64_t>(counts.failed));
      CHECK(number(path, "SELECT count(*) FROM rtdata_gap") > 1000);
      std::int64_t bytes = 0;  // of what says so
      for (const char* of : {"rtdata_gap", "rtdata_error", "rtdata_health"})
        bytes += 100 * number(path, std::string("SELECT count(*) FROM ") + of);
      CHECK(bytes < static_cast<std::int64_t>(SqliteConfig::least_max_bytes / 5));
      // The newest ones stand for themselves.
      CHECK(
          number(path,
                 "SELECT count(*) FROM (SELECT count FROM rtdata_gap ORDER BY rowid DESC LIMIT 30) WHERE count = 1") ==
          30);
    }
    MESSAGE(rows[0], " rows without, ", rows[1], " with it");
    CHECK(rows[1] > rows[0] * 65 / 100);  // its data has a quarter of the rows
  }

  TEST_CASE("US-26 a device whose clock is ahead takes no other's room, and makes nobody's rows too old") {
    Folder folder;
    for (const bool is_by_age : {false, true}) {
      CAPTURE(is_by_age);
      const std::string path = folder / (is_by_age ? "age.db" : "size.db");
      {
        Loop loop{Loop::Manual{}};
        SqliteConfig config{.path = path};
        if (is_by_age) {
          config.max_age = 1h;
        } else {
          config.max_bytes = SqliteConfig::least_max_bytes;
        }
        SqliteSink sink(loop, config);
        Feed<Number> wrong(loop, {.name = "wrong", .topic = "wrong"});
        Feed<Number> right(loop, {.name = "right", .topic = "right"});
        Ticker ticker(loop, 1ms, [&](const Tick& tick) {
          for (int i = 0; i < 5; ++i) wrong.publish({1}, loop.time() + 24h * 365 * 50);
          if (tick.index % 2 == 0) right.publish({2});
        });
        loop.advance(is_by_age ? 5s : 40s);
        ticker.close();
        wrong.close();
        right.close();
        loop.close();
      }
      if (is_by_age) {
        CHECK(number(path, "SELECT sum(pruned) FROM rtdata_ledger") == 0);
      } else {
        CHECK(number(path, "SELECT count(*) FROM \"right\"") > 4000);
        CHECK(number(path, "SELECT count(*) FROM \"right\"") < 20'000);
      }
      check_counts(path);
    }
  }

  TEST_CASE("US-26 max_age holds at every rate") {
    for (const unsigned per_ms : {1U, 20U}) {
      CAPTURE(per_ms);
      Folder folder;
      const std::string path = folder / "run.db";
      {
        Loop loop{Loop::Manual{}};
        SqliteSink sink(loop, {.path = path, .max_age = 5s});
        Feed<Number> feed(loop, {.name = "feed", .topic = "a"});
        Feed<Number> rare(loop, {.name = "rare", .topic = "b"});
        Ticker ticker(loop, 1ms, [&](const Tick& tick) {
          for (unsigned i = 0; i < per_ms; ++i) feed.publish({1});
          if (tick.index % 1000 == 0) rare.publish({2});
        });
        loop.advance(20s);
        const std::int64_t age = number(path, "SELECT max(time) - min(time) FROM a");
        CHECK(age >= 5'000'000'000);
        CHECK(age <= 6'500'000'000);  // and a batch
        CHECK(number(path, "SELECT count(*) FROM b") <= 8);
        ticker.close();
        feed.close();
        rare.close();
        loop.close();
      }
      check_counts(path);
    }
  }

  TEST_CASE("US-26 a recording that is larger than its limit is brought below it") {
    Folder folder;
    const std::string path = folder / "run.db";
    const auto record = [&](std::uint64_t max_bytes, std::chrono::seconds time, unsigned per_ms) {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path, .max_bytes = max_bytes});
      Feed<Number> feed(loop, {.name = "feed", .topic = "a"});
      Ticker ticker(loop, 1ms, [&](const Tick&) {
        for (unsigned i = 0; i < per_ms; ++i) feed.publish({1});
      });
      loop.advance(time);
      ticker.close();
      feed.close();
      loop.close();
    };
    record(0, 20s, 20);
    REQUIRE(size_of(path) > 10'000'000);
    record(SqliteConfig::least_max_bytes, 10s, 1);
    CHECK(size_of(path) <= SqliteConfig::least_max_bytes);
    check_counts(path);
  }

  TEST_CASE("US-26 rows of a run whose clock was behind are not taken for the oldest") {
    Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      Feed<Number> feed(loop, {.name = "feed", .topic = "a"});
      Ticker ticker(loop, 1ms, [&](const Tick&) {
        for (unsigned i = 0; i < 10; ++i) feed.publish({1});
      });
      loop.advance(15s);
      ticker.close();
      feed.close();
      loop.close();
    }
    // As if the second half came from a run on a board whose clock began at 1970.
    sql(path, "UPDATE a SET time = time - 1700000000000000000 WHERE rowid > 75000");
    {
      auto database = Database::open(path, Database::Mode::write);
      sqlite::Pruner pruner(SqliteConfig::least_max_bytes, Duration{0});
      sqlite::AccountSums sums;
      sqlite::Positions positions;
      do {
        database.execute("BEGIN IMMEDIATE");
        pruner.make_room(database, sums, positions, from_nanoseconds(100'000'000'000));
        sums.write(database);
        database.execute("COMMIT");
      } while (pruner.has_more());
    }
    CHECK(number(path, "SELECT count(*) FROM a WHERE rowid > 75000") ==
          number(path, "SELECT max(rowid) - 75000 FROM a"));
    CHECK(number(path, "SELECT stored - pruned FROM rtdata_ledger") == number(path, "SELECT count(*) FROM a"));
    CHECK(number(path, "SELECT count(*) FROM a") > 75'000);
    CHECK(number(path, "SELECT pruned FROM rtdata_ledger") > 10'000);
  }

  TEST_CASE("US-26 a reader that holds a transaction open keeps a limit from being held: that is told and recorded") {
    constexpr std::uint64_t max_bytes = SqliteConfig::least_max_bytes;
    Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop{Loop::Manual{}};
      std::vector<std::string> warnings;
      loop.runtime().on_log([&](const LogRecord& record) {
        if (record.text.find("larger than `max_bytes`") != std::string::npos) warnings.emplace_back(record.text);
      });
      SqliteSink sink(loop, {.path = path, .max_bytes = max_bytes});
      Feed<Number> feed(loop, {.name = "feed", .topic = "a"});
      Ticker ticker(loop, 1ms, [&](const Tick&) {
        for (unsigned i = 0; i < 20; ++i) feed.publish({1});
      });
      loop.advance(3s);
      {
        auto reader = Database::open(path, Database::Mode::read);
        reader.execute("BEGIN");
        reader.integer("SELECT count(*) FROM a");
        loop.advance(10s);
        CHECK(size_of(path) > max_bytes * 11 / 10);
        REQUIRE(warnings.size() == 1);
        CHECK(warnings[0].find("holds a transaction open") != std::string::npos);
      }
      loop.advance(5s);
      CHECK(size_of(path) <= max_bytes);
      CHECK(warnings.size() == 1);
      CHECK(sink.counts().all_dropped() == 0);
      ticker.close();
      feed.close();
      loop.close();
    }
    CHECK(number(path, "SELECT count(*) FROM rtdata_error WHERE text LIKE '%larger than%'") == 1);
    check_counts(path);
  }

  TEST_CASE("US-26 the profile fast is not held up by a reader") {
    Folder folder;
    const std::string path = folder / "run.db";
    Loop loop{Loop::Manual{}};
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) { errors.emplace_back(report.error.text()); });
    SqliteSink sink(loop, {.path = path, .profile = SqliteProfile::fast});
    Feed<Number> feed(loop, {.name = "feed", .topic = "a"});
    feed.publish({1});
    loop.advance(1s);
    auto reader = Database::open(path, Database::Mode::read);
    reader.execute("BEGIN");
    CHECK(reader.integer("SELECT count(*) FROM a") == 1);
    feed.publish({2});
    loop.advance(1s);
    CHECK(errors.empty());
    CHECK(sink.counts().stored == 2);
    CHECK(reader.integer("SELECT count(*) FROM a") == 1);  // as it was when its transaction began
  }

  TEST_CASE("US-30 a limit that is too small is refused by check and by the constructor") {
    Folder folder;
    const auto plan = plan_system(
        standard_registry(),
        parse_config(R"({"sensors": [{"type": "host", "quantity": "cpu", "name": "cpu", "rate": "1 Hz"}], "sinks": [
        {"type": "sqlite", "path": "run.db", "max_bytes": 1000000, "profile": "card"}]})"));
    INFO(plan.report());
    REQUIRE(plan.problems.size() == 1);
    CHECK(plan.report().find("4 MiB") != std::string::npos);
    Loop loop{Loop::Manual{}};
    CHECK_THROWS_AS(SqliteSink(loop, {.path = folder / "run.db", .max_bytes = 1'000'000}), SetupError);
    CHECK_THROWS_AS(SqliteSink(loop, {.path = folder / "run.db", .max_age = -1s}), SetupError);
    CHECK(::access((folder / "run.db").c_str(), F_OK) != 0);
  }
}
