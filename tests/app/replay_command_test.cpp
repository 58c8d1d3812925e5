// `rtdata replay`: a recording's runs to the sinks of a configuration, and to the terminal.
#include <doctest/doctest.h>

#include <filesystem>

#include "app/process.hpp"
#include "paths.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "rtdata/sinks/recording.hpp"
#include "rtdata/sinks/sqlite.hpp"
#include "rtdata/sinks/verify.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using namespace std::chrono_literals;
using rtdata::test::Folder;
using rtdata::test::Process;

namespace {

const std::string program = test::built("rtdata");

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
  CHECK(status({"none.db"}) == 1);
  folder.write("text.db", "no recording");
  CHECK(status({"text.db"}) == 2);
  folder.write("bad.json", "{}}");
  CHECK(status({"run.db", "bad.json"}) == 2);
  std::filesystem::resize_file(path, 20'000);
  CHECK(status({"run.db", "--speed", "max"}) == 2);
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
