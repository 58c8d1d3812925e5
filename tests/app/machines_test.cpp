// State machines of configurations, by the real program: drawn, flown, resumed after a kill, and over a reload.
#include <doctest/doctest.h>

#include <cmath>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "app/process.hpp"
#include "app/runtime_folder.hpp"
#include "has.hpp"
#include "paths.hpp"
#include "recording/database.hpp"
#include "rtdata/process/expression.hpp"

using rtdata::test::built;
using rtdata::test::Folder;
using rtdata::test::Process;

namespace {

using rtdata::test::has;

struct Done {
  int status;
  std::string out, err;
};
Done done(const Folder& folder, std::vector<std::string> arguments) {
  Process process(folder, built("rtdata"), std::move(arguments));
  const int status = process.end();
  return {status, process.out, process.err};
}

/// Of the changes of a machine in a recording: the states, and their times in seconds.
struct Changes {
  std::vector<std::string> to;
  std::vector<double> at;
  std::vector<std::string> cause;
};
Changes changes_in(const Folder& folder, const std::string& recording, const std::string& topic) {
  Changes changes;
  std::istringstream lines(done(folder, {"export", recording, "--topic", topic, "--format", "csv"}).out);
  std::string line;
  std::getline(lines, line);
  while (std::getline(lines, line)) {
    std::vector<std::string> cells;
    std::istringstream row(line);
    for (std::string cell; std::getline(row, cell, ',');) cells.push_back(cell);
    if (cells.size() < 6) continue;
    changes.at.push_back(std::stod(cells[0]) / 1e9);
    changes.to.push_back(cells[4]);
    changes.cause.push_back(cells[5]);
  }
  return changes;
}

std::string rig(const std::string& more, const std::string& resume = "") {
  return R"({"sensors": [{"name": "load", "type": "host", "quantity": "load", "rate": "50 Hz"}],
    "tiers": {"fast": {}},
    "machines": [{"name": "m", "inputs": ["load"], "start": "a"
      , "states": [{"name": "a"}, {"name": "b"}, {"name": "c", "final": true}],
      "transitions": [{"from": "a", "to": "b", "when": "running >= 0", "for": "100 ms"},
                      {"from": "b", "to": "c", "after": "60 s"}])" +
         resume +
         R"(}, {"name": "n", "tier": "fast", "inputs": ["load"], "start": "a", "states": [{"name": "a"}, {"name": "b"}],
      "transitions": [{"from": "a", "to": "b", "when": "running >= 0"}, {"from": "b", "to": "a", "event": "back"}])" +
         more + R"(}],
    "sinks": [{"type": "sqlite", "path": "run.db"}]})";
}
const std::string resume = R"(, "resume": {"recording": "run.db", "max_age": "MAX", "unknown_age": "UNKNOWN"})";
std::string resumes(std::string max_age, std::string unknown) {
  std::string text = resume;
  text.replace(text.find("MAX"), 3, max_age);
  text.replace(text.find("UNKNOWN"), 7, unknown);
  return rig("", text);
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("US-41 graph draws the machines of a configuration") {
    const Folder folder;
    folder.write("rig.json", rig(""));
    CHECK(done(folder, {"graph", "rig.json", "--machine", "m"}).out ==
          "stateDiagram-v2\n  state \"a\" as s0\n  state \"b\" as s1\n  state \"c\" as s2\n  [*] --> s0\n"
          "  s0 --> s1 : running #62;= 0, for 100 ms\n  s1 --> s2 : after 1 min\n  s2 --> [*]\n");
    const Done dot = done(folder, {"graph", "rig.json", "--dot"});
    CHECK(dot.status == 0);
    CHECK(has(dot.out, "digraph \"m\" {"));
    CHECK(has(dot.out, "\"b\" -> \"a\" [label=\"back\"];"));
    CHECK(done(folder, {"graph", "rig.json", "--machine", "x"}).err ==
          "rtdata: rig.json has no machine \"x\"; available: m, n [not-found]\n");
    folder.write("bad.json", R"({"machines": [{"name": "m", "start": "a", "states": [{"name": "b"}]}]})");
    const Done bad = done(folder, {"graph", "bad.json"});
    CHECK(bad.status == 2);
    CHECK(has(bad.err, "there is no state \"a\" in `states`"));
  }

  TEST_CASE("US-41 a simulated flight in JSON: liftoff, burnout, apogee, landing, and nothing near Mach 1") {
    const Folder folder;
    const std::string examples = rtdata::test::in_source("examples/rocket/");
    const auto copy = [&](const char* name) {
      std::filesystem::copy_file(examples + name, folder.path() + "/" + name);
    };
    copy("rocket.json");
    copy("flight.csv");
    REQUIRE(done(folder, {"import", "flight.csv", "--time", "t", "--topic", "rocket", "--origin", "rocket", "--into",
                          "flight.db"})
                .status == 0);
    const Done flown = done(folder, {"replay", "flight.db", "rocket.json", "--speed", "max"});
    CHECK_MESSAGE(flown.status == 0, flown.err);
    const Changes changes = changes_in(folder, "rocket.db", "flight");
    REQUIRE(changes.to == std::vector<std::string>{"pad", "boost", "coast", "apogee", "descent", "landed"});
    CHECK(changes.cause ==
          std::vector<std::string>{"start", "liftoff", "burnout", "apogee", "the parachute is out", "landing"});
    CHECK(std::abs(changes.at[1] - 10.0) < 0.3);
    CHECK(std::abs(changes.at[2] - 14.0) < 0.5);
    CHECK(std::abs(changes.at[3] - 25.95) < 1);
    CHECK(std::abs(changes.at[5] - 137.85) < 20);
    CHECK(done(folder, {"verify", "rocket.db"}).status == 0);
    // What was decided is in the recording, and is not decided again.
    CHECK(has(done(folder, {"replay", "rocket.db", "rocket.json"}).err, "records into it"));
  }

  TEST_CASE(
      "US-41 killed in the middle, a machine goes on where it was; after too long, or without a clock, as chosen") {
    const Folder folder;
    folder.write("rig.json", resumes("1 min", "start"));
    {
      Process run(folder, built("rtdata"), {"run", "rig.json"});
      REQUIRE(run.wait_for("running rig"));
      // As soon as the change is in the file, which is long before the second in which others are stored.
      for (int i = 0; i < 3000 && changes_in(folder, "run.db", "m").to.size() < 2; ++i) {
        std::this_thread::sleep_for(std::chrono::milliseconds{20});
      }
      run.signal(SIGKILL);
      CHECK(run.end() == 128 + SIGKILL);
    }
    Done again = done(folder, {"run", "rig.json", "--for", "300ms"});
    CHECK_MESSAGE(has(again.err, "machine m: it continues in b, after a pause of"), again.err);
    Changes changes = changes_in(folder, "run.db", "m");
    CHECK(changes.to == std::vector<std::string>{"a", "b", "b"});

    folder.write("rig.json", resumes("1 ms", "start"));
    again = done(folder, {"run", "rig.json", "--for", "300ms"});
    CHECK_MESSAGE(has(again.err, "machine m: it begins in a: it was in b, before a pause of"), again.err);

    // As after a boot, with clocks that nobody keeps.
    const auto forget_boot = [&] {
      auto database = rtdata::sqlite::Database::open(folder.path() + "/run.db", rtdata::sqlite::Database::Mode::write);
      database.execute("UPDATE rtdata_run SET boot_id = 'another'; UPDATE rtdata_clock SET accuracy = NULL");
    };
    forget_boot();
    folder.write("rig.json", resumes("1 min", "start"));
    again = done(folder, {"run", "rig.json", "--for", "300ms"});
    CHECK_MESSAGE(has(again.err, "it begins in a: it was in b, before a pause of unknown length"), again.err);
    forget_boot();
    folder.write("rig.json", resumes("1 min", "resume"));
    again = done(folder, {"run", "rig.json", "--for", "300ms"});
    CHECK_MESSAGE(has(again.err, "it continues in b, after a pause of unknown length"), again.err);
  }

  TEST_CASE(
      "US-41 a machine that goes on after a pause has its topic for itself, and so have the outputs that it arms") {
    const Folder folder;
    const auto checked = [&](const std::string& topic_of_n, const std::string& topic_of_p) {
      std::string text = resumes("1 min", "start");
      const std::string a = R"("states": [{"name": "a"})";
      text.replace(text.find(a), a.size(), R"("states": [{"name": "a", "set": [{"output": "o", "value": 1}]})");
      text.replace(text.rfind(R"("back"}])"), 8, R"("back"}], "topic": ")" + topic_of_n + "\"");
      text.insert(text.find(R"("sinks")"),
                  R"("outputs": [{"name": "o", "type": "serial", "device": "/dev/ttyS98", "text": "{value}"},
          {"name": "p", "type": "serial", "device": "/dev/ttyS99", "text": "{value}", "topic": ")" +
                      topic_of_p + "\"}], ");
      folder.write("rig.json", text);
      const Done checking = done(folder, {"check", "rig.json"});
      return checking.out + checking.err;
    };
    const std::string shares = "shares the topic";
    CHECK(!has(checked("n", "p"), shares));
    CHECK(has(checked("m", "p"), "machine m shares the topic \"m\" with machine n, at "));
    CHECK(has(checked("n", "o"), "output o shares the topic \"o\" with output p, at "));
  }

  TEST_CASE("US-41 over a reload a machine keeps its state, a changed one too") {
    const Folder folder;
    folder.write("rig.json", rig(""));
    Process run(folder, built("rtdata"), {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    for (int i = 0; i < 3000 && changes_in(folder, "run.db", "m").to.size() < 2; ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds{20});
    folder.write("rig.json", rig(R"(, "max_age": "5 s")"));
    run.signal(SIGHUP);
    REQUIRE(run.wait_for("rig.json is applied"));
    CHECK(has(run.err, "configuration: machine n: restarted (max_age)"));
    CHECK_FALSE(has(run.err, "machine m:"));
    std::this_thread::sleep_for(std::chrono::milliseconds{300});
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    CHECK(has(run.out, "ledger balances"));
    CHECK(changes_in(folder, "run.db", "m").to == std::vector<std::string>{"a", "b"});
    CHECK(changes_in(folder, "run.db", "n").to == std::vector<std::string>{"a", "b", "b"});
    CHECK(done(folder, {"verify", "run.db"}).status == 0);
  }
}
