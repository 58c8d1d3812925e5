// The checksums of values and accounts: what they are of, what leaves them alone, and what they show.
#include "recording/checksum.hpp"
#include "sinks/killed.hpp"

#include <sys/wait.h>

#include <csignal>
#include <cstdlib>
#include <filesystem>

#include "has.hpp"
#include "recordings.hpp"

using namespace recordings;
using namespace std::chrono_literals;
using rtdata::test::has;
using sinks::fork_without_threads;

namespace {

/// Climate, and a field before those that it has.
struct Wider {
  double pressure = 1;
  double temperature = 2;
  double humidity = 3;
  friend constexpr auto describe(type_tag<Wider>) {
    return record("climate", field("pressure", &Wider::pressure, "hPa"),
                  field("temperature", &Wider::temperature, "Cel"), field("humidity", &Wider::humidity, "%RH"));
  }
};

/// Every field, the awkward values too.
void publish_awkward(Feed<Everything>& feed) {
  Everything e = full();
  // Dumps of some versions of the shell turn 5e-324 into 0, or the largest number into infinity: other values.
  e.maybe = 1e-300;
  e.origin_point = {1.5e300, 1};
  feed.publish(e);
  e = Everything{};
  feed.publish(e);
  e.f64 = -0.0;
  e.f32 = -0.0f;
  feed.publish(e);
  e.f64 = std::numeric_limits<double>::quiet_NaN();
  e.maybe = std::numeric_limits<double>::quiet_NaN();
  e.f32 = 16777216.0f;
  feed.publish(e);
  e.f64 = -1e300;
  e.f32 = -std::numeric_limits<float>::infinity();
  e.u64 = std::numeric_limits<std::uint64_t>::max();
  e.i64 = std::numeric_limits<std::int64_t>::min();
  e.letter = '\7';
  e.state = static_cast<payloads::State>(99);
  feed.publish(e);
  e.f64 = 9007199254740993.0;
  e.name = "\"'%s";
  feed.publish(e);
}

std::uint64_t checked(const VerifyReport& report) { return report.runs.at(0).values_checked; }

bool is_seen(const std::string& path, const std::string& change) {
  sql(path, change);
  return verified(path).verdict() == Verdict::not_balanced;
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("US-26 the hash of a row is that of the documented bytes") {
    sqlite::RowHash hash;
    hash.begin();
    hash.integer(1);
    hash.integer(1'700'000'000'000'000'000);
    hash.text("room");
    hash.integer(1);
    hash.real(21.5);
    hash.real(-0.0);
    hash.null();
    // The bytes are in docs/recording.md; `xxhsum -H3` gives this for them.
    CHECK(hash.hash_of_values() == 0xfd4e0b50acdc7c59);
  }

  TEST_CASE("US-26 values of every kind have checksums, which VACUUM, a dump and reading it again leave alone") {
    const Folder folder;
    const std::string path = make(folder, publish_awkward);
    CHECK(checked(check_balanced(path)) == 999 + 6);
    sql(path, "VACUUM");
    CHECK(checked(check_balanced(path)) == 999 + 6);
    const std::string copy = folder / "copy.db";
    REQUIRE(std::system(("sqlite3 " + path + " .dump | sqlite3 " + copy).c_str()) == 0);
    sql(copy, "PRAGMA application_id = " + std::to_string(sqlite::application_id) +
                  "; PRAGMA user_version = " + std::to_string(sqlite::schema_version));
    CHECK(checked(check_balanced(copy)) == 999 + 6);
  }

  TEST_CASE("US-26 a changed value is seen, whatever its kind") {
    const Folder folder;
    for (const char* change :
         {"temperature = temperature + 1e-12", "humidity = NULL", "humidity = '40%'", "time = time + 1"}) {
      CAPTURE(change);
      const std::string path = make(folder, publish_awkward, "a.db");
      CHECK(is_seen(path, std::string("UPDATE \"room/climate\" SET ") + change + " WHERE sequence = 77"));
      std::filesystem::remove(path);
    }
    const std::string path = make(folder, publish_awkward);
    for (const char* change : {"\"checksum~\" = NULL", "\"checksum~\" = \"checksum~\" || 'x'"}) {
      const std::string forgotten = folder / "forgotten.db";
      std::filesystem::copy_file(path, forgotten, std::filesystem::copy_options::overwrite_existing);
      CHECK(is_seen(forgotten, std::string("UPDATE \"room/climate\" SET ") + change));
    }
    auto database = sqlite::Database::open(path, sqlite::Database::Mode::read);
    for (const std::string& column : sqlite::columns_of(database, "every/thing")) {
      if (column == "run") continue;
      CAPTURE(column);
      const std::string changed = folder / "changed.db";
      std::filesystem::copy_file(path, changed, std::filesystem::copy_options::overwrite_existing);
      CHECK(is_seen(changed, "UPDATE \"every/thing\" SET \"" + column + "\" = 'x' WHERE sequence = 2"));
    }
  }

  TEST_CASE("US-26 two values that change places are seen") {
    const Folder folder;
    const std::string path = make(folder);
    CHECK(
        is_seen(path,
                "UPDATE \"room/climate\" SET temperature = CASE sequence WHEN 10 THEN 11 ELSE 10 END WHERE sequence IN "
                "(10, 11)"));
  }

  TEST_CASE("US-26 the last row of each transaction of a table has the sum of its hashes") {
    const Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      Sensor<Climate> fast(loop, {.name = "fast", .rate = 1_kHz}, [] { return Climate{}; });
      Sensor<Climate> slow(loop, {.name = "slow", .rate = 1_Hz}, [] { return Climate{}; });
      loop.advance(15500ms);
      for (const char* table : {"fast", "slow"}) {
        const std::string of = std::string(" FROM ") + table;
        CHECK(number(path, "SELECT count(\"checksum~\")" + of) == 15);
        CHECK(number(path, "SELECT \"checksum~\" IS NOT NULL" + of + " ORDER BY rowid DESC LIMIT 1") == 1);
      }
      const VerifyReport report = verified(path);  // of a run that goes on, too
      CHECK(report.runs.at(0).values_checked == report.runs.at(0).rows);
      CHECK(report.exit_code() == 0);
      loop.close();
    }
    CHECK(checked(check_balanced(path)) == 15'501 + 16);
  }

  TEST_CASE("US-26 the checksum of a run is that of all that is there of it, of copies and after other runs too") {
    const Folder folder;
    const std::string path = make(folder), copy = folder / "copy.db";
    const std::string before = verified(path).runs.at(0).checksum_text();
    CHECK(before.size() == 16);
    CHECK(before.find_first_not_of("0123456789abcdef") == std::string::npos);
    CHECK(has(verified(path).to_json(), "\"checksum\": \"" + before + "\""));
    sql(path, "VACUUM INTO '" + copy + "'");
    start_again(path);  // one more run
    CHECK(verified(path).runs.at(0).checksum_text() == before);
    CHECK(verified(path).runs.at(1).checksum_text() != before);
    CHECK(verified(copy).runs.at(0).checksum_text() == before);
    // Changes of a value, of the account, and those whose own checksums were made to fit.
    sql(copy, "UPDATE \"room/climate\" SET humidity = 41 WHERE sequence = 3");
    const std::string changed = verified(copy).runs.at(0).checksum_text();
    CHECK(changed != before);
    write_checksums(copy);
    CHECK(verified(copy).runs.at(0).checksum_text() == changed);
    sql(copy, "UPDATE \"room/climate\" SET humidity = 40 WHERE sequence = 3; UPDATE rtdata_gap SET reason = 'other'");
    CHECK(verified(copy).runs.at(0).checksum_text() != before);
  }

  TEST_CASE("US-26 a later run with more fields leaves the checksums of earlier ones as they are") {
    const Folder folder;
    const std::string path = make(folder);
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      Sensor<Wider> room(loop, {.name = "room", .topic = "room/climate", .rate = 100_Hz}, [] { return Wider{}; });
      loop.advance(1s);
      loop.close();
    }
    const VerifyReport report = check_balanced(path);
    REQUIRE(report.runs.size() == 2);
    CHECK(report.runs[1].values_checked == 101);
    CHECK(number(path, "SELECT count(*) FROM \"room/climate\" WHERE pressure = 1 AND temperature = 2") == 101);
  }

  TEST_CASE("US-26 whole transactions are pruned, and the checksums of what stays are exact") {
    const Folder folder;
    const std::string path = folder / "run.db";
    bool is_old = false;
    Rate rate = 200_Hz;
    SqliteConfig config{.path = path};
    SUBCASE("by age") { config.max_age = 20s; }
    SUBCASE("by size") {
      config.max_bytes = SqliteConfig::least_max_bytes;
      rate = 2_kHz;
    }
    SUBCASE("a run that has ended") {
      config.max_age = 20s;
      is_old = true;
    }
    const auto record = [&](Duration time) {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, config);
      Sensor<Climate> a(loop, {.name = "a", .topic = "t", .rate = rate}, [n = 0]() mutable {
        return Climate{1.0 * n++, 0};
      });
      Sensor<Climate> b(loop, {.name = "b", .topic = "t", .rate = 70_Hz}, [n = 0]() mutable {
        return Climate{0, 1.0 * n++};
      });
      loop.advance(time);
      loop.close();
    };
    record(100s);
    if (is_old) record(90s);
    const VerifyReport report = check_balanced(path);
    std::uint64_t rows = 0, values = 0;
    for (const RunReport& run : report.runs) {
      rows += run.rows;
      values += run.values_checked;
    }
    CHECK(values == rows);
    CHECK(number(path, "SELECT sum(pruned) FROM rtdata_ledger") > 0);
    CHECK(number(path, "SELECT \"checksum~\" IS NOT NULL FROM t ORDER BY rowid DESC LIMIT 1") == 1);
    CHECK(is_seen(path, "UPDATE t SET temperature = -1 WHERE rowid = (SELECT min(rowid) FROM t WHERE origin = 'a')"));
  }

  TEST_CASE("US-26 the account of a run has a checksum, of each column of its tables") {
    const Folder folder;
    const std::string path = make(folder);
    auto database = sqlite::Database::open(path, sqlite::Database::Mode::read);
    const std::string changed = folder / "changed.db";
    const auto try_change = [&](const std::string& change) {
      CAPTURE(change);
      std::filesystem::copy_file(path, changed, std::filesystem::copy_options::overwrite_existing);
      CHECK(is_seen(changed, change));
    };
    for (const std::string_view name : sqlite::account_tables) {
      const std::string table(name);
      if (database.integer("SELECT count(*) FROM " + table) == 0) continue;
      for (const std::string& column : sqlite::columns_of(database, table)) {
        if (column == "run") continue;
        try_change("UPDATE " + table + " SET \"" + column + "\" = ifnull(\"" + column + "\", 0) || '1'");
      }
      try_change("DELETE FROM " + table);
    }
    try_change("UPDATE rtdata_topic SET first_run = 2");
    try_change("DELETE FROM rtdata_checksum");
    try_change("UPDATE rtdata_checksum SET sum = sum || 'x'");
    try_change("INSERT INTO rtdata_checksum SELECT * FROM rtdata_checksum");
  }

  TEST_CASE(
      "US-26 a killed run keeps the checksums of what it committed, and what was changed before it is sealed is seen") {
    const Folder folder;
    const std::string path = folder / "run.db";
    const pid_t child = fork_without_threads();
    if (child == 0) {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      Sensor<Climate> room(loop, {.name = "room", .rate = 100_Hz}, [n = 0]() mutable { return Climate{1.0 * n++, 0}; });
      Feed<Climate> feed(loop, {.name = "feed"});
      feed.publish({});
      loop.advance(70s);
      ::raise(SIGKILL);
    }
    int status = 0;
    REQUIRE(::waitpid(child, &status, 0) == child);
    REQUIRE(WIFSIGNALED(status));
    bool is_changed = true;
    SUBCASE("nothing") { is_changed = false; }
    SUBCASE("a value") { sql(path, "UPDATE room SET temperature = -1 WHERE sequence = 6900"); }
    SUBCASE("an account") { sql(path, "UPDATE rtdata_ledger SET late = 1"); }
    start_again(path);
    const VerifyReport report = verified(path);
    CAPTURE(report.text());
    CHECK(report.runs.at(0).verdict == (is_changed ? Verdict::not_balanced : Verdict::sealed));
    if (!is_changed) {
      CHECK(checked(report) == report.runs[0].rows);
      CHECK(checked(report) > 6900);
    }
  }

  TEST_CASE("US-26 a disk that has lost the last transactions of a killed run: the seal says so, and how many rows") {
    struct Times {
      std::chrono::seconds kept, killed;
    };
    for (const Times times : {Times{5s, 6s}, Times{20s, 70s}, Times{62s, 70s}}) {
      const auto kept = times.kept, killed = times.killed;
      CAPTURE(times.kept.count());
      const Folder folder;
      const std::string path = folder / "run.db";
      const auto copy = [&](const std::string& from, const std::string& to) {  // into the file that is there
        for (const char* part : {"", "-wal"})
          std::filesystem::copy_file(from + part, to + part, std::filesystem::copy_options::overwrite_existing);
      };
      const pid_t child = fork_without_threads();
      if (child == 0) {
        Loop loop{Loop::Manual{}};
        SqliteSink sink(loop, {.path = path});
        Sensor<Climate> room(loop, {.name = "room", .rate = 100_Hz}, [n = 0]() mutable {
          return Climate{1.0 * n++, 0};
        });
        Feed<Climate> feed(loop, {.name = "feed"});
        feed.publish({});
        loop.advance(kept);
        copy(path, path + ".kept");
        loop.advance(killed - kept);
        ::raise(SIGKILL);
      }
      int status = 0;
      REQUIRE(::waitpid(child, &status, 0) == child);
      REQUIRE(WIFSIGNALED(status));
      copy(path + ".kept", path);
      std::filesystem::remove(path + "-shm");
      start_again(path);
      const VerifyReport report = verified(path);
      CAPTURE(report.text());
      const RunReport& run = report.runs.at(0);
      CHECK(run.verdict == Verdict::sealed);
      CHECK(report.exit_code() == 0);
      CHECK(run.info.remark.find("the disk has lost them") != std::string::npos);
      // All of it is accounted for: each tick is a row that is there or one that is lost.
      CHECK(run.offered == static_cast<std::uint64_t>(killed / 10ms) + 2);
      REQUIRE(run.info.lost);
      CHECK(run.rows + *run.info.lost == run.offered);
      CHECK(run.rows <= static_cast<std::uint64_t>(kept / 10ms) + 2);
      CHECK(run.rows + 400 > static_cast<std::uint64_t>(kept / 10ms));
    }
  }
}
