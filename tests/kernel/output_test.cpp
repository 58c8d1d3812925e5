// Outputs on lines of the kernel's simulator, held by the guard of a program that is killed, crashes or is stopped.
#include <doctest/doctest.h>
#include <signal.h>

#include <chrono>
#include <string>
#include <thread>

#include "app/process.hpp"
#include "kernel/bench.hpp"
#include "kernel/gpio_bench.hpp"
#include "paths.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/outputs/gpio.hpp"

using namespace bench;
using rtdata::test::Process;

namespace {

/// Waits until the line has this level; returns for how long.
std::chrono::milliseconds wait_for(const gpio_bench::Chip& chip, unsigned line, bool level) {
  const auto began = std::chrono::steady_clock::now();
  for (;;) {
    const auto took = std::chrono::duration_cast<std::chrono::milliseconds>(std::chrono::steady_clock::now() - began);
    if (chip.value(line) == level) return took;
    if (took > 30s) {
      CHECK_MESSAGE(false, "line " << line << " never became " << level);
      return took;
    }
    std::this_thread::sleep_for(2ms);
  }
}

}  // namespace

TEST_SUITE("drivers") {
  TEST_CASE("US-35 US-36 gpio: lines are safe after SIGTERM, SIGKILL, SIGSEGV and SIGSTOP of the program") {
    if (!standard_registry().outputs().find("gpio")) {
      MESSAGE("skipped: there is no libgpiod");
      return;
    }
    for (const int number : {SIGTERM, SIGKILL, SIGSEGV, SIGSTOP}) {
      CAPTURE(number);
      gpio_bench::Chip chip;
      chip.pull(5, false);
      chip.pull(6, true);  // so that it reads its safe value also when nobody has it any more
      const rtdata::test::Folder folder;
      folder.write("f.json", R"({
          "sensors": [{"name": "load", "type": "host", "quantity": "load", "rate": "20 Hz"}],
          "outputs": [
            {"name": "valve", "type": "gpio", "line": "sim5", "on": "load", "expression": "minutes_1 >= 0",
             "watchdog": "1 s"},
            {"name": "brake", "type": "gpio", "line": "sim6", "safe": 1, "on": "load", "expression": "minutes_1 < 0",
             "watchdog": "1 s"}]})");
      Process run(folder, rtdata::test::built("rtdata"), {"run", "f.json"});
      wait_for(chip, 5, true);
      wait_for(chip, 6, false);
      run.signal(number);
      const auto valve = wait_for(chip, 5, false), brake = wait_for(chip, 6, true);
      MESSAGE("signal " << number << ": safe after " << valve.count() << " and " << brake.count() << " ms");
      CHECK(valve < 10s);
      CHECK(brake < 10s);
      if (number == SIGSTOP) {
        CHECK(chip.is_taken(5));  // the guard has it
        run.signal(SIGKILL);
      }
      (void)run.end();
      for (int tries = 0; tries < 1000 && chip.is_taken(5); ++tries) std::this_thread::sleep_for(5ms);
      CHECK_FALSE(chip.is_taken(5));
    }
  }

  TEST_CASE("US-35 US-36 gpio: a line is taken with its safe value, or with the level that it has") {
    gpio_bench::Chip chip;
    for (const bool level : {true, false}) {
      {
        GpioActuator line({.line = "sim7"});
        CHECK(line.open(level ? 1 : 0).has_value());
        CHECK(chip.value(7) == level);
      }
      chip.pull(7, level);
      GpioActuator kept({.line = "sim7"});
      CHECK(kept.open({}).has_value());
      CHECK(chip.value(7) == level);
      CHECK(kept.set(level ? 0 : 1).has_value());
      CHECK(chip.value(7) != level);
    }
  }
}
