// examples/test_bench, as it stands, on its simulated bench: firings from start to end, and what ends them early.
#include <doctest/doctest.h>
#include <signal.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <string>
#include <thread>
#include <vector>

#include "app/process.hpp"
#include "app/runtime_folder.hpp"
#include "paths.hpp"
#include "rtdata/process/expression.hpp"
#include "sinks/recordings.hpp"

using namespace std::chrono_literals;
using rtdata::test::Folder;
using rtdata::test::Process;

namespace {

constexpr const char* python = "/usr/bin/python3";

/// The bench and the program, which run.
struct Bench {
  explicit Bench(std::vector<std::string> faults = {}) {
    faults.insert(faults.begin(), rtdata::test::in_source("examples/test_bench/bench.py"));
    bench.emplace(folder, python, faults);
    REQUIRE_MESSAGE(bench->wait_for("the bench is there"), bench->err);
    program.emplace(folder, rtdata::test::built("rtdata"),
                    std::vector<std::string>{"run", rtdata::test::in_source("examples/test_bench/test_bench.json")});
    REQUIRE_MESSAGE(program->wait_for("running test_bench"), program->err);
    CHECK(bench->wait_for("purge 0"));
  }
  void ctl(std::vector<std::string> words) const {
    words.insert(words.begin(), "ctl");
    Process one(folder, rtdata::test::built("rtdata"), words);
    CHECK_MESSAGE(one.end() == 0, one.err);
  }
  void fire() const {
    ctl({"arm", "igniter"});
    ctl({"arm", "valve"});
    ctl({"event", "sequence", "start"});
  }
  void end() {
    program->signal(SIGTERM);
    CHECK_MESSAGE(program->end() == 0, program->err);
    verify();
  }
  void verify() const {
    Process one(folder, rtdata::test::built("rtdata"), {"verify", "test_bench.db"});
    CHECK_MESSAGE(one.end() == 0, one.out << one.err);
  }
  std::int64_t number(const std::string& query) const { return recordings::number(path(), query); }
  std::string text(const std::string& query) const {
    return rtdata::sqlite::Database::open(path(), rtdata::sqlite::Database::Mode::read).prepare(query).texts().at(0);
  }
  std::string path() const { return folder.path() + "/test_bench.db"; }
  std::string states() const {
    return text(R"(SELECT group_concat("to", ' ') FROM (SELECT "to" FROM sequence ORDER BY time))");
  }
  std::string asked(const std::string& output) const {
    return text("SELECT group_concat(CAST(asked AS INTEGER), ' ') FROM (SELECT asked FROM " + output +
                " WHERE cause = 'input' ORDER BY time)");
  }
  /// Every line that the bench has sent from the first recorded one on.
  void check_rows() const {
    CHECK(number(R"(SELECT count(*) - (max(count) - min(count) + 1) FROM "fire/daq")") == 0);
    CHECK(number(R"(SELECT count(*) FROM "fire/daq")") > 500);
    CHECK(number(R"(SELECT count(*) FROM "fire/heat")") > 10);
  }

  rtdata::test::RuntimeFolder runtime;
  Folder folder;
  std::optional<Process> bench, program;
};

#define NEEDS_BENCH()                        \
  if (::access(python, X_OK) != 0) {         \
    MESSAGE("skipped: there is no python3"); \
    return;                                  \
  }

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("US-35 US-39 examples/test_bench: a firing, recorded from 10 s before it began, every value once") {
    NEEDS_BENCH();
    Bench bench;
    std::this_thread::sleep_for(11s);
    CHECK(bench.number("SELECT count(*) FROM sqlite_master WHERE name = 'fire/daq'") == 0);
    bench.fire();
    CHECK(bench.bench->wait_for("igniter 1"));
    CHECK(bench.bench->wait_for("purge 1"));
    std::this_thread::sleep_for(3s);  // the purge, and on
    bench.end();
    CHECK(bench.bench->wait_for("purge 0\n"));
    CHECK(bench.states() == "idle countdown ignition burn shutdown idle");
    CHECK(bench.asked("igniter") == "1 0");
    CHECK(bench.asked("valve") == "1 0");
    CHECK(bench.asked("purge") == "1 0");
    bench.check_rows();
    // From 10 s before the countdown, but for the time between two lines, until the end of the purge.
    const auto before = bench.number(R"(SELECT (SELECT time FROM sequence WHERE "to" = 'countdown')
                                        - (SELECT min(time) FROM "fire/daq"))");
    CHECK(before <= 10'000'000'000);
    CHECK(before > 9'000'000'000);
    CHECK(bench.number(R"(SELECT abs((SELECT max(time) FROM sequence) - (SELECT max(time) FROM "fire/daq")))") <
          1'000'000'000);
    CHECK(bench.number(R"(SELECT max(thrust) FROM "fire/daq")") > 2000);
  }

  TEST_CASE("US-35 US-39 examples/test_bench: an abort in the countdown, and while it is held, lights nothing") {
    NEEDS_BENCH();
    for (const bool is_held : {false, true}) {
      CAPTURE(is_held);
      Bench bench;
      std::this_thread::sleep_for(1s);
      bench.fire();
      if (is_held) bench.ctl({"event", "sequence", "hold"});
      bench.ctl({"event", "sequence", "abort"});
      CHECK(bench.bench->wait_for("purge 1"));
      bench.ctl({"event", "sequence", "start"});  // only after `reset`
      std::this_thread::sleep_for(4s);
      bench.end();
      CHECK(bench.states() == (is_held ? "idle countdown hold abort" : "idle countdown abort"));
      CHECK(bench.number("SELECT count(*) FROM igniter WHERE asked = 1") == 0);
      CHECK(bench.number("SELECT count(*) FROM valve WHERE asked = 1") == 0);
    }
  }

  TEST_CASE("US-35 US-39 examples/test_bench: too much pressure, a sensor that dies, and no ignition end it") {
    NEEDS_BENCH();
    struct {
      std::string fault, cause, alarm;
    } const rows[] = {
        {"overpressure", "pressure", "high_high"}, {"dead", "pressure", "unknown"}, {"cold", "no ignition", ""}};
    for (const auto& row : rows) {
      CAPTURE(row.fault);
      Bench bench({"--fault", row.fault});
      std::this_thread::sleep_for(1s);
      bench.fire();
      CHECK(bench.bench->wait_for("valve 1"));
      CHECK(bench.bench->wait_for("purge 1"));
      std::this_thread::sleep_for(500ms);
      bench.end();
      CHECK(bench.states() ==
            (row.fault == "cold" ? "idle countdown ignition abort" : "idle countdown ignition burn abort"));
      CHECK(bench.text(R"(SELECT cause FROM sequence WHERE "to" = 'abort')") == row.cause);
      CHECK(bench.asked("igniter") == "1 0");
      CHECK(bench.asked("valve") == "1 0");
      CHECK(bench.asked("purge") == "1");
      bench.check_rows();
      if (!row.alarm.empty())
        // A busy machine is silent for 200 ms before, too.
        CHECK(bench.number("SELECT count(*) FROM pressure WHERE alarm = '" + row.alarm +
                           R"(' AND time >= (SELECT time FROM sequence WHERE "to" = 'burn'))") == 1);
      // Nothing was open or lit for long after what ended it.
      CHECK(bench.number(R"(SELECT max(time) - (SELECT time FROM sequence WHERE "to" = 'abort') FROM valve
                            WHERE cause = 'input')") < 1'000'000'000);
    }
  }

  TEST_CASE(
      "US-35 US-39 examples/test_bench: killed with a full ring, nothing is recorded of it, and the account is right") {
    NEEDS_BENCH();
    Bench bench;
    std::this_thread::sleep_for(2s);
    bench.program->signal(SIGKILL);
    CHECK(bench.program->end() == 128 + SIGKILL);
    Process again(bench.folder, rtdata::test::built("rtdata"),
                  {"run", rtdata::test::in_source("examples/test_bench/test_bench.json"), "--for", "1s"});
    CHECK_MESSAGE(again.end() == 0, again.err);  // it closes the account of the killed one
    bench.verify();
    CHECK(bench.states() == "idle idle");
    CHECK(bench.number("SELECT count(*) FROM sqlite_master WHERE name = 'fire/daq'") == 0);
  }
}
