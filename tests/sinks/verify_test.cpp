#include "rtdata/recording/verify.hpp"

#include <doctest/doctest.h>

#include <chrono>
#include <csignal>
#include <nlohmann/json.hpp>
#include <sstream>

#include "app/core/recording_commands.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/lane_sensor.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "recording/positions.hpp"
#include "rtdata/sensors/derived.hpp"
#include "rtdata/sensors/limit.hpp"
#include "rtdata/sensors/trigger.hpp"
#include "sanitized.hpp"
#include "sinks/killed.hpp"
#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace recordings;

TEST_SUITE_BEGIN("sinks");

namespace {

/// What verify says after the change; the recording was balanced before.
std::string after(const std::string& change) {
  const Folder folder;
  const std::string path = make(folder);
  REQUIRE_MESSAGE(verified(path).exit_code() == 0, verified(path).text());
  sql(path, change);
  const VerifyReport report = verified(path);
  CHECK(report.verdict() == Verdict::not_balanced);
  CHECK(report.exit_code() == 1);
  return problems_of(report);
}

bool has(const std::string& text, const std::string& part) {
  const bool found = text.find(part) != std::string::npos;
  if (!found) MESSAGE("\"", part, "\" is not in: ", text);
  return found;
}

}  // namespace

TEST_CASE("US-26 a column or a view that is damaged is found") {
  CHECK(has(after("ALTER TABLE \"room/climate\" RENAME COLUMN temperature TO tempesature"),
            "room/climate: the table has a column \"tempesature\", which is not one of the topic's.\n"
            "room/climate: the table has no column \"temperature\"."));
  CHECK(has(after("DROP VIEW rtdata_run_utc; CREATE VIEW rtdata_run_utc AS SELECT rum FROM rtdata_run"),
            "The view rtdata_run_utc is damaged: no such column: rum."));
  const auto exchanged = [](const std::string& a, const std::string& b) {
    const std::string rename = "ALTER TABLE \"room/climate\" RENAME COLUMN ";
    return rename + a + " TO z;" + rename + b + " TO " + a + ";" + rename + "z TO " + b;
  };
  CHECK(after(exchanged("temperature", "humidity")) ==
        "room/climate~1s: the table has other columns than those of steps of room/climate.\n"
        "room/climate~1min: the table has other columns than those of steps of room/climate.\n"
        "room/climate: column 6 of the table is \"humidity\", where \"temperature\" was recorded: names of columns "
        "were exchanged.\n");
  CHECK(has(after("DROP VIEW \"room/climate~utc\"; " + exchanged("time", "sequence")),
            "column 2 of the table is \"sequence\", where \"time\" was"));
}

TEST_CASE("US-26 a position of a sender that is of nothing recorded is found") {
  const auto position = [](const std::string& table, int run, const std::string& origin, const std::string& sequence) {
    return std::string(sqlite::position_schema) + "INSERT INTO rtdata_position VALUES('peer', '', 0, 0, '#', 0, 'h');" +
           "INSERT INTO rtdata_position VALUES('peer', '" + table + "', 7, " + std::to_string(run) + ", '" + origin +
           "', " + sequence + ", 'h')";
  };
  const std::string last = "(SELECT last_sequence FROM rtdata_ledger WHERE origin = 'room')";
  const Folder folder;
  const std::string path = make(folder);
  sql(path, position("room/climate", 1, "room", last));
  CHECK_MESSAGE(verified(path).exit_code() == 0, verified(path).text());
  sql(path, "UPDATE rtdata_position SET run = 0, origin = '', sequence = 0");  // before the first row
  CHECK(verified(path).exit_code() == 0);
  CHECK(has(after(position("room/climate", 1, "room", last + " + 1")),
            "rtdata_position: sink peer has table \"room/climate\" up to sequence "));
  CHECK(has(after(position("room/climate", 1, "rom", "1")), "of origin rom in run 1, which was never recorded."));
  CHECK(has(after(position("room/climate", 2, "room", "1")), "of origin room in run 2, which was never recorded."));
  CHECK(has(after(position("room/climat", 1, "room", "1")), "sink peer has table \"room/climat\" up to sequence 1 "));
}

namespace {

struct Narrow {
  double b = 0;
  RTDATA_FIELDS(Narrow, (b, "m"))
};
struct Wide {
  double a = 0, b = 0;
  RTDATA_FIELDS(Wide, (a, "m"), (b, "m"))
};

}  // namespace

TEST_CASE("US-26 a column that a later run added before others is no damage, whether its rows are there or pruned") {
  const Folder folder;
  const std::string path = folder / "run.db";
  const auto record = [&](auto payload, int events, std::uint64_t max_bytes) {
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path, .max_bytes = max_bytes});
    Feed<decltype(payload)> feed(loop, {.name = "feed", .topic = "a"});
    for (int i = 0; i < events; ++i) {
      feed.publish(payload);
      if (i % 100 == 0) loop.advance(1s);
    }
    CHECK(loop.close() == 0);
  };
  record(Narrow{1}, 300, 0);
  record(Wide{2, 3}, 300, 0);
  CHECK(verified(path).exit_code() == 0);
  record(Wide{2, 3}, 200'000, SqliteConfig::least_max_bytes);
  CHECK(number(path, "SELECT min(run) FROM a") == 3);
  CHECK(verified(path).exit_code() == 0);
  CHECK(number(path, "SELECT cid FROM pragma_table_info('a') WHERE name = 'a'") == 6);
}

TEST_CASE(
    "US-26 a recording is balanced when a sensor is stopped or re-rated by the handler of the error at its opening") {
  const Folder folder;
  const std::string path = folder / "run.db";
  bool stops = false;
  SUBCASE("stopped") { stops = true; }
  SUBCASE("re-rated") { stops = false; }
  {
    Loop loop{Loop::Manual{}};
    loop.runtime().on_log([](const LogRecord&) {});
    SqliteSink sink(loop, {.path = path});
    bool is_bad = false;
    struct Device {
      bool& is_bad;
      Result<void> open() {
        if (is_bad) return Error{Errc::not_found, "no device", "", "", ""};
        return {};
      }
      Result<Climate> read() {
        if (is_bad) return Error{Errc::io_failed, "gone", "", "", ""};
        return Climate{1, 2};
      }
    };
    Sensor<Climate> sensor(loop, {.name = "s", .rate = 10_Hz, .faulted_after = 1, .retry_first = 200ms},
                           Device{is_bad});
    sensor.on_error([&](const ErrorReport& report) {
      if (report.error.code != Errc::not_found) return;
      if (stops) {
        sensor.stop();
      } else {
        is_bad = false;
        sensor.set_rate(20_Hz);
      }
    });
    loop.advance(1s);
    is_bad = true;
    loop.advance(1s);
    is_bad = false;
    sensor.start();
    loop.advance(1s);
    loop.close();
  }
  const VerifyReport report = verified(path);
  CHECK_MESSAGE(report.verdict() == Verdict::balanced, report.text());
}

TEST_CASE("US-26 a recording is balanced, with its failures and missed ticks") {
  const Folder folder;
  const VerifyReport report = verified(make(folder));
  REQUIRE(report.runs.size() == 1);
  const RunReport& run = report.runs[0];
  CHECK_MESSAGE(report.verdict() == Verdict::balanced, report.text());
  CHECK(problems_of(report) == "");
  CHECK(run.failed == 2);
  CHECK(run.missed == 4);
  CHECK(run.gaps == 2);
  CHECK(run.origins == 2);
  CHECK(run.rows == run.stored);
  CHECK(run.stored == run.scheduled - 6 + 2);
  CHECK(has(report.text(), "does not prove"));
}

TEST_CASE("US-26 verify and info tell outages of what has no schedule, with their time") {
  const Folder folder;
  const std::string path = folder / "run.db";
  {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    loop.runtime().on_log([](const LogRecord&) {});
    SqliteSink sink(loop, {.path = path});
    Feed<Climate> board(loop, {.name = "board", .topic = "lab/board"}), radio(loop, {.name = "radio"});
    const Error gone{Errc::disconnected, "cannot hear", "", "it is gone", ""};
    board.publish({1, 2});
    board.repeated();
    board.repeated();
    loop.advance(1s);
    board.fault(gone);
    loop.advance(6s);
    board.publish({1, 2});
    radio.fault(gone);
    loop.advance(40s);
    loop.close();
  }
  const VerifyReport report = verified(path);
  CHECK(report.verdict() == Verdict::balanced);
  REQUIRE(report.runs[0].outages.size() == 2);
  CHECK(report.runs[0].outages[0].origin == "radio");  // the longest first
  CHECK(report.runs[0].outages[0].outages.time == 40s);
  CHECK(report.runs[0].outages[1].outages.time == 6s);
  std::string text = report.text();
  std::replace(text.begin(), text.end(), '\n', ' ');
  for (std::size_t at; (at = text.find("   ")) != std::string::npos;) text.erase(at, 2);
  CHECK(
      has(text,
          "2 gaps: 2 outages of 46 s together, in which nothing came that could be recorded: radio (1 outage of 40 s), "
          "board on lab/board (1 outage of 6 s)"));
  const auto json = nlohmann::json::parse(report.to_json());
  CHECK(json["runs"][0]["outages"][1]["time_ns"] == 6'000'000'000);
  CHECK(json["runs"][0]["gaps"] == 2);
  std::ostringstream out, err;
  CHECK(app::info({.database = path}, out, err) == 0);
  CHECK(has(out.str(), "    ! 1 outage of 6 s; 2 repeated by the source, which is not a loss\n"));
  std::ostringstream as_json;
  CHECK(app::info({.database = path, .show_as = app::ShowAs::json}, as_json, err) == 0);
  CHECK(nlohmann::json::parse(as_json.str())["topics"][0]["repeated"] == 2);
}

TEST_CASE("US-26 the gaps of a run are as many in verify's text as in its JSON, with and without a schedule") {
  const Folder folder;
  const std::string path = folder / "run.db";
  {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    loop.runtime().on_log([](const LogRecord&) {});
    SqliteSink sink(loop, {.path = path});
    Feed<Climate> board(loop, {.name = "board"});
    int reads = 0;
    Sensor<Climate> room(loop, {.name = "room", .rate = 10_Hz}, [&]() -> Result<Climate> {
      if (++reads % 10 == 3) return Error{Errc::io_failed, "no answer", "", "", ""};
      return Climate{1, 2};
    });
    for (int i = 0; i < 3; ++i) {
      board.publish({1, 2});
      loop.advance(1s);
      board.fault({Errc::disconnected, "cannot hear", "", "it is gone", ""});
      loop.advance(1s);
    }
    loop.close();
  }
  const VerifyReport report = verified(path);
  CHECK(report.verdict() == Verdict::balanced);
  CHECK(report.runs[0].gaps == 9);
  CHECK(has(report.text(), "late; 9 gaps\n"));
  CHECK(nlohmann::json::parse(report.to_json())["runs"][0]["gaps"] == 9);
}

TEST_CASE(
    "US-26 verify of what is computed from others tells what these lost, as the run does, whatever is made first") {
  enum class First { sink, sources, derived };
  for (const First first : {First::sink, First::sources, First::derived}) {
    CAPTURE(static_cast<int>(first));
    const Folder folder;
    const std::string path = folder / "run.db", other = folder / "other.db";
    std::uint64_t failed = 0, lost = 0, outages = 0;
    {
      Loop loop{Loop::Manual{}};
      loop.on_error([](const ErrorReport&) {});
      loop.runtime().on_log([](const LogRecord&) {});
      SqliteSink sink, aside;
      const auto make_sinks = [&] {
        sink = SqliteSink(loop, {.path = path, .sink = {.topics = {"tenth", "trig", "alarm"}}});
        aside = SqliteSink(loop, {.path = other, .sink = {.topics = {"alone"}}});
      };
      Feed<Climate> daq;
      Sensor<Climate> adc, alone;
      int reads = 0;
      const auto make_sources = [&] {
        daq = Feed<Climate>(loop, {.name = "daq"});
        adc = Sensor<Climate>(loop, {.name = "adc", .rate = 10_Hz}, [&]() -> Result<Climate> {
          if (++reads % 10 < 4) return Error{Errc::io_failed, "no answer", "", "", ""};
          return Climate{1, 2};
        });
        alone = Sensor<Climate>(loop, {.name = "alone", .rate = 10_Hz}, [] { return Climate{1, 2}; });
      };
      DerivedSensor bar, tenth;
      TriggerSensor trig;
      LimitSensor alarm;
      const auto make_derived = [&] {
        bar = DerivedSensor(loop, {.name = "bar"}, {.on = "daq", .expression = "temperature * 10"});
        tenth = DerivedSensor(loop, {.name = "tenth"}, {.on = "bar", .expression = "value / 10"});
        alarm = LimitSensor(loop, {.name = "alarm"}, {.on = "daq", .field = "temperature", .high = 50});
      };
      if (first == First::sink) make_sinks();
      if (first == First::derived) make_derived();
      make_sources();
      if (first != First::derived) make_derived();
      trig = TriggerSensor(loop, {.name = "trig"}, {.on = "adc", .when = "temperature > 0"});
      if (first != First::sink) make_sinks();
      daq.lost(0);
      for (int i = 0; i < 20; ++i) {
        daq.publish({1.0 * i, 2});
        loop.advance(1s);
        daq.lost(3);
        if (i == 7) daq.fault({Errc::disconnected, "cannot hear", "", "it is gone", ""});
      }
      for (const SensorStatus& sensor : loop.runtime().sensors()) {
        failed += sensor.counts.failed;
        lost += sensor.counts.lost;
        outages += sensor.outages.number;
      }
      CHECK(loop.close() == 0);
    }
    CHECK(failed > 0);
    CHECK(lost == 60);
    CHECK(outages == 1);
    const VerifyReport report = verified(path);
    CHECK_MESSAGE(report.verdict() == Verdict::balanced, report.text());
    TopicLoss sum;
    for (const TopicLoss& loss : report.runs.at(0).losses) sum.add(loss);
    CHECK(sum.failed == failed);
    CHECK(sum.by_source == lost);
    CHECK(sum.outages.number == outages);
    CHECK(has(report.text(), "60 samples of daq (lost by the source 60)"));
    CHECK(number(path, "SELECT count(*) FROM rtdata_topic WHERE topic IN ('daq', 'adc', 'bar')") == 0);
    CHECK(number(path, "SELECT count(*) FROM rtdata_ledger WHERE topic IN ('daq', 'adc', 'bar')") == 3);
    CHECK(verified(other).runs.at(0).losses.empty());  // which has nothing to do with them
    CHECK(number(other, "SELECT count(*) FROM rtdata_ledger") == 1);
  }
}

TEST_CASE("US-26 verify says first of each run what was lost, of which topic and where, and what is not known") {
  const Folder folder;
  const std::string path = folder / "run.db";
  const auto first_lines = [&](const VerifyReport& report) {  // of the newest run
    const std::string text = report.text();
    const std::size_t heading = text.rfind("\nrun " + std::to_string(report.runs.back().info.run) + "  ");
    const std::size_t begin = text.find('\n', heading + 1) + 1;
    return text.substr(begin, text.find(" rows of ", begin) - begin);
  };
  {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    loop.runtime().on_log([](const LogRecord&) {});
    SqliteSink sink(loop, {.path = path});
    Feed<Climate> board(loop, {.name = "board", .topic = "lab/board"});
    Sensor<Climate> room(loop, {.name = "room", .topic = "room/climate", .rate = 10_Hz}, [] { return Climate{1, 2}; });
    board.publish({1, 2});
    loop.advance(1s);
    loop.close();
  }
  VerifyReport report = verified(path);
  CHECK(first_lines(report) ==
        "  nothing lost: 12 rows\n"
        "  not detectable: losses in the sources of lab/board, which do not number their\n"
        "                  samples\n"
        "  12");
  CHECK(report.runs.at(0).lines ==
        std::vector<std::string>{"nothing lost: 12 rows",
                                 "not detectable: losses in the sources of lab/board, which do not number their "
                                 "samples"});
  auto json = nlohmann::json::parse(report.to_json());
  CHECK(json["runs"][0]["nothing_lost"] == true);
  CHECK(json["runs"][0]["losses"].empty());
  CHECK(json["runs"][0]["lines"].size() == 2);
  CHECK(json["runs"][0]["not_detectable"] == nlohmann::json{"lab/board"});

  {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    loop.runtime().on_log([](const LogRecord&) {});
    SqliteSink sink(loop, {.path = path, .sink = {.queue_bytes = 256 << 10}});
    Feed<Climate> board(loop, {.name = "board", .topic = "lab/board"});
    bool fails = false;
    Sensor<Climate> room(loop, {.name = "room", .topic = "room/climate", .rate = 10_Hz}, [&]() -> Result<Climate> {
      if (fails) return Error{Errc::io_failed, "gone", "", "", ""};
      return Climate{1, 2};
    });
    board.set_numbered();
    for (int i = 0; i < 20000; ++i) board.publish({1, 2});
    board.lost(10);
    loop.advance(1s);
    board.publish({1, 2});
    fails = true;
    loop.advance(300ms);
    fails = false;
    board.fault({Errc::disconnected, "cannot hear", "", "it is gone", ""});
    loop.advance(1s);
    loop.close();
  }
  report = verified(path);
  CHECK(report.verdict() == Verdict::balanced);
  const std::uint64_t dropped = report.runs.at(1).dropped;
  REQUIRE(dropped > 0);
  std::string joined = first_lines(report);
  for (std::size_t at; (at = joined.find("\n        ")) != std::string::npos && joined[at + 9] != '3';)
    joined.replace(at, 9, " ");
  CHECK(has(joined, "  LOST: " + std::to_string(dropped + 10) +
                        " samples of lab/board (lost by the source 10, dropped "
                        "by the queue " +
                        std::to_string(dropped) +
                        ") and 1 outage of 1 s (the number of missing samples "
                        "is not known)\n"
                        "        3 ticks of room/climate (failed 3)\n"));
  json = nlohmann::json::parse(report.to_json());
  CHECK(json["runs"][0]["nothing_lost"] == true);  // what one run loses, no other has lost
  CHECK(json["runs"][1]["nothing_lost"] == false);
  REQUIRE(json["runs"][1]["losses"].size() == 2);
  CHECK(json["runs"][1]["losses"][0]["topic"] == "lab/board");
  CHECK(json["runs"][1]["losses"][1]["failed"] == 3);

  // A run that was not closed: the end of it is not known, and that is no promise that nothing was lost.
  written_as(path, "UPDATE rtdata_run SET state = 'recording', pid = 0 WHERE run = 2");
  report = verified(path);
  CHECK(has(first_lines(report), "LOST: "));
  CHECK(has(first_lines(report),
            "  NOT KNOWN: what it lost after its last account: it is not sealed yet; `rtdata\n"
            "             seal` seals it\n"));
  CHECK(report.exit_code() == 1);

  // One that is bad is so for good, and no later run is called bad for it.
  sql(path, "UPDATE rtdata_ledger SET stored = stored + 1 WHERE run = 1 AND topic = 'room/climate'");
  {
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path});
    Sensor<Climate> room(loop, {.name = "room", .topic = "room/climate", .rate = 10_Hz}, [] { return Climate{1, 2}; });
    loop.advance(1s);
    loop.close();
  }
  report = verified(path);
  REQUIRE(report.runs.size() == 3);
  CHECK(report.runs[0].verdict == Verdict::not_balanced);
  CHECK(report.runs[2].verdict == Verdict::balanced);
  CHECK(report.runs[2].lines == std::vector<std::string>{"nothing lost: 11 rows"});
  CHECK(report.exit_code() == 1);
  CHECK(has(report.text(),
            "\nrun 3: balanced: rows, gaps and schedule agree with the account.\n"
            "But run 1 is not balanced: see above. So the status is 1; `--run` looks at one\nrun.\n"));
  CHECK(nlohmann::json::parse(report.to_json())["runs"][1]["not_known"].size() == 1);
}

TEST_CASE("US-26 verify does not know what was lost on a tier that hung when the program was killed") {
  const Folder folder;
  const std::string path = folder / "run.db";
  for (const bool turns_again : {false, true}) {
    sinks::killed_in([&] {
      Loop loop{Loop::Manual{}};
      loop.on_error([](const ErrorReport&) {});
      loop.runtime().on_log([](const LogRecord&) {});
      const SqliteSink sink(loop, {.path = path});
      const Sensor<Climate> room(loop, {.name = "room", .rate = 10_Hz}, [] { return Climate{1, 2}; });
      loop.advance(3s);
      loop.core().runtime.health_changed("tier", "fast", Health::faulted, "does not turn");
      if (turns_again) loop.core().runtime.health_changed("tier", "fast", Health::ok, "");
      loop.advance(10s);
      ::raise(SIGKILL);
    });
  }
  {
    Loop loop{Loop::Manual{}};
    const SqliteSink sink(loop, {.path = path});
    loop.advance(1s);
  }
  const VerifyReport report = verified(path);
  REQUIRE(report.runs.size() == 3);
  REQUIRE(report.runs[0].not_known.size() == 1);
  CHECK(report.runs[0].not_known[0].starts_with("what the sensors of tier fast lost from 2023-11-14T22:13:23"));
  CHECK(report.runs[1].not_known.empty());
  CHECK(has(report.text(), "  NOT KNOWN: what the sensors of tier fast lost"));
}

TEST_CASE("US-26 verify names what was deleted, added or changed in the rows") {
  CHECK(has(after("DELETE FROM \"room/climate\" WHERE sequence = 417"),
            "room/climate, origin room: 998 rows, the ledger says 999 stored; sequence 417 is missing."));
  CHECK(has(after("DELETE FROM \"room/climate\" WHERE sequence = 1"), "sequence 1 is missing"));
  CHECK(has(after("DELETE FROM \"room/climate\" WHERE sequence = 999"), "sequence 999 is missing"));
  CHECK(has(after("DELETE FROM \"room/climate\" WHERE sequence BETWEEN 10 AND 12 OR sequence = 20"),
            "sequences 10 to 12 and 20 are missing"));
  CHECK(
      has(after("DELETE FROM \"room/climate\""), "0 rows, the ledger says 999 stored; sequences 1 to 999 are missing"));
  CHECK(has(after("INSERT INTO \"room/climate\" SELECT run, time + 1000, origin, sequence + 1, NULL, temperature, "
                  "humidity "
                  "FROM \"room/climate\" WHERE "
                  "sequence = 999"),
            "1000 rows, the ledger says 999 stored; sequence 1000 was never offered, the last was 999"));
  CHECK(has(after("INSERT INTO \"room/climate\" SELECT run, time, origin, sequence, NULL, temperature, humidity FROM "
                  "\"room/climate\" WHERE "
                  "sequence = 50"),
            "1000 rows, the ledger says 999 stored"));
  CHECK(has(after("UPDATE \"room/climate\" SET sequence = 2000 WHERE sequence = 999"),
            "its last sequence is 2000, the ledger says 999"));
  CHECK(has(after("UPDATE \"room/climate\" SET sequence = 499 WHERE sequence = 500"),
            "sequence 499 follows 499: it is there twice"));
  CHECK(has(after("UPDATE \"room/climate\" SET sequence = 600 WHERE sequence = 500"),
            "sequence 501 follows 600, but sequences ascend"));
  CHECK(has(after("UPDATE \"room/climate\" SET time = time - 20000000 WHERE sequence = 500"),
            "the time of sequence 500"));
  CHECK(has(after("UPDATE \"room/climate\" SET time = time + 3600000000000 WHERE sequence = 999"),
            "lies outside of the run"));
  CHECK(has(after("UPDATE \"room/climate\" SET origin = 'rooms' WHERE sequence = 500"),
            "origin rooms: 1 row, but the ledger does not know it"));
  CHECK(has(after("UPDATE \"room/climate\" SET run = 7 WHERE sequence = 500"),
            "1 row of run 7, which is not in the list of runs"));
}

TEST_CASE("US-26 verify notices that a whole run is missing, but not that the newest are") {
  const Folder folder;
  const std::string path = folder / "run.db";
  for (int run = 1; run <= 5; ++run) make(folder);
  REQUIRE_MESSAGE(verified(path).exit_code() == 0, verified(path).text());
  CHECK(number(path, "SELECT count(*) FROM rtdata_run") == 5);
  const auto without = [&](const std::string& runs) {
    const std::string changed = folder / "changed.db";
    std::filesystem::copy_file(path, changed, std::filesystem::copy_options::overwrite_existing);
    auto database = sqlite::Database::open(changed, sqlite::Database::Mode::write);
    std::vector<std::string> tables;
    auto query = database.prepare(
        "SELECT m.name FROM sqlite_schema m, pragma_table_info(m.name) c WHERE m.type = 'table' "
        "AND c.name = 'run'");
    while (query.step()) tables.emplace_back(query.text(0));
    CHECK(tables.size() > 9);
    query = {};
    for (const std::string& table : tables)
      database.execute("DELETE FROM " + sqlite::quoted(table) + " WHERE run IN (" + runs + ")");
    database = {};
    return problems_of(verified(changed));
  };
  CHECK(without("3") == "Run 3 is not there, and not among the runs that rtdata_deleted counts.\n");
  CHECK(without("1, 2, 4") ==
        "Runs 1 to 2 are not there, and not among the runs that rtdata_deleted counts.\n"
        "Run 4 is not there, and not among the runs that rtdata_deleted counts.\n");
  CHECK(without("4, 5") == "");
  CHECK(has(without("1, 2, 3, 4, 5"), "room/climate: it came with run 1, which is newer than all that are there."));
}

TEST_CASE("US-26 verify notices every edited count of the ledger, the schedule and the gaps") {
  for (const char* column : {"scheduled", "taken", "missed", "failed", "in_flight", "published", "repeated", "filtered",
                             "offered", "stored", "dropped_newest", "dropped_oldest", "dropped_refused",
                             "dropped_unsaved", "first_sequence", "last_sequence", "pruned"}) {
    INFO(column);
    CHECK(after(std::string("UPDATE rtdata_ledger SET ") + column + " = " + column + " + 1 WHERE origin = 'room'") !=
          "");
  }
  for (const char* column : {"received", "published", "repeated", "filtered", "failed"}) {
    INFO(column);
    CHECK(after(std::string("UPDATE rtdata_ledger SET ") + column + " = " + column +
                " + 1 WHERE origin = 'program feed'") != "");
  }
  CHECK(has(after("DELETE FROM rtdata_gap WHERE kind = 'missed'"), "the gaps have 0 missed, the ledger says 4"));
  CHECK(has(after("DELETE FROM rtdata_gap WHERE kind = 'failed'"), "the gaps have 0 failed, the ledger says 2"));
  CHECK(has(after("UPDATE rtdata_gap SET count = 6 WHERE kind = 'failed'"), "has 6 ticks, up to"));
  CHECK(has(after("UPDATE rtdata_gap SET first = first + 1"), "does not begin at a tick"));
  CHECK(has(after("UPDATE rtdata_gap SET origin = 'nobody'"), "nobody: 2 gaps, but the ledger does not know it"));
  CHECK(has(after("DELETE FROM rtdata_schedule"), "the schedule has 0 ticks"));
  CHECK(has(after("UPDATE rtdata_schedule SET scheduled = scheduled + 1"), "makes 1005"));
  CHECK(has(after("UPDATE rtdata_schedule SET period = period * 2"), "every 20 ms"));
  CHECK(has(after("INSERT INTO rtdata_schedule SELECT run, origin, topic, first_due + 1000000000, period, end, "
                  "scheduled, late_after FROM rtdata_schedule"),
            "overlaps the one before"));
  CHECK(has(after("DELETE FROM rtdata_ledger WHERE origin = 'room'"), "999 rows, but the ledger does not know it"));
}

TEST_CASE("US-26 a recording that began after its sensors, and ended before them, balances") {
  const Folder folder;
  const std::string path = folder / "run.db";
  {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    int reads = 0;
    Sensor<Climate> sensor(loop, {.name = "s", .rate = 100_Hz}, [&]() -> Result<Climate> {
      if (++reads % 7 == 0) return Error{Errc::io_failed, "no answer", "", "", ""};
      return Climate{};
    });
    loop.run_for(101ms);
    for (const Rate rate : {200_Hz, 50_Hz, 100_Hz}) {
      sensor.set_rate(rate);
      loop.run_for(101ms);
      SqliteSink sink(loop, {.path = path});
      loop.run_for(105ms);
      loop.manual_clock().pass(60ms);
      loop.run_for(20ms);
    }
    CHECK(loop.close() == 0);
  }
  const VerifyReport report = check_balanced(path);
  REQUIRE(report.runs.size() == 3);
  for (const RunReport& run : report.runs) {
    CAPTURE(run.info.run);
    CHECK(run.notes.empty());
    CHECK(run.failed > 0);
    CHECK(run.missed > 0);
    const std::string of_run = " WHERE run = " + std::to_string(run.info.run);
    CHECK(number(path, "SELECT sum(scheduled) FROM rtdata_schedule" + of_run) ==
          static_cast<std::int64_t>(run.scheduled));
    CHECK(number(path, "SELECT published - offered FROM rtdata_ledger" + of_run) == 0);
  }
  sql(path, "DELETE FROM rtdata_gap WHERE rowid = (SELECT max(rowid) FROM rtdata_gap WHERE run = 2)");
  CHECK(has(problems_of(verified(path)), "the gaps have"));
  sql(path, "UPDATE rtdata_schedule SET end = end - period, scheduled = scheduled - 1 WHERE run = 3");
  CHECK(has(problems_of(verified(path)), "the schedule has"));
}

TEST_CASE("US-26 a sensor that was silent and stopped before the recording, and started again in it, balances") {
  const Folder folder;
  const std::string path = folder / "run.db";
  {
    Loop loop{Loop::Manual{}};
    bool is_silent = true;
    Sensor<Climate> sensor(loop, {.name = "s", .rate = 100_Hz}, [&]() -> Reading<Climate> {
      if (is_silent) return nothing_new;
      return Climate{};
    });
    loop.advance(105ms);
    sensor.stop();
    loop.advance(10ms);
    SqliteSink sink(loop, {.path = path});
    loop.advance(10ms);
    is_silent = false;
    sensor.start();
    loop.advance(50ms);
    CHECK(loop.close() == 0);
  }
  const VerifyReport report = check_balanced(path);
  CHECK(report.runs.at(0).scheduled == 6);
}

TEST_CASE("US-26 the account has no stretch without ticks, which a later one may begin before") {
  const Folder folder;
  const std::string path = folder / "run.db";
  {
    Loop loop{Loop::Manual{}};
    Sensor<Climate> sensor(loop, {.name = "s", .rate = 1_Hz}, [] { return Climate{}; });
    loop.advance(2100ms);
    SqliteSink sink(loop, {.path = path, .sink = {.batch_time = 10ms}});
    loop.advance(100ms);  // told of, and without a tick since the recording began
    sensor.set_rate(100_Hz);
    loop.advance(50ms);
    sensor.set_rate(1_Hz);
    loop.advance(100ms);  // as above
    sensor.set_rate(50_Hz);
    loop.advance(2s);
    CHECK(loop.close() == 0);
  }
  check_balanced(path);
  CHECK(number(path, "SELECT count(*) FROM rtdata_schedule WHERE scheduled = 0") == 0);
}

TEST_CASE("US-26 a read that was under way when the recording began is carried into it") {
  const Folder folder;
  const std::string path = folder / "run.db";
  bool fails = false;
  bool is_re_rated = false;
  SUBCASE("and published") {}
  SUBCASE("and failed, with others after it") { fails = true; }
  SUBCASE("of a schedule that was over") { is_re_rated = true; }
  {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    loop.script_lane_duration(30ms);
    lane_sensor::LaneSensor<Climate> sensor(loop, {.name = "s", .rate = 10_Hz, .faulted_after = 1000},
                                            {.fail_every = fails ? 1 : 0});
    loop.advance(205ms);
    REQUIRE(sensor.counts().in_flight == 1);
    if (is_re_rated) sensor.set_rate(20_Hz);
    loop.advance(2ms);
    {
      SqliteSink sink(loop, {.path = path});
      loop.advance(1s);
      sink.close();
    }
    loop.advance(1s);
    CHECK(loop.close() == 0);
  }
  check_balanced(path);
  CHECK(number(path, "SELECT carried FROM rtdata_ledger") == 1);
  const std::int64_t scheduled = number(path, "SELECT scheduled FROM rtdata_ledger");
  CHECK(scheduled == (is_re_rated ? 20 : 10));
  CHECK(number(path, "SELECT taken + failed + missed + in_flight FROM rtdata_ledger") == scheduled + 1);
  sql(path, "UPDATE rtdata_ledger SET carried = 0");
  CHECK(has(problems_of(verified(path)), "scheduled is"));
  sql(path, "UPDATE rtdata_ledger SET carried = 2, scheduled = scheduled - 1");
  CHECK(has(problems_of(verified(path)), "2 reads were under way when it began, but at most one is possible."));
}

TEST_CASE("US-26 a recording that a sensor's own reading function opens, or closes, balances") {
  const Folder folder;
  const std::string path = folder / "run.db";
  bool is_re_rated = false;
  bool is_closed = false;
  bool fails = false;
  SUBCASE("opened") {}
  SUBCASE("opened, with a change of rate") { is_re_rated = true; }
  SUBCASE("opened, and failed") { fails = true; }
  SUBCASE("opened and closed later, with changes of rate") { is_re_rated = is_closed = true; }
  {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    SqliteSink sink;
    int reads = 0;
    Sensor<Climate> sensor;
    sensor = Sensor<Climate>(loop, {.name = "s", .rate = 10_Hz}, [&]() -> Result<Climate> {
      ++reads;
      if (reads == 5) {
        loop.manual_clock().pass(5ms);
        if (is_re_rated) sensor.set_rate(1_kHz);
        sink = SqliteSink(loop, {.path = path});
        if (fails) return Error{Errc::io_failed, "no answer", "", "", ""};
      }
      if (reads == 50 && is_closed) {
        sensor.set_rate(10_Hz);
        sink.close();
      }
      return Climate{};
    });
    loop.advance(1s);
    CHECK(loop.close() == 0);
  }
  check_balanced(path);
  CHECK(number(path, "SELECT carried FROM rtdata_ledger") == 1);
}

TEST_CASE("US-26 a rate that is changed while a read is under way that fails then divides the gap") {
  const Folder folder;
  const std::string path = folder / "run.db";
  {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    loop.script_lane_duration(30ms);
    SqliteSink sink(loop, {.path = path});
    lane_sensor::LaneSensor<Climate> sensor(loop, {.name = "s", .rate = 10_Hz, .faulted_after = 1000},
                                            {.fail_every = 1});
    loop.advance(205ms);
    REQUIRE(sensor.counts().in_flight == 1);
    sensor.set_rate(20_Hz);
    loop.advance(1s);
    CHECK(loop.close() == 0);
  }
  check_balanced(path);
  CHECK(number(path, "SELECT count(*) FROM rtdata_gap WHERE kind = 'failed'") >= 3);
}

TEST_CASE("US-26 what a handler of errors publishes when a recording is closed is in it") {
  const Folder folder;
  const std::string path = folder / "run.db";
  {
    Loop loop{Loop::Manual{}};
    Feed<Climate> alarms(loop, {.name = "alarms"});
    int reports = 0;
    loop.on_error([&](const ErrorReport&) {
      ++reports;
      alarms.publish({});
    });
    Sensor<Climate> fails(loop, {.name = "f", .rate = 10_Hz, .faulted_after = 1000}, []() -> Result<Climate> {
      return Error{Errc::io_failed, "no answer", "", "", ""};
    });
    SqliteSink sink(loop, {.path = path});
    loop.advance(1500ms);  // one report is written, the others are held back
    const int before = reports;
    sink.close();
    CHECK(reports == before + 1);
    CHECK(loop.close() == 0);
  }
  check_balanced(path);
  CHECK(number(path, "SELECT count(*) FROM alarms") >= 2);
}

TEST_CASE("US-26 a rate changed again and again in one long turn makes stretches of schedule that do not overlap") {
  const Folder folder;
  const std::string path = folder / "run.db";
  {
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path});
    Sensor<Climate> sensor(loop, {.name = "s", .rate = 1_kHz}, [] { return Climate{}; });
    Timer longer(loop, 5ms, [&] {
      for (int i = 0; i < 6; ++i) {
        loop.manual_clock().pass(700us);
        sensor.set_rate(i % 2 == 0 ? 500_Hz : 1_kHz);
      }
      sensor.stop();
      sensor.start();
    });
    loop.run_for(100ms);
    CHECK(loop.close() == 0);
  }
  check_balanced(path);
  CHECK(number(path, "SELECT sum(scheduled) FROM rtdata_schedule") > 90);
}

TEST_CASE("US-26 a run that ended without closing is reported as such, and held to its last account") {
  const Folder folder;
  const std::string path = make(folder);
  written_as(
      path,
      "UPDATE rtdata_run SET state = 'recording', boot_id = '00000000-0000-0000-0000-000000000000'; UPDATE rtdata_utc "
      "SET boot_id = '00000000-0000-0000-0000-000000000000'");
  VerifyReport report = verified(path);
  CHECK(report.verdict() == Verdict::unsealed);
  CHECK(report.exit_code() == 1);
  CHECK(has(report.text(), "not sealed"));
  CHECK(report.text().find("consistent with itself") == std::string::npos);
  // Rows after the last account are no mistake, a row missing from before it is.
  written_as(path, "UPDATE rtdata_ledger SET rows_up_to = 900, stored = 900 WHERE origin = 'room'");
  report = verified(path);
  CHECK(problems_of(report) == "");
  CHECK(has(report.text(), "99 rows came after the last account"));
  sql(path, "DELETE FROM \"room/climate\" WHERE sequence = 300");
  CHECK(has(problems_of(verified(path)), "899 rows, the ledger says 900 stored; sequence"));
}

TEST_CASE("US-26 a run that is being recorded by a living process is no mistake") {
  const Folder folder;
  const std::string path = make(folder);
  std::ifstream boot("/proc/sys/kernel/random/boot_id");
  std::string boot_id;
  std::getline(boot, boot_id);
  written_as(path, "UPDATE rtdata_run SET state = 'recording', boot_id = '" + boot_id + "', pid = " +
                       std::to_string(::getpid()) + "; UPDATE rtdata_utc SET boot_id = '" + boot_id + "'");
  const VerifyReport report = verified(path);
  CHECK(report.verdict() == Verdict::recording);
  CHECK(report.exit_code() == 0);
  CHECK(has(report.text(), "is still recording"));
}

TEST_CASE("US-26 a copy of the file alone, made while it was recorded, is told; one with its log is as the recording") {
  const Folder folder;
  const std::string path = folder / "run.db", alone = folder / "alone.db", whole = folder / "whole.db";
  int ready[2] = {};
  REQUIRE(::pipe(ready) == 0);
  const pid_t child = sinks::fork_without_threads();
  if (child == 0) {
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path});
    Feed<Climate> feed(loop, {.name = "feed"});
    for (int i = 0; i < 10; ++i) {
      feed.publish({1.0 * i, 40});
      loop.advance(std::chrono::seconds{1});
    }
    (void)!::write(ready[1], "x", 1);
    for (;;) ::pause();
  }
  char byte = 0;
  REQUIRE(::read(ready[0], &byte, 1) == 1);
  std::filesystem::copy_file(path, alone);
  std::filesystem::copy_file(path, whole);
  std::filesystem::copy_file(path + "-wal", whole + "-wal");
  const VerifyReport of_path = verified(path), of_alone = verified(alone), of_whole = verified(whole);
  ::kill(child, SIGKILL);
  REQUIRE(::waitpid(child, nullptr, 0) == child);
  for (const int end : ready) ::close(end);
  for (const VerifyReport* report : {&of_path, &of_whole}) {
    CHECK(report->verdict() == Verdict::recording);
    CHECK(report->runs.at(0).rows == 10);
    CHECK(has(report->runs.at(0).notes.back(), " is still recording"));
  }
  CHECK(of_alone.verdict() == Verdict::unsealed);
  CHECK(of_alone.exit_code() == 1);
  CHECK(problems_of(of_alone) == "");
  CHECK(of_alone.runs.at(0).rows == 0);
  CHECK(has(of_alone.runs.at(0).notes.at(0), "of which this is a copy without its WAL file (-wal)"));
  CHECK(has(of_alone.runs.at(0).lines.at(0), "nothing lost that is known"));
  CHECK(has(of_alone.runs.at(0).not_known.at(0), "this is a copy, made while it was recorded"));
}

TEST_CASE("US-26 a sealed run says what was lost, and is exit code 0 as long as its rows agree") {
  const Folder folder;
  const std::string path = make(folder);
  written_as(path,
             "UPDATE rtdata_run SET state = 'sealed', lost = 3, remark = 'killed';"
             "DELETE FROM \"room/climate\" WHERE sequence > 996;"
             "UPDATE rtdata_ledger SET stored = 996, dropped_unsaved = 3 WHERE origin = 'room';" +
                 drop_steps);
  VerifyReport report = verified(path);
  CHECK_MESSAGE(report.verdict() == Verdict::sealed, report.text());
  CHECK(report.exit_code() == 0);
  CHECK(report.runs.at(0).unsaved == 3);
  CHECK(has(report.text(), "3 events"));
  sql(path, "DELETE FROM \"room/climate\" WHERE sequence = 5");
  report = verified(path);
  CHECK(report.exit_code() == 1);
  CHECK(has(problems_of(report), "995 rows, the ledger says 996 stored"));
}

TEST_CASE("US-26 the subcommand verify prints at most 80 columns, or JSON, and returns 0, 1 or 2") {
  const Folder folder;
  const std::string path = make(folder);
  std::ostringstream out, err;
  CHECK(app::verify({.database = path}, out, err) == 0);
  CHECK(err.str() == "");
  std::istringstream lines(out.str());
  for (std::string line; std::getline(lines, line);) CHECK_MESSAGE((line.size() <= 80 || line == path), line);
  out.str("");
  sql(path, "DELETE FROM \"room/climate\" WHERE sequence = 417");
  CHECK(app::verify({.database = path, .show_as = app::ShowAs::json}, out, err) == 1);
  std::ostringstream text;
  CHECK(app::verify({.database = path}, text, err) == 1);
  CHECK(has(text.str(), "not balanced: see above."));
  CHECK_FALSE(text.str().find("consistent with itself") != std::string::npos);
  const auto json = nlohmann::json::parse(out.str());
  CHECK(json["verdict"] == "not balanced");
  CHECK(json["exit_code"] == 1);
  CHECK(json["runs"][0]["rows"] == 1000);
  CHECK(json["runs"][0]["stored"] == 1001);
  CHECK(json["runs"][0]["problems"].size() == 4);  // the checksum, and a step of each length, too
  CHECK(app::verify({.database = folder / "nothing.db"}, out, err) == 2);
  CHECK(has(err.str(), "nothing.db"));
}

TEST_CASE("US-26 a million rows are verified in one pass") {
  const Folder folder;
  const std::string path = make(folder);
  constexpr std::uint64_t rows = rtdata::test::sanitized ? 100'000 : 1'000'000;
  const std::string all = std::to_string(rows), each = std::to_string(rows / 2);
  written_as(
      path, "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < " + all +
                ") INSERT INTO \"room/climate\" "
                "SELECT r.run, "
                "(SELECT max(time) FROM \"room/climate\") - 2000000 + i, CASE i % 2 WHEN 0 THEN 'even' ELSE 'odd' END, "
                "(i + 1) / "
                "2, NULL, i, 40 FROM n, rtdata_run r;"
                "INSERT INTO rtdata_ledger(run, topic, origin, slot, has_schedule, scheduled, taken, missed, failed, "
                "in_flight, "
                "late, received, published, "
                "repeated, filtered, offered, stored, dropped_newest, dropped_oldest, dropped_refused, first_sequence, "
                "last_sequence) "
                "SELECT run, 'room/climate', o.column1, 9, 0, 0, 0, 0, 0, 0, 0, " +
                each + ", " + each + ", 0, 0, " + each + ", " + each + ", 0, 0, 0, 1, " + each +
                " "
                "FROM rtdata_run, (VALUES('even'), ('odd')) o;");
  const auto began = std::chrono::steady_clock::now();
  const VerifyReport report = verified(path);
  const auto checked = std::chrono::steady_clock::now();
  const auto topics = summary(Recording::open(path).or_throw(), 1).or_throw();
  const auto summed = std::chrono::steady_clock::now();
  MESSAGE("verify: ", (checked - began) / 1ms, " ms, summary: ", (summed - checked) / 1ms, " ms");
  CHECK_MESSAGE(report.verdict() == Verdict::balanced, report.text());
  CHECK(report.runs.at(0).rows == rows + 1'001);
}

TEST_SUITE_END();
