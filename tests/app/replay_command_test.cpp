// `rtdata replay`: a recording's runs to the sinks of a configuration, and to the terminal.
#include <doctest/doctest.h>

#include <filesystem>

#include "app/process.hpp"
#include "paths.hpp"
#include "recording/database.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/recording/verify.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "sinks/http_bench.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using namespace std::chrono_literals;
using rtdata::test::Folder;
using rtdata::test::Process;

namespace {

using rtdata::test::program;

struct Warmth {
  double temperature = 0;
  RTDATA_FIELDS(Warmth, (temperature, "Cel"))
};
struct Kelvin {
  double temperature = 0;
  RTDATA_FIELDS(Kelvin, (temperature, "K"))
};

/// A run of a second whose clock is set by an hour, then one whose topic has another unit.
std::string recorded(const Folder& folder) {
  const std::string path = folder.path() + "/run.db";
  {
    Loop loop{Loop::Manual{}};
    loop.runtime().on_log([](const LogRecord&) {});
    SqliteSink sink(loop, {.path = path});
    Sensor<Warmth> room(loop, {.name = "room", .rate = 10_Hz}, [] { return Warmth{21}; });
    loop.advance(500ms);
    loop.manual_clock().set_realtime(loop.manual_clock().realtime() + 1h);
    loop.advance(500ms);
    room.close();
    CHECK(loop.close() == 0);
  }
  Loop loop{Loop::Manual{}};
  SqliteSink sink(loop, {.path = path});
  Feed<Kelvin> room(loop, {.name = "room"});
  room.publish({294});
  loop.advance(10ms);
  room.publish({295});
  room.close();
  CHECK(loop.close() == 0);
  return path;
}

/// A run of `seconds` with 10 events a second.
void record(const Folder& folder, int seconds) {
  Loop loop{Loop::Manual{}};
  SqliteSink sink(loop, {.path = folder.path() + "/run.db"});
  Sensor<Warmth> room(loop, {.name = "room", .rate = 10_Hz}, [] { return Warmth{21}; });
  loop.advance(std::chrono::seconds{seconds} - 50ms);
  room.close();
  CHECK(loop.close() == 0);
}

std::vector<Time> utc_of(const std::string& path) {
  const auto recording = Recording::open(path).or_throw();
  auto rows = recording.rows({}).or_throw();
  std::vector<Time> all;
  while (const RecordedRow* row = rows.next().or_throw())
    all.push_back(recording.utc_line(row->run()).or_throw().utc(row->header().time));
  return all;
}

}  // namespace

TEST_SUITE_BEGIN("app");

TEST_CASE("FW-5 replay: all runs into another recording, which is a copy, in UTC too") {
  const Folder folder;
  const std::string path = recorded(folder);
  folder.write("again.json", R"({"sensors": [{"name": "cpu", "type": "host", "quantity": "cpu", "rate": "1 Hz"}],
                                 "sinks": [{"type": "sqlite", "path": "again.db"}]})");
  Process again(folder, program, {"replay", "run.db", "again.json", "--speed", "max"});
  CHECK(again.end() == 0);
  CHECK(again.err.find("1 sensor of again.json is not made") != std::string::npos);
  CHECK(again.err.find("not made: output") == std::string::npos);
  CHECK(again.err.find("has ended: 11 events and 0 gaps") != std::string::npos);
  const std::string copy = folder.path() + "/again.db";
  const auto report = verify(Recording::open(copy).or_throw()).or_throw();
  CHECK_MESSAGE(report.verdict() == Verdict::balanced, report.text());
  CHECK(report.runs.size() == 2);
  const auto utc = utc_of(path);
  CHECK(utc.size() == 13);
  CHECK(utc_of(copy) == utc);

  folder.write("set.json", R"({"sinks": [{"type": "sqlite", "path": "set.db"}], "outputs": [
    {"name": "fan", "type": "serial", "device": "/dev/null"},
    {"name": "heater", "type": "serial", "device": "/dev/zero"}]})");
  Process set(folder, program, {"replay", "run.db", "set.json", "--speed", "max"});
  (void)set.end();
  const std::string told = "not made: output fan, heater of set.json: a replay sets no device";
  const std::size_t first = set.err.find(told);
  CHECK_MESSAGE(first != std::string::npos, set.err);
  CHECK(set.err.find("not made", first + 1) == std::string::npos);  // once, though there are two runs
  Process quiet(folder, program, {"replay", "run.db", "set.json", "--speed", "max", "-q"});
  (void)quiet.end();
  CHECK(quiet.err.find("not made") == std::string::npos);

  Process itself(folder, program, {"replay", "again.db", "again.json", "--speed", "max"});
  CHECK(itself.end() == 1);
  CHECK(itself.err.find("sink again.db records into it") != std::string::npos);
}

TEST_CASE("FW-5 US-34 replay: at any speed, beside a live run, each run keeps its own UTC") {
  const Folder folder;
  const std::string path = recorded(folder);
  const std::vector<Time> old_utc = utc_of(path);
  const std::string live = folder.path() + "/live.db";
  {
    Loop loop;
    SqliteSink sink(loop, {.path = live});
    Feed<Warmth> room(loop, {.name = "room"});
    room.publish({22});
    room.close();
    CHECK(loop.close() == 0);
  }
  std::vector<Time> expected = utc_of(live);
  REQUIRE(!expected.empty());
  const auto boot_of = [&](std::int64_t run) {
    for (const RunInfo& info : Recording::open(live).or_throw().runs().or_throw())
      if (info.run == run) return info.boot_id;
    return std::string();
  };
  folder.write("live.json", R"({"sinks": [{"type": "sqlite", "path": "live.db"}]})");
  std::int64_t runs = 1;
  for (const char* speed : {"1", "20", "max"}) {
    CAPTURE(speed);
    Process again(folder, program, {"replay", "run.db", "live.json", "--speed", speed, "-q"});
    CHECK(again.end() == 0);
    expected.insert(expected.end(), old_utc.begin(), old_utc.end());
    CHECK(utc_of(live) == expected);
    runs += 2;
    CHECK(boot_of(runs - 1) != boot_of(1));
    CHECK(boot_of(runs) != boot_of(1));
    CHECK(boot_of(runs) != boot_of(runs - 1));
  }
  const auto recording = Recording::open(live).or_throw();
  const auto report = verify(recording).or_throw();
  CHECK_MESSAGE(report.verdict() == Verdict::balanced, report.text());
  CHECK(report.text().find("outside of the run") == std::string::npos);
  // What is known of the time of day is what was known, no more.
  const auto source = Recording::open(path).or_throw();
  for (std::int64_t run = 2; run <= runs; ++run)
    CHECK(recording.clock(run).or_throw().size() == source.clock(1 + run % 2).or_throw().size());
  // Faster than it was, it still is as long as what it has.
  const auto lasted = [](const Recording& of, std::int64_t run) {
    const auto infos = of.runs().or_throw();
    const RunInfo& info = infos.at(static_cast<std::size_t>(run - 1));
    return *info.ended - info.started;
  };
  CHECK(lasted(recording, 4) >= 900ms);
  CHECK(lasted(recording, 6) - lasted(source, 1) <= 1us);
}

TEST_CASE("FW-5 US-34 replay: several runs of a boot whose clock was set while it was right") {
  const Folder folder;
  const std::string path = folder.path() + "/run.db";
  ManualClock clock(Time{1'800'000'000s});
  clock.set_accuracy(1ms);
  for (int run = 0; run < 3; ++run) {
    Runtime runtime({.clock = &clock});
    runtime.on_log([](const LogRecord&) {});
    Loop loop(runtime, {});
    SqliteSink sink(loop, {.path = path});
    Sensor<Warmth> room(loop, {.name = "room", .rate = 1_Hz}, [] { return Warmth{21}; });
    loop.advance(15s);
    clock.set_realtime(clock.realtime() + 1h);
    loop.advance(30s);
    room.close();
    CHECK(loop.close() == 0);
    clock.pass(1min);
    clock.set_realtime(clock.realtime() - 10min);
  }
  const std::vector<Time> utc = utc_of(path);
  CHECK(utc.size() > 3 * 40);
  CHECK(std::is_sorted(utc.begin(), utc.end()));
  folder.write("again.json", R"({"sinks": [{"type": "sqlite", "path": "again.db"}]})");
  Process again(folder, program, {"replay", "run.db", "again.json", "--speed", "max", "-q"});
  CHECK(again.end() == 0);
  const std::string copy = folder.path() + "/again.db";
  const auto recording = Recording::open(copy).or_throw();
  const auto report = verify(recording).or_throw();
  CHECK_MESSAGE(report.verdict() == Verdict::balanced, report.text());
  CHECK(utc_of(copy) == utc);
  // Of a copy, the pairs do not become more.
  folder.write("third.json", R"({"sinks": [{"type": "sqlite", "path": "third.db"}]})");
  Process third(folder, program, {"replay", "again.db", "third.json", "--speed", "max", "-q"});
  CHECK(third.end() == 0);
  const auto of_copy = Recording::open(folder.path() + "/third.db").or_throw();
  for (std::int64_t run = 1; run <= 3; ++run)
    CHECK(of_copy.clock(run).or_throw().size() == recording.clock(run).or_throw().size());
  CHECK(utc_of(folder.path() + "/third.db") == utc);
}

TEST_CASE("FW-5 US-34 replay: all pairs of clocks of a long boot come along") {
  const Folder folder;
  const std::string path = recorded(folder);
  {
    auto database = sqlite::Database::open(path, sqlite::Database::Mode::write);
    database.execute(
        "INSERT INTO rtdata_clock(run, monotonic, realtime, source, occasion, accuracy) WITH RECURSIVE n(i) AS "
        "(SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 5000) SELECT run, monotonic + i, realtime + i, "
        "'gps', 'regular', i FROM rtdata_clock, n WHERE run = 1 AND occasion = 'start'");
  }
  folder.write("again.json", R"({"sinks": [{"type": "sqlite", "path": "again.db"}]})");
  Process again(folder, program, {"replay", "run.db", "again.json", "--speed", "max", "--run", "1"});
  CHECK(again.end() == 0);
  const auto copy = Recording::open(folder.path() + "/again.db").or_throw();
  std::size_t pairs = 0;
  for (const RecordedClock& pair : copy.clock(1).or_throw()) pairs += pair.source == "gps" ? 1 : 0;
  CHECK(pairs == 5000);
}

TEST_CASE("FW-5 replay: with --from, at any speed, nobody waits for the time before") {
  const Folder folder;
  const std::string path = folder.path() + "/run.db";
  const auto record = [&](Duration pause) {
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path});
    Feed<Warmth> room(loop, {.name = "room"});
    room.publish({1});
    loop.advance(pause);
    for (double warmth = 2; warmth < 5; ++warmth) {
      loop.advance(50ms);
      room.publish({warmth});
    }
    loop.advance(1s);
    CHECK(loop.close() == 0);
  };
  record(24h * 365);
  record(10ms);
  const Time second_event = *Recording::open(path).or_throw().runs().or_throw()[0].ended - 1s - 100ms;
  folder.write("part.json", R"({"sinks": [{"type": "sqlite", "path": "part.db"}]})");
  // A replay that waits for a year is ended by the test's own limit of time.
  for (const char* speed : {"1", "3", "max"}) {
    CAPTURE(speed);
    std::filesystem::remove(folder.path() + "/part.db");
    Process part(
        folder, program,
        {"replay", "run.db", "part.json", "--run", "1", "--from", to_iso8601(second_event + 10ms), "--speed", speed});
    CHECK(part.end() == 0);
    const auto copy = Recording::open(folder.path() + "/part.db").or_throw();
    std::vector<double> given;
    auto events = copy.events<Warmth>("room").or_throw();
    while (const auto* event = events.next().or_throw()) given.push_back((*event)->temperature);
    CHECK(given == std::vector<double>{3, 4});
    const auto runs = copy.runs().or_throw();
    CHECK(runs.size() == 1);
    CHECK(runs[0].started <= second_event + 10ms);
    CHECK(runs[0].started > second_event - 2s);
    const auto report = verify(copy).or_throw();
    CHECK_MESSAGE(report.verdict() == Verdict::balanced, report.text());
  }
  Process before(folder, program, {"replay", "run.db", "--run", "2", "--from", "1980-01-01T00:00:00Z"});
  CHECK(before.end() == 0);
  CHECK(before.err.find("has ended: 4 events") != std::string::npos);
}

TEST_CASE("FW-5 replay: to the terminal, chosen; and what is wrong has a status") {
  const Folder folder;
  const std::string path = recorded(folder);
  Process one(folder, program, {"replay", "run.db", "--run", "2", "--rename", "room=old/room", "-q"});
  CHECK(one.end() == 0);
  CHECK(one.out.find("old/room") != std::string::npos);
  CHECK(one.err == "");
  const auto status = [&](std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "replay");
    return Process(folder, program, std::move(arguments)).end();
  };
  CHECK(status({"run.db", "--run", "9"}) == 1);
  CHECK(status({"run.db", "--speed", "0"}) == 1);
  CHECK(status({"run.db", "--topic", "none", "--speed", "max"}) == 1);
  CHECK(status({"none.db"}) == 2);
  folder.write("text.db", "no recording");
  CHECK(status({"text.db"}) == 2);
  folder.write("bad.json", "{}}");
  CHECK(status({"run.db", "bad.json"}) == 2);
  std::filesystem::resize_file(path, 20'000);
  CHECK(status({"run.db", "--speed", "max"}) == 2);
}

TEST_CASE(
    "FW-5 replay: of a recording without a run, with fewer events than its account, or cut off, the status is not 0") {
  const Folder folder;
  record(folder, 60);
  const std::string path = folder.path() + "/run.db";
  const auto replayed = [&](const std::string& name) {
    Process replay(folder, program, {"replay", name, "--speed", "max"});
    const int status = replay.end();
    return std::pair{status, replay.err};
  };
  REQUIRE(replayed("run.db").first == 0);
  {
    std::filesystem::copy_file(path, folder.path() + "/fewer.db");
    const auto database = sqlite::Database::open(folder.path() + "/fewer.db", sqlite::Database::Mode::write);
    database.execute("DELETE FROM room WHERE _rowid_ > 500");
  }
  const auto fewer = replayed("fewer.db");
  CHECK(fewer.first == 1);
  CHECK_MESSAGE(fewer.second.find("500 events are there, and its account says that 600 are") != std::string::npos,
                fewer.second);
  {
    std::filesystem::copy_file(path, folder.path() + "/empty.db");
    const auto database = sqlite::Database::open(folder.path() + "/empty.db", sqlite::Database::Mode::write);
    database.execute("DELETE FROM rtdata_run");
  }
  const auto empty = replayed("empty.db");
  CHECK(empty.first != 0);
  CHECK_MESSAGE(empty.second.find("it has no run") != std::string::npos, empty.second);
  const auto size = std::filesystem::file_size(path);
  for (std::uintmax_t kept = 0; kept < size; kept += 4096) {
    CAPTURE(kept);
    std::filesystem::copy_file(path, folder.path() + "/cut.db", std::filesystem::copy_options::overwrite_existing);
    std::filesystem::resize_file(folder.path() + "/cut.db", kept);
    CHECK(replayed("cut.db").first != 0);
  }
}

TEST_CASE("FW-5 replay: as fast as it goes, a peer has the time that it takes, and gets every event") {
  if (!sinks::is_program(sinks::python)) return;
  const Folder folder;
  record(folder, 60);
  sinks::HttpServer server;
  for (const char* through : {"", R"(, "through": "again.db")"}) {
    CAPTURE(through);
    std::filesystem::remove(folder.path() + "/again.db");
    folder.write("again.json", R"({"sinks": [{"type": "sqlite", "path": "again.db"}, {"type": "http", "url": ")" +
                                   server.url() + R"(", "parcel_rows": 20)" + through + "}]}");
    server.forget();
    Process replay(folder, program, {"replay", "run.db", "again.json", "--speed", "max"});
    CHECK_MESSAGE(replay.end() == 0, replay.err);
    CHECK(server.sequences().size() == 600);
    CHECK(server.events().size() == 600);
  }
  // One that is away at first: what waits is sent again when it is back. Without a recording between, the replay waits.
  server.become("status 503");
  server.forget();
  folder.write("again.json", R"({"sinks": [{"type": "http", "url": ")" + server.url() +
                                 R"(", "retry_first": "20 ms", "retry_longest": "50 ms"}]})");
  Process replay(folder, program, {"replay", "run.db", "again.json", "--speed", "max"});
  CHECK_MESSAGE(replay.wait_for("503"), replay.err);
  server.become("ok");
  CHECK_MESSAGE(replay.end() == 0, replay.err);
  CHECK_MESSAGE(server.sequences().size() == 600, replay.err);
}

TEST_CASE("FW-5 replay: as fast as it goes, a peer that never answers has its time-out and no longer") {
  if (!sinks::is_program(sinks::python)) return;
  const Folder folder;
  record(folder, 2);
  sinks::HttpServer server;
  server.become("hang");
  folder.write("again.json", R"({"sinks": [{"type": "http", "url": ")" + server.url() + R"(", "timeout": "200 ms"}]})");
  const auto begin = std::chrono::steady_clock::now();
  Process replay(folder, program, {"replay", "run.db", "again.json", "--speed", "max"});
  CHECK(replay.end() == 1);
  CHECK(std::chrono::steady_clock::now() - begin > 2s);  // the deadline of closing is the machine's time, too
  CHECK_MESSAGE(replay.err.find("no answer in 200 ms") != std::string::npos, replay.err);
  CHECK_MESSAGE(replay.err.find("dropped 20 events") != std::string::npos, replay.err);
}

TEST_CASE("FW-5 replay: the status says whether all was replayed and stored, whatever was logged on the way") {
  if (!sinks::is_program(sinks::python)) return;
  const Folder folder;
  record(folder, 20);
  sinks::HttpServer server;
  const auto replay = [&](const std::string& more) {
    folder.write("again.json", R"({"sinks": [{"type": "http", "url": ")" + server.url() +
                                   R"(", "retry_first": "20 ms", "retry_longest": "50 ms")" + more + "}]}");
    return std::make_unique<Process>(folder, program,
                                     std::vector<std::string>{"replay", "run.db", "again.json", "--speed", "max"});
  };
  server.become("status 503");
  auto retried = replay("");
  CHECK_MESSAGE(retried->wait_for("503"), retried->err);
  server.become("ok");
  CHECK_MESSAGE(retried->end() == 0, retried->err);
  CHECK(retried->err.find("error: ") != std::string::npos);
  CHECK(server.sequences().size() == 200);
  // What the peer refuses is not stored.
  server.become("status 400");
  auto refused = replay(R"(, "parcel_rows": 50)");
  CHECK(refused->end() == 1);
  CHECK_MESSAGE(refused->err.find("dropped 200 events") != std::string::npos, refused->err);
}

TEST_CASE("FW-5 replay: as fast as it goes, years without an event are passed over") {
  const Folder folder;
  folder.write("table.csv", "t,a\n0,1\n1700000000,2\n1731536000,3\n");
  Process import(folder, program, {"import", "table.csv", "--time", "t", "--into", "run.db"});
  REQUIRE(import.end() == 0);
  folder.write("again.json", R"({"sinks": [{"type": "sqlite", "path": "again.db"},
                                           {"type": "file", "path": "again.csv", "format": "csv"}]})");
  for (const std::vector<std::string>& to : {std::vector<std::string>{}, {"again.json"}}) {
    std::vector<std::string> arguments{"replay", "run.db", "--speed", "max"};
    arguments.insert(arguments.end(), to.begin(), to.end());
    Process replay(folder, program, arguments);
    CHECK_MESSAGE(replay.end() == 0, replay.err);
    CHECK_MESSAGE(replay.err.find("has ended: 3 events") != std::string::npos, replay.err);
  }
  const auto report = verify(Recording::open(folder.path() + "/again.db").or_throw()).or_throw();
  CHECK_MESSAGE(report.verdict() == Verdict::balanced, report.text());
}

TEST_CASE("FW-5 US-17 a sensor of type replay: checked with the recording, and run beside live ones") {
  const Folder folder;
  (void)recorded(folder);
  const auto configured = [&](const std::string& more) {
    folder.write("both.json", R"({"sensors": [{"name": "old", "type": "replay", "file": "run.db", "prefix": "old ")" +
                                  more +
                                  R"(}, {"name": "cpu", "type": "host", "quantity": "load", "rate": "10 Hz"}],
                                   "sinks": [{"type": "sqlite", "path": "both.db"}]})");
  };
  for (const char* wrong :
       {R"(, "run": 7)", R"(, "topics": ["none"])", R"(, "rename": ["x"])", R"(, "from": "soon")"}) {
    configured(wrong);
    Process check(folder, program, {"check", "both.json"});
    CHECK(check.end() == 2);
  }
  configured(R"(, "run": 1, "speed": 10)");
  Process run(folder, program, {"run", "both.json", "--for", "500ms", "--quiet"});
  CHECK(run.end() == 0);
  const auto both = Recording::open(folder.path() + "/both.db").or_throw();
  CHECK(verify(both).or_throw().verdict() == Verdict::balanced);
  std::uint64_t old = 0;
  for (const LedgerEntry& entry : both.ledger(1).or_throw()) old += entry.origin == "old room" ? entry.stored : 0;
  CHECK(old == 11);
}

TEST_SUITE_END();
