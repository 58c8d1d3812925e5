// A program of one's own as a sensor: real programs, which end, hang, flood and say nothing.
#include <doctest/doctest.h>
#include <signal.h>
#include <unistd.h>

#include <fstream>
#include <string>
#include <vector>

#include "has.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/data/event.hpp"
#include "rtdata/outputs/command.hpp"
#include "rtdata/sensors/command.hpp"
#include "sensors/fixture.hpp"
#include "sensors/termios2.hpp"

using namespace rtdata;
using rtdata::test::has;
using namespace std::chrono_literals;

namespace {

struct CommandBench {
  explicit CommandBench(std::string script, bool pty = true) {
    be_quiet(loop);
    heard = loop.subscribe("c", [this](const EventView& event) {
      events.push_back(to_string(event.value(event.description().leaves()[0])));
    });
    sensor = CommandSensor(
        loop, {.name = "c"},
        {.run = {"sh", "-c", std::move(script)},
         .pty = pty,
         .lines = {
             .fields = {{.name = "v"}}, .first_line = FirstLine::keep, .retry_first = 20ms, .retry_longest = 20ms}});
    sensor.on_error([this](const ErrorReport& report) { errors.push_back(report.error.why); });
  }
  template <class Done>
  bool until(Done done) {
    for (int i = 0; i < 20000 && !done(); ++i) loop.run_for(1ms);
    return done();
  }

  Loop loop;
  Subscription heard;
  std::vector<std::string> events, errors;
  CommandSensor sensor;
};

/// A process that has ended and that nobody has waited for runs no more.
bool runs(pid_t pid) {
  std::ifstream file("/proc/" + std::to_string(pid) + "/stat");
  std::string text;
  return std::getline(file, text) && text.find(") Z") == std::string::npos;
}

}  // namespace

TEST_SUITE("sensors" * doctest::skip(!terminals_can_be_set_up())) {
  TEST_CASE("US-17 lines of a program are events, through a terminal and through a pipe") {
    for (const bool pty : {true, false}) {
      CAPTURE(pty);
      CommandBench bench(
          pty ? "test -t 1 && printf '1\\n2\\n' && exec sleep 100" : "test -t 1 || printf '1\\n2\\n'; exec sleep 100",
          pty);
      REQUIRE(bench.until([&] { return bench.events.size() == 2; }));
      CHECK(bench.events == std::vector<std::string>{"1", "2"});
      CHECK(bench.errors.empty());
      CHECK(bench.sensor.health() == Health::ok);
      bench.sensor.close();
      CHECK(bench.loop.runtime().balances());
    }
  }

  TEST_CASE("US-7 a program that ends is a fault with its reason, and is started again") {
    CommandBench bench("echo 7; echo 'no such sensor' >&2; exit 3");
    REQUIRE(bench.until([&] { return bench.events.size() >= 3; }));
    REQUIRE_FALSE(bench.errors.empty());
    CHECK(bench.errors.front() == "it has ended with status 3; it said: no such sensor");
    bench.sensor.close();

    CommandBench cut("echo 1; printf 2; printf fatal >&2; exit 3", false);
    REQUIRE(cut.until([&] { return cut.errors.size() >= 2; }));
    CHECK(cut.errors[0] == "1 byte came without an end");  // perhaps the beginning of another number
    CHECK(cut.errors[1] == "it has ended with status 3; it said: fatal");
    CHECK(cut.events.front() == "1");
    cut.sensor.close();

    CommandBench killed("kill -9 $$");
    REQUIRE(killed.until([&] { return killed.errors.size() >= 2; }));
    CHECK(killed.errors.front() == "it was ended by SIGKILL");

    CommandBench mute("exec >&-; exec sleep 100", false);
    REQUIRE(mute.until([&] { return mute.errors.size() >= 2; }));
    CHECK(has(mute.errors.front(), "closed its output"));
  }

  TEST_CASE("US-7 a program that is not there is a fault; a line of a shell is told") {
    Loop loop;
    be_quiet(loop);
    std::vector<std::string> errors;
    CommandSensor sensor(loop, {.name = "c"}, {.run = {"no-such-program -x"}, .lines = {.fields = {{.name = "v"}}}});
    sensor.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
    for (int i = 0; i < 5000 && errors.empty(); ++i) loop.run_for(1ms);
    REQUIRE_FALSE(errors.empty());
    CHECK(has(errors.front(), "not a line of shell commands"));
    CHECK(sensor.health() == Health::faulted);
    CHECK_THROWS_AS(CommandSensor(loop, {.name = "d"}, {.lines = {.fields = {{.name = "v"}}}}), SetupError);
  }

  TEST_CASE("US-17 a program that is there and cannot be started is a mistake in the configuration") {
    for (const char* const run : {"/", "/etc/passwd"}) {
      CommandConfig config{.run = {run, "{value}"}, .lines = {.fields = {{.name = "v"}}}};
      const ConfigItem item = parse_config(R"({"run": []})", "f.json").root;
      Problems problems;
      check_config(config, item, problems);
      CHECK_MESSAGE(problems.size() == 1, problems.text());
      check_config(CommandActuatorConfig{.run = config.run}, item, problems);
      CHECK_MESSAGE(problems.size() == 2, problems.text());
    }
  }

  TEST_CASE("US-9 a program ends with its sensor, with all that it has started, and inherits nothing") {
    ScratchDirectory folder;
    const std::string file = folder.file("pids");
    {
      CommandBench bench("sleep 100 & echo $! > " + file + "; echo $$ >> " + file + "; ls /proc/$$/fd | wc -l; wait");
      REQUIRE(bench.until([&] { return bench.events.size() == 1; }));
      CHECK(std::stoi(bench.events.front()) <= 5);  // 0, 1, 2, and what the shell has for itself
    }
    std::ifstream pids(file);
    for (pid_t pid = 0; pids >> pid;) {
      CAPTURE(pid);
      for (int i = 0; i < 5000 && runs(pid); ++i) ::usleep(1000);
      CHECK_FALSE(runs(pid));
    }
    CommandBench stubborn("trap '' TERM HUP; echo 1; while :; do sleep 0.05; done");  // gets SIGKILL
    REQUIRE(stubborn.until([&] { return stubborn.events.size() == 1; }));
    stubborn.sensor.stop();
    stubborn.sensor.start();
    REQUIRE(stubborn.until([&] { return stubborn.events.size() == 2; }));
  }

  TEST_CASE("US-6 a program that floods its output and the log disturbs nobody and loses nothing") {
    CommandBench bench("i=0; while [ $i -lt 5000 ]; do echo $i; echo x$i >&2; i=$((i+1)); done; exec sleep 100");
    REQUIRE(bench.until([&] { return bench.events.size() == 5000; }));
    for (std::size_t i = 0; i < bench.events.size(); ++i)
      if (bench.events[i] != std::to_string(i)) FAIL_CHECK("event " << i << " is " << bench.events[i]);
    CHECK(bench.sensor.counts().balances());
  }
}
