// What is done with runs once they are recorded: found, listed, sealed, deleted, merged, compared.
#include "rtdata/recording/runs.hpp"

#include <doctest/doctest.h>
#include <sys/mount.h>

#include <csignal>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>

#include "app/core/recording_commands.hpp"
#include "has.hpp"
#include "recording/step.hpp"
#include "rtdata/sensors/limit.hpp"
#include "sinks/killed.hpp"
#include "sinks/power_cut.hpp"
#include "sinks/recordings.hpp"
#include "sinks/through_run.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using namespace std::chrono_literals;
using recordings::Folder;
using recordings::number;
using recordings::problems_of;
using recordings::sql;
using recordings::verified;
using rtdata::test::has;

namespace {

struct Number {
  double value = 0;
  RTDATA_FIELDS(Number, (value, "V"))
};
struct Pressure {
  double value = 0;
  std::int64_t count = 0;
  RTDATA_FIELDS(Pressure, (value, "kPa"), (count, ""))
};
struct LongNames {
  double a_name_that_is_as_long_as_names_of_machines_are = 0, b = 0;
  RTDATA_FIELDS(LongNames, (a_name_that_is_as_long_as_names_of_machines_are, "m/s2"), (b, ""))
};
struct Wide {
  double value = 0;
  std::int64_t more = 0;
  RTDATA_FIELDS(Wide, (value, "V"), (more, ""))
};
struct Change {
  text<16> to = {};
  RTDATA_FIELDS(Change, (to))
};

/// A machine that records one run after the other in virtual time.
class Machine {
 public:
  explicit Machine(std::string path, Time begin = Time{1'800'000'000s}) : path_(std::move(path)), clock_(begin) {}

  /// So many events of 1 V, 2 V and so on, 10 a second, on topic a; and a scheduled sensor.
  template <class Payload = Number>
  void record(const std::string& name, int events, SqliteConfig config = {}, const std::string& notes = "") {
    Runtime runtime({.name = name, .notes = notes, .clock = &clock_});
    Loop loop(runtime, {.name = "main"});
    loop.on_error([](const ErrorReport&) {});
    loop.runtime().on_log([](const LogRecord&) {});
    config.path = path_;
    SqliteSink sink(loop, config);
    Feed<Payload> feed(loop, {.name = "feed", .topic = "a"});
    Sensor<Number> sensor(loop, {.name = "room", .topic = "lab/room", .rate = 1_Hz}, [&] { return Number{20}; });
    for (int i = 0; i < events; ++i) {
      loop.advance(100ms);
      feed.publish({static_cast<double>(i + 1)});
    }
    loop.advance(1s);
    sensor.close();
    feed.close();
    CHECK(loop.close() == 0);
    clock_.pass(1h);
  }
  ManualClock& clock() { return clock_; }

 private:
  std::string path_;
  ManualClock clock_;
};

/// A recording of so many runs, of 10, 20, ... events.
std::string make_runs(const Folder& folder, const std::vector<std::string>& names, const std::string& file = "run.db") {
  Machine machine(folder / file);
  int events = 0;
  for (const std::string& name : names) machine.record(name, events += 10);
  return folder / file;
}

std::vector<RunInfo> runs_of(const std::string& path) { return Recording::open(path).or_throw().runs().or_throw(); }

std::string found(const std::vector<RunInfo>& runs, const std::string& which) {
  const auto run = find_run(runs, which, "run.db");
  return run ? std::to_string(run->run) : std::string(run.error().id()) + ": " + run.error().why + run.error().advice;
}

void check_good(const std::string& path) {
  const VerifyReport report = verified(path);
  CHECK_MESSAGE(report.exit_code() == 0, report.text());
}

/// The run ended by a kill, with 5 events that were not committed.
void record_killed(const std::string& path) {
  sinks::killed_in([&] {
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path});
    Feed<Number> feed(loop, {.name = "feed", .topic = "a"});
    loop.advance(1s);
    for (int i = 0; i < 10; ++i) feed.publish({1});
    loop.advance(2s);
    for (int i = 0; i < 5; ++i) feed.publish({2});
    ::raise(SIGKILL);
  });
}

struct Told {
  int status;
  std::string out, err;
};
template <class Options>
Told told(int (*command)(const Options&, std::ostream&, std::ostream&), const std::type_identity_t<Options>& options) {
  std::ostringstream out, err;
  const int status = command(options, out, err);
  return {status, out.str(), err.str()};
}

std::vector<std::string> values_of(const std::string& path, const std::string& query) {
  const auto database = sqlite::Database::open(path, sqlite::Database::Mode::read);
  return database.prepare(query).texts();
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("NFR-5 a run is found by its number, from the end, and by its name") {
    const Folder folder;
    const auto runs = runs_of(make_runs(folder, {"cold", "hot", "hot", "7"}));
    CHECK(found(runs, "1") == "1");
    CHECK(found(runs, "-1") == "4");
    CHECK(found(runs, "-4") == "1");
    CHECK(found(runs, "cold") == "1");
    CHECK(found(runs, "7") == "4");  // there is no run of that number
    CHECK(found(runs, "cild") ==
          "not-found: there is no run \"cild\" (did you mean \"cold\"?); its runs are 1 \"cold\", "
          "2 \"hot\", 3 \"hot\", 4 \"7\"");
    CHECK(found(runs, "hot") ==
          "bad-argument: several runs have the name \"hot\"name one by its number: 2 \"hot\", 3 "
          "\"hot\"");
    for (const char* none : {"0", "5", "-5", "-9223372036854775808"})
      CHECK(has(found(runs, none), "not-found: there is no run " + std::string(none) + "; its runs are 1 \"cold\""));
    CHECK(has(found(runs, ""), "there is no run \"\""));
    CHECK(found({}, "1") == "not-found: it has no run");
    const std::string path = folder / "run.db";
    CHECK(has(told(app::verify, {.database = path, .run = "cold"}).out, "run 1 \"cold\""));
    CHECK(has(told(app::info, {.database = path, .run = "-2"}).out, "\nrun 3\n"));
    CHECK(
        has(told(app::export_recording, {.database = path, .topic = "a", .run = "cold", .limit = 1}).out, ",feed,1,1"));
    for (const Told& none :
         {told(app::verify, {.database = path, .run = "cild"}), told(app::info, {.database = path, .run = "cild"}),
          told(app::export_recording, {.database = path, .run = "cild"})}) {
      CHECK(none.status == 1);
      CHECK(has(none.err, "did you mean \"cold\"?"));
    }
  }

  TEST_CASE("NFR-5 runs has a line of 80 columns a run") {
    const Folder folder;
    const std::string path = folder / "run.db";
    Machine machine(path);
    machine.record("cold", 30, {}, "the first one, with a long note that no line of a terminal can hold as a whole");
    machine.record("a name that is longer than what there is room for in a line", 5, {}, "two\nlines");
    sql(path, "UPDATE a SET value = 7 WHERE run = 2 AND sequence = 3");
    record_killed(path);
    const Told runs = told(app::runs, {.database = path});
    CHECK(runs.status == 0);
    CHECK(runs.err.empty());
    std::istringstream text(runs.out);
    std::vector<std::string> lines;
    for (std::string line; std::getline(text, line);) {
      lines.push_back(line);
      CHECK_MESSAGE(line.size() <= 80, line);
    }
    REQUIRE(lines.size() == 4);
    CHECK(has(lines[1], "1  cold"));
    CHECK(has(lines[1], "2027-01-15T08:00:00Z   4.0 s"));
    CHECK(has(lines[1], "balanced"));
    CHECK(has(lines[1], "the f"));
    CHECK(has(lines[2], "not balanced"));
    CHECK(has(lines[3], "not sealed"));
    CHECK(has(lines[3], "Z       -"));  // its end is not in the file
    const auto json = nlohmann::json::parse(told(app::runs, {.database = path, .show_as = app::ShowAs::json}).out);
    REQUIRE(json["runs"].size() == 3);
    CHECK(json["runs"][0]["rows"] == 35);
    CHECK(json["runs"][1]["notes"] == "two\nlines");
    CHECK(json["runs"][1]["verdict"] == "not balanced");
    CHECK(json["runs"][0]["length_s"] == 4);
    CHECK(json["runs"][2]["ended_utc"].is_null());
    CHECK(json["runs"][2]["length_s"].is_null());
    CHECK(json["runs"][0]["hash"].get<std::string>().size() == 16);
    CHECK(json["runs"][0]["hash"] != json["runs"][1]["hash"]);
    CHECK(told(app::runs, {.database = folder / "none.db"}).status == 2);
    std::ofstream(folder / "text.db") << "no recording, but long enough to have a head of a hundred bytes" << path
                                      << path;
    const Told damaged = told(app::runs, {.database = folder / "text.db"});
    CHECK(damaged.status == 2);
    CHECK(has(damaged.err, "it is not an SQLite file"));
  }

  TEST_CASE("US-26 a killed run is sealed without recording again, as the next start would") {
    const Folder folder;
    const std::string path = make_runs(folder, {"cold"});
    record_killed(path);
    CHECK(verified(path).exit_code() == 1);
    std::ostringstream out, err;
    CHECK(app::seal(path, out, err) == 0);
    CHECK(has(out.str(), "sealed: run 2 ended without closing; lost 5 events, published and not yet committed"));
    const VerifyReport report = verified(path);
    CHECK(report.exit_code() == 0);
    REQUIRE(report.runs.size() == 2);
    CHECK(report.runs[1].verdict == Verdict::sealed);
    CHECK(report.runs[1].info.lost == 5);
    CHECK(report.runs[1].rows == 10);
    CHECK_FALSE(std::filesystem::exists(path + "-lock"));
    out.str("");
    CHECK(app::seal(path, out, err) == 0);  // again
    CHECK(has(out.str(), "nothing to seal"));
    CHECK(err.str().empty());
    CHECK(verified(path).runs.size() == 2);
    CHECK(app::seal(folder / "none.db", out, err) == 2);
    CHECK_FALSE(std::filesystem::exists(folder / "none.db"));
    Machine(path).record("after", 3);
    check_good(path);
  }

  TEST_CASE("a recording that is recorded into is neither sealed nor loses a run") {
    const Folder folder;
    const std::string path = make_runs(folder, {"cold", "hot"});
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path});
    loop.advance(1s);
    std::ostringstream out, err;
    CHECK(app::seal(path, out, err) == 1);
    CHECK(has(err.str(), "cannot seal"));
    for (const char* run : {"1", "3"}) {
      const Told refused = told(app::remove_run, {.database = path, .run = run});
      CHECK(refused.status == 1);
      CHECK(has(refused.err, "cannot delete the run"));
      CHECK(has(refused.err, "stop that one first"));
    }
    const Told merged = told(app::merge, {.sources = {path}, .database = folder / "all.db"});
    CHECK(merged.status == 1);
    CHECK(has(merged.err, "run 3: it is being recorded"));
    CHECK(loop.close() == 0);
    CHECK(runs_of(path).size() == 3);
    check_good(path);
  }

  TEST_CASE("US-26 a run is deleted, and the account of the rest balances") {
    const Folder folder;
    const std::string path = make_runs(folder, {"one", "two", "three"});
    const std::uint64_t utc = static_cast<std::uint64_t>(
        number(path, "SELECT max(utc_ns) FROM \"a~utc\" WHERE run = 1"));
    const auto remove = [&](const std::string& run) { return told(app::remove_run, {.database = path, .run = run}); };
    SUBCASE("the first") {
      CHECK(has(remove("one").out, "deleted run 1 \"one\", 13 rows"));
      CHECK(values_of(path, "SELECT DISTINCT run FROM a") == std::vector<std::string>{"2", "3"});
    }
    SUBCASE("one in the middle") {
      CHECK(has(remove("two").out, "deleted run 2 \"two\", 24 rows"));
      CHECK(values_of(path, "SELECT DISTINCT run FROM a") == std::vector<std::string>{"1", "3"});
      CHECK(number(path, "SELECT offered FROM rtdata_deleted WHERE topic = 'a'") == 20);
    }
    SUBCASE("the last: its number is not used again, and it leaves what it knew of UTC") {
      CHECK(has(remove("-1").out, "deleted run 3 \"three\", 35 rows"));
      Machine(path).record("four", 5);
      CHECK(runs_of(path).back().run == 4);
      CHECK(static_cast<std::uint64_t>(number(path, "SELECT max(utc_ns) FROM \"a~utc\" WHERE run = 1")) == utc);
    }
    SUBCASE("all of them, one after the other") {
      CHECK(remove("2").status == 0);
      CHECK(remove("3").status == 0);
      CHECK(remove("1").status == 0);
      CHECK(number(path, "SELECT count(*) FROM a") == 0);
      CHECK(has(verified(path).text(), "No run is left."));
      CHECK(has(told(app::info, {.database = path}).out, "No run is left"));
      CHECK(has(told(app::runs, {.database = path}).out, "3 of the runs 1 to 3 were deleted"));
      const Told none = remove("-1");
      CHECK(none.status == 1);
      CHECK(has(none.err, "it has no run"));
      Machine(path).record("four", 5);
      CHECK(runs_of(path).front().run == 4);
    }
    check_good(path);
    CHECK_FALSE(std::filesystem::exists(path + "-lock"));
    CHECK(remove("9").status == 1);
    CHECK(told(app::remove_run, {.database = folder / "none.db", .run = "1"}).status == 2);
  }

  TEST_CASE("US-26 a run that does not balance, or is not sealed, is not deleted") {
    const Folder folder;
    const std::string path = make_runs(folder, {"one", "two"});
    record_killed(path);
    const auto refusal = [&](std::int64_t run) {
      const auto deleted = delete_run(path, run);
      REQUIRE_FALSE(deleted);
      return deleted.error().text();
    };
    CHECK(has(refusal(3), "`rtdata seal` does that"));
    CHECK(delete_run(path, 1));  // of others it can be, and what is known of the killed one stays
    CHECK(rtdata::seal(path).or_throw().size() == 1);
    CHECK(runs_of(path).back().lost == 5);
    check_good(path);
    sql(path, "DELETE FROM a WHERE run = 2 AND sequence = 4");
    CHECK(has(refusal(2), "the number of rows of a differs from its account"));
    CHECK(number(path, "SELECT count(*) FROM a WHERE run = 2") == 19);
    CHECK_FALSE(std::filesystem::exists(path + "-lock"));
    CHECK(delete_run(path, 3));
  }

  TEST_CASE("US-32 a run that a peer has not all of is deleted with its backlog only, which is counted") {
    const Folder folder;
    const std::string path = folder / "run.db";
    bool is_away = false;
    const sinks::Peer peer = sinks::peer_away_while(is_away);
    const auto record = [&](int events) {
      sinks::Run run(path, peer);
      run.publish(events);
      run.loop.advance(3s);
      CHECK(run.loop.close(5s) == 0);
    };
    record(10);
    record(20);
    is_away = true;
    record(40);
    record(80);
    REQUIRE(peer->events.size() == 30);
    const Told refused = told(app::remove_run, {.database = path, .run = "3"});
    CHECK(refused.status == 1);
    CHECK(has(refused.err, "40 for sink peer"));
    CHECK_FALSE(std::filesystem::exists(path + "-lock"));
    CHECK(runs_of(path).size() == 4);
    // What was sent goes without a word; the position is then that of the run before it.
    CHECK(told(app::remove_run, {.database = path, .run = "2"}).status == 0);
    CHECK(number(path, "SELECT run FROM rtdata_position WHERE table_name = 'a'") == 1);
    CHECK(Recording::open(path).or_throw().backlogs().or_throw().at(0).events == 120);
    const Told discarded = told(app::remove_run, {.database = path, .run = "3", .unsent = Unsent::discarded});
    CHECK(discarded.status == 0);
    CHECK(has(discarded.out, "LOST: 40 events that the peer of sink peer does not have"));
    check_good(path);
    CHECK(verified(path).unsent.at("peer") == 40);
    CHECK(has(verified(path).text(), "LOST: 40 events"));
    is_away = false;
    record(160);
    CHECK(peer->events.size() == 30 + 80 + 160);  // none twice, and of what is left none is missing
    check_good(path);
  }

  TEST_CASE("US-26 killed while a run is deleted: it is there as a whole, or gone") {
    const Folder folder;
    const std::string made = make_runs(folder, {"one", "two", "three"});
    int gone = 0, there = 0;
    for (std::size_t moment = 0;; moment += 5) {
      CAPTURE(moment);
      const std::string path = folder / "copy.db";
      for (const char* part : {"", "-wal", "-shm", "-lock"}) std::filesystem::remove(path + part);
      std::filesystem::copy_file(made, path);
      const int status = sinks::status_of([&] {
        power_cut::Disk disk;
        disk.has(path);
        disk.kill_at(moment);
        (void)delete_run(path, 2);
        ::_exit(7);
      });
      const bool is_done = WIFEXITED(status);
      const std::size_t runs = runs_of(path).size();
      ++(runs == 3 ? there : gone);
      CHECK(number(path, "SELECT count(*) FROM a WHERE run = 2") == (runs == 3 ? 20 : 0));
      check_good(path);
      if (is_done) {
        CHECK(WEXITSTATUS(status) == 7);
        break;
      }
      if (runs == 3) CHECK(delete_run(path, 2));  // again
      check_good(path);
    }
    CHECK(there > 0);
    CHECK(gone > 1);
  }

  TEST_CASE("US-26 recordings of two machines are merged, each run with its account and its own UTC") {
    const Folder folder;
    const std::string a = folder / "a.db", b = folder / "b.db", merged = folder / "all.db";
    Machine rocket(a), ground(b, Time{5s});  // a clock that is set right only later
    rocket.record("ascent", 30);
    rocket.record("descent", 20);
    ground.record("watch", 10);
    ground.clock().set_realtime(Time{1'800'000'100s});
    ground.record<Wide>("watch", 40, {}, "set");  // its table gets a column
    record_killed(b);
    CHECK(has(told(app::merge, {.sources = {a, b}, .database = merged}).err, "`rtdata seal " + b + "`"));
    CHECK_FALSE(std::filesystem::exists(merged));
    REQUIRE(rtdata::seal(b).or_throw().size() == 1);
    const auto hash = [&](const std::string& path, std::int64_t run) {
      return hashes_of_runs(Recording::open(path).or_throw()).or_throw().at(run);
    };
    const std::uint64_t hash_of_last = hash(b, 3);
    const Told done = told(app::merge, {.sources = {a, b}, .database = merged});
    CHECK_MESSAGE(done.status == 0, done.err);
    CHECK(has(done.out, "  run 4: run 2 of " + b + ", 46 rows\n"));
    const VerifyReport report = verified(merged);
    CHECK_MESSAGE(report.exit_code() == 0, report.text());
    REQUIRE(report.runs.size() == 5);
    const std::vector<RunInfo> of_a = runs_of(a), of_b = runs_of(b), all = runs_of(merged);
    for (std::size_t i = 0; i < all.size(); ++i) {
      const RunInfo& from = i < 2 ? of_a[i] : of_b[i - 2];
      CHECK(all[i].run == static_cast<std::int64_t>(i) + 1);
      CHECK(all[i].uuid == from.uuid);
      CHECK(all[i].name == from.name);
      CHECK(all[i].notes == from.notes);
      CHECK(all[i].boot_id == from.boot_id);
      CHECK(has(all[i].remark, "merged from run " + std::to_string(from.run) + " of " + (i < 2 ? a : b) + ", hash "));
    }
    std::ostringstream text;
    text << std::hex << hash_of_last;
    CHECK(has(all[4].remark, text.str()));
    CHECK(all[4].lost == 5);
    // Each row with its UTC.
    const auto rows = [](const std::string& path, const std::string& which) {
      return values_of(
          path, "SELECT utc || origin || sequence || value FROM \"a~utc\" WHERE " + which + " ORDER BY run, sequence");
    };
    auto wanted = rows(a, "true");
    const auto more = rows(b, "true");
    wanted.insert(wanted.end(), more.begin(), more.end());
    CHECK(rows(merged, "true") == wanted);
    CHECK(values_of(merged, "SELECT started FROM rtdata_run_utc WHERE run = 3").front() ==
          values_of(b, "SELECT started FROM rtdata_run_utc WHERE run = 1").front());
    CHECK(number(merged, "SELECT count(*) FROM rtdata_clock WHERE run = 4") ==
          number(b, "SELECT count(*) FROM rtdata_clock WHERE run = 2"));
    for (const char* table : {"rtdata_gap", "rtdata_schedule", "rtdata_ledger", "rtdata_health"}) {
      const std::string count = std::string("SELECT count(*) FROM ") + table;
      CHECK(number(merged, count) == number(a, count) + number(b, count));
    }
    // It goes on as any other.
    Machine(merged).record("later", 5);
    check_good(merged);
    CHECK(runs_of(merged).back().run == 6);
    // Merged again it is the same.
    const std::string again = folder / "again.db";
    CHECK(told(app::merge, {.sources = {merged}, .database = again}).status == 0);
    CHECK(rows(again, "true") == rows(merged, "true"));
    check_good(again);
  }

  TEST_CASE("US-26 steps go with the run that is deleted; what was merged has none, and reads the same") {
    const Folder folder;
    const std::string path = folder / "run.db", merged = folder / "all.db";
    Machine machine(path);
    machine.record("one", 200);
    machine.record("rows alone", 100, {.path = path, .steps = false});
    machine.record("three", 300);
    const auto steps = [](const std::string& of, int run) {
      std::int64_t count = 0;
      for (const char* table : {"a~1s", "a~1min"}) {
        if (number(of, std::string("SELECT count(*) FROM sqlite_schema WHERE name = '") + table + "'") == 0) continue;
        count += number(of, std::string("SELECT count(*) FROM \"") + table + "\" WHERE run = " + std::to_string(run));
      }
      return count;
    };
    const auto seconds = [](const std::string& of, const std::string& run) {
      const Told told_of = told(app::export_recording, {.database = of, .topic = "a", .run = run, .step = "1s"});
      CHECK_MESSAGE(told_of.status == 0, told_of.err);
      return told_of.out;
    };
    REQUIRE(steps(path, 1) > 20);
    REQUIRE(steps(path, 2) == 0);
    CHECK(told(app::merge, {.sources = {path}, .database = merged}).status == 0);
    check_good(merged);
    CHECK(number(merged, "SELECT sum(seconds_from + minutes_from) FROM rtdata_ledger") == 0);
    for (const char* run : {"1", "2", "3"}) CHECK(seconds(merged, run) == seconds(path, run));
    Machine(merged, Time{1'900'000'000s}).record("later", 100);  // has steps again, beside runs without
    check_good(merged);
    CHECK(steps(merged, 4) > 10);
    CHECK(steps(merged, 1) == 0);
    CHECK(seconds(merged, "1") == seconds(path, "1"));

    const std::int64_t of_third = steps(path, 3);
    for (const char* run : {"1", "2"}) {
      CHECK(told(app::remove_run, {.database = path, .run = run}).status == 0);
      check_good(path);
    }
    CHECK(steps(path, 1) == 0);
    CHECK(steps(path, 3) == of_third);
    CHECK(seconds(path, "3") == seconds(merged, "3"));
    // Of a recording without any tables of steps.
    const std::string rows = folder / "rows.db";
    Machine(rows).record("rows alone", 100, {.path = rows, .steps = false});
    CHECK(told(app::remove_run, {.database = rows, .run = "1"}).status == 0);
    check_good(rows);
  }

  TEST_CASE("US-26 of a run that is in two recordings, rows of one key are there once, and what differs is told") {
    const Folder folder;
    const std::string path = make_runs(folder, {"one", "two"}), copy = folder / "copy.db", merged = folder / "all.db";
    std::filesystem::copy_file(path, copy);
    Machine(copy).record("three", 5);
    SUBCASE("the same rows") {
      const Told done = told(app::merge, {.sources = {path, copy}, .database = merged});
      CHECK_MESSAGE(done.status == 0, done.err);
      CHECK(has(done.out, copy + ", a: 10 rows are the same"));
      CHECK(runs_of(merged).size() == 3);
      CHECK(number(merged, "SELECT count(*) FROM a") == 35);
      CHECK(values_of(merged, "SELECT value FROM a WHERE run = 2 ORDER BY sequence") ==
            values_of(path, "SELECT value FROM a WHERE run = 2 ORDER BY sequence"));
    }
    SUBCASE("a value that differs, in a copy that agrees with itself") {
      for (const sqlite::StepLength& length : sqlite::step_lengths)
        sql(copy, "DROP TABLE IF EXISTS " + sqlite::quoted(sqlite::step_table("a", length)));
      recordings::written_as(copy, "UPDATE rtdata_ledger SET seconds_from = 0, minutes_from = 0");
      recordings::written_as(copy, "UPDATE a SET value = 99 WHERE run = 2 AND sequence IN (3, 4)");
      const Told done = told(app::merge, {.sources = {path, copy}, .database = merged});
      CHECK(done.status == 1);
      CHECK(has(done.err, "2 rows with other values, left out; the first is sequence 3 of origin feed"));
      CHECK(number(merged, "SELECT max(value) FROM a") == 20);
      CHECK(has(runs_of(merged)[1].remark, "2 rows with other values"));
    }
    check_good(merged);
  }

  TEST_CASE("US-26 what one copy has pruned comes from the other") {
    const Folder folder;
    const std::string whole = folder / "whole.db", pruned = folder / "pruned.db", merged = folder / "all.db";
    Machine machine(whole);
    machine.record("long", 2000);
    std::filesystem::copy_file(whole, pruned);
    Machine(pruned, Time{1'800'000'150s}).record("later", 600, {.path = pruned, .max_age = std::chrono::seconds{60}});
    const auto left = number(pruned, "SELECT count(*) FROM a WHERE run = 1");
    REQUIRE(left < 2000);
    REQUIRE(number(pruned, "SELECT pruned FROM rtdata_ledger WHERE run = 1 AND topic = 'a'") == 2000 - left);
    check_good(pruned);
    const Told done = told(app::merge, {.sources = {pruned, whole}, .database = merged});
    CHECK_MESSAGE(done.status == 0, done.err);
    CHECK(number(merged, "SELECT count(*) FROM a WHERE run = 1") == 2000);
    check_good(merged);
    CHECK(values_of(merged, "SELECT value FROM a WHERE run = 1 ORDER BY _rowid_") ==
          values_of(whole, "SELECT value FROM a ORDER BY _rowid_"));
  }

  TEST_CASE("US-26 runs that were deleted, and what senders lost, are counted in what was merged") {
    const Folder folder;
    const std::string a = make_runs(folder, {"one", "two", "three"}, "a.db"), b = make_runs(folder, {"x", "y"}, "b.db");
    const std::string merged = folder / "all.db";
    REQUIRE(delete_run(a, 1));
    REQUIRE(delete_run(a, 3));
    REQUIRE(delete_run(b, 1));
    CHECK(told(app::merge, {.sources = {a, b}, .database = merged}).status == 0);
    const VerifyReport report = verified(merged);
    CHECK_MESSAGE(report.exit_code() == 0, report.text());
    REQUIRE(report.deleted);
    CHECK(report.deleted->runs.runs == 3);
    CHECK(values_of(merged, "SELECT run FROM rtdata_run") == std::vector<std::string>{"2", "5"});
    CHECK(number(merged, "SELECT offered FROM rtdata_deleted WHERE topic = 'a'") == 10 + 30 + 10);
    // A copy that has what the other has deleted.
    const std::string copy = folder / "copy.db";
    std::filesystem::copy_file(b, copy);
    Machine(b).record("z", 5);
    REQUIRE(delete_run(b, 3));
    const Told refused = told(app::merge, {.sources = {b, copy}, .database = folder / "no.db"});
    CHECK(refused.status == 1);
    CHECK(has(refused.err, "one of the two has deleted others"));
  }

  TEST_CASE("US-32 what waits in a source for a peer is told, and what was lost before stays told") {
    const Folder folder;
    const std::string path = folder / "run.db", merged = folder / "all.db";
    bool is_away = true;
    for (int i = 0; i < 2; ++i) {
      sinks::Run run(path, sinks::peer_away_while(is_away));
      run.publish(10);
      run.loop.advance(3s);
      CHECK(run.loop.close(5s) == 0);
    }
    REQUIRE(delete_run(path, 1, Unsent::discarded));
    const Told done = told(app::merge, {.sources = {path}, .database = merged});
    CHECK(done.status == 0);
    CHECK(has(done.err, "10 events wait in " + path + " for the peer of sink peer"));
    check_good(merged);
    CHECK(verified(merged).unsent.at("peer") == 10);
    CHECK(number(merged, "SELECT count(*) FROM rtdata_position") == 0);
  }

  TEST_CASE("US-26 topics that differ in case only are merged, each in a table of its own") {
    const Folder folder;
    std::vector<std::string> sources;
    for (const std::string topic : {"room", "Room", "ROOM"}) {
      sources.push_back(folder / (topic + ".db"));
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = sources.back()});
      Feed<Number> feed(loop, {.name = "feed", .topic = topic});
      feed.publish({1});
      CHECK(loop.close() == 0);
    }
    const std::string merged = folder / "all.db";
    const auto report = merge(sources, merged);
    REQUIRE_MESSAGE(report, report.error().text());
    check_good(merged);
    CHECK(values_of(merged, "SELECT topic || ' ' || table_name FROM rtdata_topic ORDER BY first_run") ==
          std::vector<std::string>{"room room", "Room Room~2", "ROOM ROOM~3"});
    CHECK(number(merged, "SELECT count(*) FROM \"Room~2\"") == 1);
  }

  TEST_CASE("merge refuses what it cannot do, and leaves nothing behind") {
    const Folder folder;
    const std::string a = make_runs(folder, {"one"}, "a.db"), merged = folder / "all.db";
    const auto refusal = [&](std::vector<std::string> sources, const std::string& path) {
      const Told refused = told(app::merge, {.sources = std::move(sources), .database = path});
      CHECK(refused.status != 0);
      return std::to_string(refused.status) + refused.err;
    };
    CHECK(has(refusal({a, folder / "none.db"}, merged), "2rtdata: cannot read the recording"));
    CHECK(has(refusal({a, a}, merged), "1rtdata: cannot merge: " + a + ": it is named twice"));
    CHECK(has(refusal({a}, a), "it is there already"));
    CHECK(has(refusal({a}, folder / "none/all.db"), "1rtdata: "));
    std::filesystem::create_symlink("nowhere", folder / "link.db");
    CHECK(has(refusal({a}, folder / "link.db"), "it is there already"));
    std::filesystem::copy_file(a, folder / "changed.db");
    sql(folder / "changed.db", "UPDATE a SET value = 3 WHERE sequence = 9");
    CHECK(has(refusal({folder / "changed.db"}, merged),
              "1rtdata: cannot merge: " + (folder / "changed.db") + ", run 1: it does not balance: "));
    std::filesystem::copy_file(a, folder / "cut.db");
    std::filesystem::resize_file(folder / "cut.db", std::filesystem::file_size(a) / 2);
    CHECK(refusal({folder / "cut.db"}, merged).front() == '2');
    for (const auto& entry : std::filesystem::directory_iterator(folder / ""))
      CHECK_MESSAGE(!has(entry.path().string(), "all.db"), entry.path());
    check_good(a);
    // What has the name of the file that a merge makes first is not its own, and what belongs to another recording is
    // no name.
    const std::string beside = merged + "-merging";
    std::filesystem::copy_file(a, beside);
    CHECK(has(refusal({beside}, merged), "is not left over from a killed merge"));
    check_good(beside);
    std::filesystem::remove(beside);
    std::ofstream(beside) << "a text";
    CHECK(has(refusal({a}, merged), "move it away"));
    CHECK(std::filesystem::file_size(beside) == 6);
    std::filesystem::remove(beside);
    for (const char* const ending : {"-wal", "-shm", "-journal", "-lock", "-merging"})
      CHECK(has(refusal({a}, a + ending), "belong to another recording"));
    CHECK(has(refusal({a}, ":memory:"), "not a path of a file"));
  }

  TEST_CASE("US-26 killed while it merges: there is no recording, or a whole one; and it can be done again") {
    const Folder folder;
    const std::string a = make_runs(folder, {"one", "two"}, "a.db"), b = make_runs(folder, {"x"}, "b.db");
    const std::string merged = folder / "all.db";
    int kills = 0;
    for (std::size_t moment = 0;; moment += 2) {
      CAPTURE(moment);
      std::filesystem::remove(merged);
      const int status = sinks::status_of([&] {
        power_cut::Disk disk;
        disk.kill_at(moment);
        ::_exit(merge({a, b}, merged) ? 7 : 8);
      });
      if (WIFEXITED(status)) {
        CHECK(WEXITSTATUS(status) == 7);
        break;
      }
      ++kills;
      CHECK_FALSE(std::filesystem::exists(merged));
      const auto half = Recording::open(merged + "-merging");
      if (half) CHECK(verify(*half).or_throw().exit_code() == 0);
    }
    CHECK(kills > 10);
    check_good(merged);
    CHECK(runs_of(merged).size() == 3);
    CHECK_FALSE(std::filesystem::exists(merged + "-merging"));
    CHECK_FALSE(std::filesystem::exists(merged + "-merging-lock"));
  }

  TEST_CASE("NFR-1 a full disk: nothing is merged or deleted, it is told, and all is as before") {
    const Folder folder;
    const std::string disk = folder / "disk";
    std::filesystem::create_directory(disk);
    if (::mount("none", disk.c_str(), "tmpfs", 0, "size=512k") != 0) {
      MESSAGE("skipped: mounting a small disk is not permitted here");
      return;
    }
    Machine(folder / "large.db").record("large", 30'000);
    const Told merged = told(app::merge, {.sources = {folder / "large.db"}, .database = disk + "/all.db"});
    CHECK(merged.status == 1);
    CHECK_MESSAGE(has(merged.err, "full"), merged.err);
    CHECK(std::filesystem::is_empty(disk));
    const std::string path = disk + "/run.db";
    {
      Machine machine(folder / "small.db");
      machine.record("one", 1000);
      machine.record("two", 10);
      std::filesystem::copy_file(folder / "small.db", path);  // its log, while it is made, is larger than this disk
    }
    {
      std::ofstream ballast(disk + "/ballast");
      for (int i = 0; i < 1000 && ballast; ++i) ballast << std::string(1024, 'x') << std::flush;
    }
    const Told refused = told(app::remove_run, {.database = path, .run = "1"});
    CHECK(refused.status != 0);
    CHECK_MESSAGE(has(refused.err, "No space left on device"), refused.err);
    std::filesystem::remove(disk + "/ballast");
    CHECK(runs_of(path).size() == 2);
    check_good(path);
    CHECK(told(app::remove_run, {.database = path, .run = "1"}).status == 0);
    check_good(path);
    CHECK(::umount(disk.c_str()) == 0);
  }

  TEST_CASE("NFR-5 what never gave an event is told by info and verify, and what was held back on purpose by info") {
    const Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop{Loop::Manual{}};
      const SqliteSink sink(loop, {.path = path});
      const Feed<Number> feed(loop, {.name = "s"});
      const LimitSensor limit(loop, {.name = "lim"}, {.on = "s", .high = 3, .silence = 0s});
      const Sensor<Number> room(
          loop, {.name = "room", .rate = 10_Hz, .process = {{"value", {.filters = {Filter::throttle(950ms)}}}}},
          [] { return Number{20}; });
      loop.advance(2s);
      CHECK(loop.close() == 0);
    }
    const Told info = told(app::info, {.database = path});
    CHECK_MESSAGE(has(info.out, "  ! no event ever came from s\n"), info.out);
    CHECK_MESSAGE(has(info.out, "  ! no event ever came from lim\n"), info.out);
    CHECK_MESSAGE(has(info.out, "  ! 18 held back on purpose (filtered), which is not a loss\n"), info.out);
    CHECK_FALSE(has(info.out, "not recorded itself"));
    const auto topics = nlohmann::json::parse(told(app::info, {.database = path, .show_as = app::ShowAs::json}).out)
                            .at("topics");
    REQUIRE(topics.size() == 3);
    CHECK(topics[0]["mute"] == nlohmann::json{"lim"});
    CHECK(topics[1]["mute"].empty());
    CHECK(topics[1]["filtered"] == 18);
    CHECK(topics[2]["mute"] == nlohmann::json{"s"});
    CHECK(topics[2]["made_of_it"].empty());
    const VerifyReport report = verified(path);
    CHECK(report.runs[0].mute == std::vector<std::string>{"lim", "s"});
    CHECK_MESSAGE(has(report.text(), "  nothing lost: 3 rows\n  NO EVENT ever came from lim, s\n"), report.text());
    CHECK(nlohmann::json::parse(report.to_json())["runs"][0]["mute"] == nlohmann::json{"lim", "s"});
  }

  TEST_CASE("NFR-5 two runs are compared in lines of 80 columns, whatever the numbers and names are") {
    const Folder folder;
    const std::string path = folder / "run.db";
    for (const double sign : {1.0, -1.0}) {
      Loop loop{Loop::Manual{}};
      const SqliteSink sink(loop, {.path = path});
      Feed<LongNames> feed(loop, {.name = "a"});
      for (const double value : {1e-300, 1.234567e-200, -9.87654e250, sign * 1.7e308}) feed.publish({value, -value});
      CHECK(loop.close() == 0);
    }
    const Told both = told(app::compare, {.database = path, .first = "1", .second = "2"});
    std::istringstream lines(both.out);
    for (std::string line; std::getline(lines, line);) CHECK_MESSAGE(line.size() <= 80, line);
    CHECK_MESSAGE(has(both.out, " 1:  -9.877e+250   4.25e+307    1.7e+308\n"), both.out);
    CHECK_MESSAGE(has(both.out, " 2:    -1.7e+308  -4.25e+307  1.235e-200\n"), both.out);
  }

  TEST_CASE("NFR-5 two runs are compared from an instant of each") {
    const Folder folder;
    const std::string path = folder / "run.db";
    ManualClock clock;
    for (const int offset : {0, 100}) {
      Runtime runtime({.name = offset == 0 ? "cold" : "hot", .clock = &clock});
      Loop loop(runtime, {.name = "main"});
      SqliteSink sink(loop, {.path = path});
      Feed<Number> feed(loop, {.name = "load", .topic = "load"});
      Feed<Change> machine(loop, {.name = "sequence", .topic = "sequence"});
      loop.advance(offset == 0 ? 3s : 5s);
      machine.publish({text<16>("armed")});
      for (int i = 0; i < 20; ++i) {
        feed.publish({1000});
        loop.advance(100ms);
      }
      machine.publish({text<16>("burn")});
      for (int i = 0; i < 30; ++i) {
        feed.publish({i < 10 ? static_cast<double>(offset + i) : 5000});
        loop.advance(100ms);
      }
      CHECK(loop.close() == 0);
      clock.pass(1h);
    }
    const auto compared = [&](const std::string& from, const std::string& length, const std::string& second = "hot") {
      return told(app::compare, {.database = path, .first = "1", .second = second, .from = from, .length = length});
    };
    const Told burn = compared("sequence=burn", "1s");
    CHECK_MESSAGE(burn.status == 0, burn.err);
    CHECK_MESSAGE(has(burn.out, "load: 10 and 10 events\n"), burn.out);
    CHECK_MESSAGE(has(burn.out,
                      "load: 10 and 10 events\n"
                      "  field          least   mean  largest\n"
                      "  value [V]  1:      0    4.5        9\n"
                      "             2:    100  104.5      109\n"),
                  burn.out);
    CHECK(has(compared("sequence", "").out, "load: 50 and 50 events\n"));
    CHECK(has(compared("", "").out, "load: 50 and 50 events\n"));
    const auto json = nlohmann::json::parse(told(app::compare, {.database = path,
                                                                .first = "1",
                                                                .second = "-1",
                                                                .from = "sequence=burn",
                                                                .length = "1s",
                                                                .show_as = app::ShowAs::json})
                                                .out);
    CHECK(json["topics"][0]["fields"][0]["mean"] == nlohmann::json::parse("[4.5, 104.5]"));
    CHECK(json["topics"][0]["fields"][0]["deviation"][0].get<double>() == doctest::Approx(3.02765));
    CHECK(has(compared("seqence", "").err, "did you mean sequence?"));
    CHECK(has(compared("sequence=burm", "").err, "did you mean burn?"));
    CHECK(has(compared("load=burn", "").err, "has no states"));
    CHECK(has(compared("", "0s").err, "it is not above 0"));
    CHECK(has(compared("", "", "hod").err, "did you mean \"hot\"?"));
    CHECK(compared("", "", "hod").status == 1);
    CHECK(told(app::compare, {.database = folder / "none.db", .first = "1", .second = "2"}).status == 2);
  }

  TEST_CASE("NFR-5 two runs are compared in the unit of each, with the digits in which they differ") {
    const Folder folder;
    const std::string path = folder / "run.db";
    const auto record = [&]<class Payload>(std::initializer_list<Payload> values) {
      Loop loop{Loop::Manual{}};
      const SqliteSink sink(loop, {.path = path});
      Feed<Payload> feed(loop, {.name = "p"});
      for (const Payload& value : values) feed.publish(value);
      CHECK(loop.close() == 0);
    };
    constexpr double infinity = std::numeric_limits<double>::infinity();
    record(std::initializer_list<Pressure>{{100001, 1234567}, {100002, 1234567}});
    record(std::initializer_list<Pressure>{{100004, 1234567}, {100005, 1234569}});
    record(std::initializer_list<Number>{{1.5}, {-infinity}, {infinity}});
    const Told close = told(app::compare, {.database = path, .first = "1", .second = "2"});
    CHECK_MESSAGE(has(close.out,
                      "  field              least      mean  largest\n"
                      "  value [kPa]  1:   100001  100001.5   100002\n"
                      "               2:   100004  100004.5   100005\n"
                      "  count        1:  1234567   1234567  1234567\n"
                      "               2:  1234567   1234568  1234569\n"),
                  close.out);
    const Told units = told(app::compare, {.database = path, .first = "1", .second = "3"});
    CHECK_MESSAGE(has(units.out,
                      "  value [kPa]  1:   100001  100001.5   100002\n"
                      "               2:        -         -        -\n"
                      "  value [V]    1:        -         -        -\n"
                      "               2:     -inf       nan      inf\n"),
                  units.out);
    const auto json = nlohmann::json::parse(
        told(app::compare, {.database = path, .first = "1", .second = "3", .show_as = app::ShowAs::json}).out);
    const auto& fields = json["topics"][0]["fields"];
    REQUIRE(fields.size() == 3);
    CHECK(fields[0]["unit"] == "kPa");
    CHECK(fields[0]["count"] == nlohmann::json::parse("[2, 0]"));
    CHECK(fields[1]["unit"] == "V");
    CHECK(fields[1]["min"] == nlohmann::json::parse(R"([null, "-Infinity"])"));
    CHECK(fields[1]["mean"] == nlohmann::json::parse(R"([null, "NaN"])"));
    CHECK(fields[1]["max"] == nlohmann::json::parse(R"([null, "Infinity"])"));
  }

  TEST_CASE("NFR-5 two runs are compared with what a topic lost in a run without an event of it") {
    const Folder folder;
    const std::string path = folder / "run.db";
    for (const bool gives_some : {false, true}) {
      Loop loop{Loop::Manual{}};
      loop.on_error([](const ErrorReport&) {});
      const SqliteSink sink(loop, {.path = path});
      Feed<Number> feed(loop, {.name = "load"});
      feed.publish({1});
      const auto failing = [&](const char* name, bool gives) {
        return Sensor<Number>(loop, {.name = name, .rate = 10_Hz, .faulted_after = 1000}, [=]() -> Result<Number> {
          if (gives) return Number{1};
          return Error{Errc::io_failed, "no answer", "", "", ""};
        });
      };
      const Sensor<Number> adc = failing("adc", gives_some), mute = failing("mute", false);
      loop.advance(1s);
      CHECK(loop.close() == 0);
    }
    const Told both = told(app::compare, {.database = path, .first = "1", .second = "2"});
    for (const char* part : {"\nadc: 0 and ", "\n  1: in the whole run the topic lost 11 ticks\n  field",
                             "\nmute: 0 and 0 events\n  1: in the whole run the topic lost 11 ticks\n"
                             "  2: in the whole run the topic lost 11 ticks\n"})
      CHECK_MESSAGE(has(both.out, part), both.out);
    const auto json = nlohmann::json::parse(
        told(app::compare, {.database = path, .first = "1", .second = "2", .show_as = app::ShowAs::json}).out);
    REQUIRE(json["topics"].size() == 3);
    CHECK(json["topics"][0]["lost"] == nlohmann::json::parse(R"(["11 ticks", ""])"));
    CHECK(json["topics"][2] == nlohmann::json::parse(R"({"topic": "mute", "origin": "", "events": [0, 0],
        "lost": ["11 ticks", "11 ticks"], "pruned": [0, 0], "fields": []})"));
    const Told one = told(app::compare, {.database = path, .first = "1", .second = "1"});
    CHECK_MESSAGE(has(one.out, "\nmute: 0 and 0 events\n"), one.out);
  }
}
