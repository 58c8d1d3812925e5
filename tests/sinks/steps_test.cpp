// The steps that a recording has beside its rows: they are what the rows say, whatever happens, and reading takes them.
#include "recording/step.hpp"

#include <sys/wait.h>

#include <csignal>
#include <limits>
#include <random>

#include "recordings.hpp"
#include "rtdata/data/value.hpp"
#include "sinks/killed.hpp"

using namespace recordings;
using namespace std::chrono_literals;
using sinks::fork_without_threads;

namespace {

struct Wider {
  double pressure = 1;
  double temperature = 2;
  double humidity = 3;
  friend constexpr auto describe(type_tag<Wider>) {
    return record("climate", field("pressure", &Wider::pressure, "hPa"),
                  field("temperature", &Wider::temperature, "Cel"), field("humidity", &Wider::humidity, "%RH"));
  }
};

/// Each number anywhere in its range, or NaN, infinite, absent.
Everything any(std::mt19937_64& random) {
  const auto real = [&]() -> double {
    switch (random() % 24) {
      case 0:
        return std::numeric_limits<double>::quiet_NaN();
      case 1:
        return -0.0;
      case 2:
        return static_cast<double>(random());
      default:
        return static_cast<double>(static_cast<std::int64_t>(random())) * 1e-16;
    }
  };
  Everything e;
  e.flag = random() % 2 == 0;
  e.letter = static_cast<char>(random());
  e.i8 = static_cast<std::int8_t>(random());
  e.i16 = static_cast<std::int16_t>(random());
  e.i32 = static_cast<std::int32_t>(random());
  e.i64 = static_cast<std::int64_t>(random());
  e.u8 = static_cast<std::uint8_t>(random());
  e.u16 = static_cast<std::uint16_t>(random());
  e.u32 = static_cast<std::uint32_t>(random());
  e.u64 = random();
  e.f32 = static_cast<float>(real());
  e.f64 = real();
  if (random() % 3 != 0) e.maybe = real();
  if (random() % 3 != 0) e.maybe_flag = random() % 2 == 0;
  for (float& one : e.numbers) one = static_cast<float>(real());
  if (random() % 5 == 0) e.maybes[1] = static_cast<std::uint32_t>(random());
  e.origin_point = {real(), static_cast<std::int8_t>(random())};
  if (random() % 2000 == 0) e.points[0].x = std::numeric_limits<double>::infinity();
  if (random() % 2000 == 0) e.points[0].x = -std::numeric_limits<double>::infinity();
  if (random() % 4000 == 0) e.points[1].x = -std::numeric_limits<double>::max();  // some make a sum that is none
  return e;
}

/// The same recording without any steps.
std::string without_steps(const Folder& folder, const std::string& path) {
  const std::string copy = folder / "rows.db";
  std::filesystem::copy_file(path, copy, std::filesystem::copy_options::overwrite_existing);
  for (const RecordedTopic& topic : Recording::open(path).or_throw().topics().or_throw())
    for (const sqlite::StepLength& length : sqlite::step_lengths)
      sql(copy, "DROP TABLE IF EXISTS " + sqlite::quoted(sqlite::step_table(topic.table, length)));
  written_as(copy, "UPDATE rtdata_ledger SET seconds_from = 0, minutes_from = 0");
  check_balanced(copy);
  return copy;
}

/// Steps that are read of the rows and of recorded steps are the same. Returns how many there are.
std::size_t check_same(const std::string& path, const std::string& of_rows, const RowFilter& filter, Duration step,
                       const std::vector<std::string>& fields = {}) {
  CAPTURE(step.count());
  auto steps = Recording::open(path).or_throw().steps(filter, step, fields).or_throw();
  auto wanted = Recording::open(of_rows).or_throw().steps(filter, step).or_throw();
  std::size_t count = 0, different = 0;
  for (;; ++count) {
    const RecordedRow* const row = steps.next().or_throw();
    const RecordedRow* const other = wanted.next().or_throw();
    REQUIRE((row == nullptr) == (other == nullptr));
    if (row == nullptr) break;
    CAPTURE(count);
    REQUIRE(row->header().time == other->header().time);
    REQUIRE(row->header().origin == other->header().origin);
    REQUIRE(row->run() == other->run());
    for (const Leaf& leaf : row->topic().description->leaves()) {
      const std::string of = leaf.path.substr(0, leaf.path.rfind('.'));
      const bool is_asked = fields.empty() || leaf.path == "events" ||
                            std::find(fields.begin(), fields.end(), of) != fields.end();
      if (!is_asked) {
        const Value none = leaf.path.ends_with(".count") ? Value{std::uint64_t{0}} : Value{};
        REQUIRE(row->event().value(leaf.path).or_throw() == none);
        continue;
      }
      const Value a = row->event().value(leaf.path).or_throw(), b = other->event().value(leaf.path).or_throw();
      bool is_same = a == b;
      // The mean of recorded steps is rounded differently.
      if (const double* x = std::get_if<double>(&a); x != nullptr && leaf.path.ends_with(".mean")) {
        const double* const y = std::get_if<double>(&b);
        const auto limit = [&](const char* which) {
          const std::string name = leaf.path.substr(0, leaf.path.size() - 4) + which;
          const Value value = other->event().value(name).or_throw();
          return std::visit(
              [](const auto& v) -> double {
                if constexpr (std::is_arithmetic_v<std::decay_t<decltype(v)>>) return std::abs(static_cast<double>(v));
                return 0;
              },
              value);
        };
        is_same = y != nullptr && ((std::isnan(*x) && std::isnan(*y)) || *x == *y ||
                                   std::abs(*x - *y) <= 1e-12 * std::max(limit("min"), limit("max")));
      }
      if (is_same) continue;
      ++different;
      CHECK_MESSAGE(is_same, leaf.path << ": " << to_string(a) << ", of rows " << to_string(b));
    }
    REQUIRE(different < 5);
  }
  return count;
}

std::int64_t count_of(const std::string& path, const std::string& table) {
  return number(path, "SELECT count(*) FROM " + sqlite::quoted(table));
}

bool has_table(const std::string& path, const std::string& table) {
  return number(path, "SELECT count(*) FROM sqlite_schema WHERE type = 'table' AND name = '" + table + "'") == 1;
}

/// Of how many seconds or minutes the rows are, by run and origin.
std::int64_t steps_of_rows(const std::string& path, const std::string& table, const std::string& nanoseconds) {
  return number(path, "SELECT count(*) FROM (SELECT DISTINCT run, origin, time / " + nanoseconds + " FROM " +
                          sqlite::quoted(table) + ")");
}

/// Two minutes of a fast topic with two origins, and of a slow one.
void record(const std::string& path, bool has_steps = true, Duration time = 130s) {
  Loop loop{Loop::Manual{}};
  loop.on_error([](const ErrorReport&) {});
  SqliteSink sink(loop, {.path = path, .steps = has_steps});
  int n = 0;
  Sensor<Climate> room(loop, {.name = "room", .topic = "climate", .rate = 100_Hz}, [&]() -> Reading<Climate> {
    if (++n % 1000 < 300) return Error{Errc::io_failed, "no answer", "", "", ""};
    return Climate{0.1 * n, 40.0 + n % 7};
  });
  Sensor<Climate> hall(loop, {.name = "hall", .topic = "climate", .rate = 40_Hz}, [&] { return Climate{-0.3 * n, 1}; });
  Sensor<Climate> slow(loop, {.name = "slow", .rate = 1_Hz}, [&] { return Climate{1.0 * n, 1}; });
  Sensor<Climate> rare(loop, {.name = "rare", .rate = Rate::from_period(20s)}, [&] { return Climate{1.0 * n, 1}; });
  loop.advance(time);
  loop.close();
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("FW-5 steps of seconds and minutes are recorded beside the rows, and are what the rows say") {
    const Folder folder;
    const std::string path = folder / "run.db";
    {
      std::mt19937_64 random(5);
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      Feed<Everything> a(loop, {.name = "a", .topic = "every/thing"}), b(loop, {.name = "b", .topic = "every/thing"});
      Ticker ticker(loop, 10ms, [&](const Tick& tick) {
        if (tick.index % 500 > 350) return;
        a.publish(any(random));
        if (tick.index % 3 == 0) b.publish(any(random));
      });
      loop.advance(200s);
      ticker.close();
      loop.close();
    }
    check_balanced(path);
    CHECK(count_of(path, "every/thing~1s") == steps_of_rows(path, "every/thing", "1000000000"));
    CHECK(count_of(path, "every/thing~1min") == steps_of_rows(path, "every/thing", "60000000000"));
    const std::string rows = without_steps(folder, path);
    const RowFilter all{.topic = "every/thing"}, of_a{.topic = "every/thing", .run = 1, .origin = "a"};
    CHECK(check_same(path, rows, all, 1s) == static_cast<std::size_t>(count_of(path, "every/thing~1s")));
    CHECK(check_same(path, rows, all, 1min) == static_cast<std::size_t>(count_of(path, "every/thing~1min")));
    CHECK(check_same(path, rows, of_a, 7s) > 20);
    CHECK(check_same(path, rows, of_a, 2min) >= 2);
    CHECK(check_same(path, rows, all, 1500ms) > 150);
    // From within a minute, and within a second.
    const Time first = Recording::open(path).or_throw().runs().or_throw().at(0).started;
    for (const Duration later : {Duration{61s}, Duration{61s + 1ns}, Duration{61'300ms}}) {
      const Time from = Time{std::chrono::floor<std::chrono::seconds>(first.time_since_epoch())} + later;
      CHECK(check_same(path, rows, {.topic = "every/thing", .from = from, .until = from + 60s}, 10s) >= 12);
      CHECK(check_same(path, rows, {.topic = "every/thing", .from = from}, 1min) >= 4);
    }
    CHECK(check_same(path, rows, {.topic = "every/thing", .every = 5}, 1s) > 200);
    CHECK(check_same(path, rows, all, 1s, {"u64", "maybe", "points[1].x"}) > 150);
    CHECK(check_same(path, rows, all, 1500ms, {"i8"}) > 150);
    CHECK(check_same(path, rows, all, 1min, {"none of them"}) > 5);
    CHECK(check_same(path, rows, {.topic = "every/thing", .times = RowFilter::Times::utc}, 1min) > 5);
  }

  TEST_CASE("FW-5 the columns of steps: of each number count, least, largest, sum and last; none of a text") {
    const Folder folder;
    const std::string path = folder / "run.db";
    constexpr double nan = std::numeric_limits<double>::quiet_NaN(), infinite = std::numeric_limits<double>::infinity();
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      Feed<Everything> feed(loop, {.name = "feed", .topic = "t"});
      Time time{1'800'000'000s};
      for (int i = 1; i <= 10; ++i) {
        Everything e;
        e.f64 = i == 10 ? nan : i;
        e.f32 = nan;
        e.i32 = -i;
        e.u64 = i == 4 ? ~std::uint64_t{0} : static_cast<std::uint64_t>(i);
        if (i % 2 == 0) e.maybe = i == 8 ? nan : 0.5 * i;
        e.numbers = {static_cast<float>(i == 5 ? infinite : 0), static_cast<float>(i == 5   ? infinite
                                                                                   : i == 6 ? -infinite
                                                                                            : 0)};
        feed.publish(e, time += 1ms);
      }
      feed.publish(Everything{}, Time{1'800'000'061s});
      loop.close();
    }
    check_balanced(path);
    const std::string first = " FROM \"t~1s\" WHERE time = 1800000000000000000 AND origin = 'feed' AND run = 1";
    const auto is = [&](const std::string& condition) {
      CAPTURE(condition);
      CHECK(number(path, "SELECT " + condition + first) == 1);
    };
    is("events = 10 AND first_sequence = 1 AND last_sequence = 10");
    is("\"f64.count\" = 9 AND \"f64.min\" = 1.0 AND \"f64.max\" = 9.0 AND \"f64.sum\" = 45.0 AND \"f64.last\" = 9.0");
    is("typeof(\"f64.min\") = 'real' AND typeof(\"f64.sum\") = 'real' AND typeof(\"i32.min\") = 'integer'");
    is("coalesce(\"f32.count\", \"f32.min\", \"f32.max\", \"f32.sum\", \"f32.last\") IS NULL");
    is("\"i32.count\" = 10 AND \"i32.min\" = -10 AND \"i32.max\" = -1 AND \"i32.sum\" = -55.0 AND \"i32.last\" = -10");
    is("\"u64.min\" = 1 AND \"u64.max\" = -1 AND \"u64.last\" = 10");
    is("\"maybe.count\" = 4 AND \"maybe.min\" = 1.0 AND \"maybe.max\" = 5.0 AND \"maybe.sum\" = 11.0");
    is("\"numbers[0].max\" = 9e999 AND \"numbers[0].sum\" = 9e999 AND \"numbers[0].min\" = 0.0");
    is("\"numbers[1].max\" = 9e999 AND \"numbers[1].min\" = -9e999 AND \"numbers[1].sum\" IS NULL");
    for (const char* none : {"name", "letter", "state", "maybe_name", "maybe_state", "names[0]"})
      CHECK(number(path, "SELECT count(*) FROM pragma_table_info('t~1s') WHERE name LIKE '" + std::string(none) +
                             ".%'") == 0);
    CHECK(number(path, "SELECT count(*) FROM \"t~1s\"") == 2);
    CHECK_FALSE(has_table(path, "t~1min"));  // of fewer than 480 events a minute
    CHECK(number(path, "SELECT seconds_from = 1 AND minutes_from = 0 FROM rtdata_ledger") == 1);
  }

  TEST_CASE("FW-5 what is slow has no steps that would be as many as its rows; a later burst begins them") {
    const Folder folder;
    const std::string path = folder / "run.db";
    record(path);
    check_balanced(path);
    CHECK(has_table(path, "climate~1s"));
    CHECK(has_table(path, "climate~1min"));
    CHECK_FALSE(has_table(path, "slow~1s"));
    CHECK_FALSE(has_table(path, "slow~1min"));
    CHECK_FALSE(has_table(path, "rare~1s"));
    CHECK_FALSE(has_table(path, "rare~1min"));
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      Feed<Climate> burst(loop, {.name = "burst", .topic = "climate"}),
          other(loop, {.name = "other", .topic = "climate"});
      int n = 0;
      Ticker ticker(loop, 2ms, [&](const Tick&) {
        ++n;
        const bool is_fast = n > 20'000 && n < 21'000;
        if (is_fast || n % 100 == 0) burst.publish({1.0 * n, 0});
        if (n % 100 == 0) other.publish({-1.0 * n, 0});
      });
      loop.advance(70s);
      ticker.close();
      loop.close();
    }
    check_balanced(path);
    const std::string of_burst = " FROM rtdata_ledger WHERE run = 2 AND origin = 'burst'";
    CHECK(number(path, "SELECT seconds_from" + of_burst) > 180);
    CHECK(number(path, "SELECT seconds_from" + of_burst) <= 200);
    CHECK(number(path, "SELECT minutes_from" + of_burst) == 1);
    CHECK(number(path, "SELECT seconds_from FROM rtdata_ledger WHERE run = 2 AND origin = 'other'") == 0);
    const std::string rows = without_steps(folder, path);
    CHECK(check_same(path, rows, {.topic = "climate"}, 1s) ==
          static_cast<std::size_t>(steps_of_rows(path, "climate", "1000000000")));
    CHECK(check_same(path, rows, {.topic = "climate", .origin = "burst"}, 4s) >= 17);
    CHECK(check_same(path, rows, {}, 1min) > 10);
  }

  TEST_CASE("FW-5 a run without steps, between runs with them, is read of its rows") {
    const Folder folder;
    const std::string path = folder / "run.db";
    record(path, false);
    CHECK_FALSE(has_table(path, "climate~1s"));
    CHECK(number(path, "SELECT max(seconds_from) + max(minutes_from) FROM rtdata_ledger") == 0);
    record(path);
    record(path, false, 20s);
    {  // with a field more
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      Sensor<Wider> room(loop, {.name = "room", .topic = "climate", .rate = 50_Hz}, [] { return Wider{}; });
      loop.advance(10s);
      loop.close();
    }
    record(path, true, 61s);
    check_balanced(path);
    CHECK(number(path, "SELECT sum(events) FROM \"climate~1s\" WHERE run IN (1, 3)") == 0);
    CHECK(number(path, "SELECT sum(\"pressure.sum\") FROM \"climate~1s\" WHERE run = 4") == 501);
    const std::string rows = without_steps(folder, path);
    for (const Duration step : {Duration{1s}, Duration{30s}, Duration{1min}})
      CHECK(check_same(path, rows, {.topic = "climate"}, step) > 8);
    CHECK(check_same(path, rows, {.topic = "climate", .run = 4}, 1s) == 11);
  }

  TEST_CASE("FW-5 a changed, missing or further step is told") {
    const Folder folder;
    const std::string path = folder / "run.db";
    record(path);
    check_balanced(path);
    const std::string changed = folder / "changed.db";
    const auto told = [&](const std::string& change) {
      CAPTURE(change);
      std::filesystem::copy_file(path, changed, std::filesystem::copy_options::overwrite_existing);
      written_as(changed, change);  // no other checksum tells of it
      const VerifyReport report = verified(changed);
      CHECK(report.exit_code() == 1);
      return problems_of(report);
    };
    const auto has = [](const std::string& text, const char* part) {
      CAPTURE(text);
      CHECK(text.find(part) != std::string::npos);
    };
    const std::string tenth =
        " WHERE time = (SELECT DISTINCT time FROM \"climate~1s\" ORDER BY time LIMIT 1 OFFSET 10)"
        " AND origin = 'hall'";
    const std::string last = " WHERE rowid = (SELECT max(rowid) FROM \"climate~1min\")";
    has(told("UPDATE \"climate~1s\" SET \"temperature.max\" = \"temperature.max\" + 1e-9" + tenth),
        "climate~1s: the step at ");
    has(told("UPDATE \"climate~1s\" SET \"temperature.max\" = \"temperature.max\" + 1e-9" + tenth),
        "origin hall, does not agree");
    for (const std::string& column :
         sqlite::columns_of(sqlite::Database::open(path, sqlite::Database::Mode::read), "climate~1min")) {
      if (column == "run" || column == "origin" || column == "time") continue;
      has(told("UPDATE \"climate~1min\" SET \"" + column + "\" = \"" + column + "\" + 1" + last),
          "does not agree with its rows");
    }
    has(told("UPDATE \"climate~1s\" SET time = time + 1" + tenth), "is not there");
    has(told("UPDATE \"climate~1s\" SET time = time + 1" + tenth), "is there, and none of its rows is");
    has(told("UPDATE \"climate~1s\" SET run = 2" + tenth), "is not there");
    has(told("UPDATE \"climate~1s\" SET run = 2" + tenth),
        "1 step of run 2, origin hall is there, and none of the rows is");
    has(told("UPDATE \"climate~1s\" SET origin = 'x'" + tenth), "1 step of run 1, origin x is there");
    has(told("DELETE FROM \"climate~1min\"" + last), "is not there");
    has(told("DELETE FROM \"climate~1min\""), "climate~1min: the step at");
    has(told("DROP TABLE \"climate~1min\""), "is not there");
    has(told("UPDATE rtdata_ledger SET minutes_from = 0 WHERE topic = 'climate'"),
        "is there, before the origin has steps");
    has(told("UPDATE rtdata_ledger SET minutes_from = 1 WHERE topic = 'rare'"), "rare~1min: the step at");
    has(told("ALTER TABLE \"climate~1s\" ADD COLUMN more"), "climate~1s: the table has other columns");
    has(told("ALTER TABLE \"climate~1s\" RENAME COLUMN \"humidity.min\" TO \"x\""), "has other columns");
    // Rows that were changed with their checksums do not agree with the steps.
    has(told("UPDATE climate SET humidity = 39 WHERE origin = 'hall' AND sequence = 100"), "climate~1s: the step at");
    has(told("UPDATE climate SET humidity = 39 WHERE origin = 'hall' AND sequence = 100"), "climate~1min: the step at");
  }

  TEST_CASE("FW-5 steps go with the rows that a limit deletes") {
    const Folder folder;
    const std::string path = folder / "run.db";
    SqliteConfig config{.path = path};
    SUBCASE("by age") { config.max_age = 20s; }
    SUBCASE("by age, which cuts minutes in two") { config.max_age = 90s; }
    SUBCASE("by size") { config.max_bytes = SqliteConfig::least_max_bytes; }
    for (int run = 0; run < 2; ++run) {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, config);
      Sensor<Climate> a(loop, {.name = "a", .topic = "t", .rate = 500_Hz}, [n = 0]() mutable {
        return Climate{0.1 * n++, 0};
      });
      Sensor<Climate> b(loop, {.name = "b", .topic = "t", .rate = 70_Hz}, [n = 0]() mutable {
        return Climate{0, 1.0 * n++};
      });
      loop.advance(run == 0 ? 200s : 125s);
      loop.close();
    }
    check_balanced(path);
    CHECK(number(path, "SELECT sum(pruned) FROM rtdata_ledger") > 0);
    CHECK(count_of(path, "t~1s") == steps_of_rows(path, "t", "1000000000"));
    CHECK(count_of(path, "t~1min") == steps_of_rows(path, "t", "60000000000"));
    // Also one whose first rows are gone.
    sql(path,
        "UPDATE \"t~1min\" SET \"temperature.min\" = -1 WHERE run = 2 AND origin = 'a' AND time = (SELECT "
        "min(time) FROM \"t~1min\" WHERE run = 2 AND origin = 'a')");
    CHECK(problems_of(verified(path)).find("t~1min: the step at") != std::string::npos);
  }

  TEST_CASE("FW-5 after a kill the steps are those of the rows that are there") {
    const Folder folder;
    const std::string path = folder / "run.db";
    const pid_t child = fork_without_threads();
    if (child == 0) {
      record(path, true, 2s);
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      Sensor<Climate> room(loop, {.name = "room", .topic = "climate", .rate = 100_Hz}, [n = 0]() mutable {
        return Climate{0.1 * n++, 0};
      });
      loop.advance(70'300ms);
      ::raise(SIGKILL);
    }
    int status = 0;
    REQUIRE(::waitpid(child, &status, 0) == child);
    REQUIRE(WIFSIGNALED(status));
    for (const bool is_sealed : {false, true}) {
      if (is_sealed) start_again(path);
      const VerifyReport report = verified(path);
      CHECK(problems_of(report) == "");
      CHECK(report.runs.at(1).rows > 6900);
      CHECK(count_of(path, "climate~1s") == steps_of_rows(path, "climate", "1000000000"));
      CHECK(number(path, "SELECT sum(events) FROM \"climate~1min\" WHERE run = 2") ==
            number(path, "SELECT count(*) FROM climate WHERE run = 2"));
    }
  }

  TEST_CASE("FW-5 a transaction that fails and comes again leaves the steps exact") {
    const Folder folder;
    const std::string path = folder / "run.db";
    std::size_t failures = 0;
    {
      Loop loop{Loop::Manual{}};
      loop.on_error([&](const ErrorReport&) { ++failures; });
      SqliteSink sink(loop, {.path = path, .sink = {.queue_bytes = 262144}});
      Sensor<Climate> room(loop, {.name = "room", .topic = "climate", .rate = 100_Hz}, [n = 0]() mutable {
        return Climate{0.1 * n++, 0};
      });
      for (int i = 0; i < 5; ++i) {
        loop.advance(3700ms);
        const std::string fails = i % 2 == 0 ? "climate" : "climate~1s";
        sql(path, "CREATE TRIGGER fails BEFORE INSERT ON \"" + fails + "\" BEGIN SELECT RAISE(ABORT, 'it fails'); END");
        loop.advance(i < 4 ? 5400ms : 70s);  // the last one costs rows, since the queue is full
        sql(path, "DROP TRIGGER fails");
      }
      loop.advance(70s);
      loop.close();
    }
    CHECK(failures > 0);
    check_balanced(path);
    CHECK(number(path, "SELECT dropped_newest + dropped_oldest FROM rtdata_ledger") > 0);
    CHECK(count_of(path, "climate~1s") == steps_of_rows(path, "climate", "1000000000"));
  }

  TEST_CASE("FW-5 something else of the name of a table of steps: no steps, and a warning") {
    const Folder folder;
    const std::string path = folder / "run.db";
    record(path, false, 1s);
    sql(path, "CREATE VIEW \"climate~1s\" AS SELECT 1");
    std::vector<std::string> told;
    {
      Loop loop{Loop::Manual{}};
      loop.on_error([&](const ErrorReport& report) { told.push_back(report.error.text()); });
      SqliteSink sink(loop, {.path = path});
      Sensor<Climate> room(loop, {.name = "room", .topic = "climate", .rate = 100_Hz}, [] { return Climate{}; });
      loop.advance(10s);
      loop.close();
    }
    REQUIRE(told.size() == 1);
    CHECK(told[0].find("cannot record steps of 1 s") != std::string::npos);
    check_balanced(path);
    CHECK(count_of(path, "climate~1min") > 0);
    CHECK(number(path, "SELECT seconds_from FROM rtdata_ledger WHERE run = 2") == 0);
  }
}
