// GPIO lines of the kernel's simulator, by whichever libgpiod this was built with.
#include <doctest/doctest.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <set>
#include <string>
#include <vector>

#include "has.hpp"
#include "kernel/gpio_bench.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/counter.hpp"
#include "rtdata/sensors/edge.hpp"

using namespace gpio_bench;

namespace {

/// libgpiod 2 and the kernel number edges and keep 1024 of them; without numbers it keeps 16.
const bool has_numbers = make_kernel_gpio()->numbers_edges();
const std::size_t kept = make_kernel_gpio()->kept_edges();

std::string refusal(const std::function<void()>& make) {
  try {
    make();
    return "";
  } catch (const SetupError& error) {
    return std::string(error.error().id()) + ": " + error.error().text();
  }
}
using rtdata::test::has;

/// Ends the loop when a test does not get where it is going.
Timer limit(Loop& loop) {
  return Timer(loop, 20s, [&loop] { loop.stop(); });
}

}  // namespace

TEST_SUITE("gpio") {
  TEST_CASE("US-36 NFR-3 gpio: lines by name and number, inputs, outputs, active low, safe values") {
    const Chip chip;
    const std::string number = chip.name() + ":4";
    CHECK(GpioLine::input({.line = "sim4"}).place() == number + " (sim4)");
    CHECK(GpioLine::input({.line = 4, .chip = chip.path()}).place() == number + " (sim4)");
    CHECK(GpioLine::input({.line = number}).place() == number + " (sim4)");
    CHECK(GpioLine::input({.line = 4, .chip = "rtdata-bench"}).place() == number + " (sim4)");
    CHECK(has(refusal([&] { (void)GpioLine::input({.line = "sim99"}); }), "not-found"));
    CHECK(has(refusal([&] { (void)GpioLine::input({.line = 16, .chip = chip.path()}); }), "the lines 0 to 15"));

    chip.pull(4, true);
    const GpioLine input = GpioLine::input({.line = "sim4"});
    CHECK(input.read().or_throw());
    chip.pull(4, false);
    CHECK_FALSE(input.read().or_throw());
    chip.pull(5, true);
    CHECK_FALSE(GpioLine::input({.line = "sim5", .active_low = true}).read().or_throw());
    CHECK(GpioLine::input({.line = "sim6", .bias = GpioBias::pull_up}).read().or_throw());
    CHECK_FALSE(GpioLine::input({.line = "sim6", .bias = GpioBias::pull_down}).read().or_throw());

    GpioLine output = GpioLine::output({.line = "sim7", .initial = true, .safe = false, .consumer = "rtdata pump"});
    CHECK(chip.value(7));
    output.set(false).or_throw();
    CHECK_FALSE(chip.value(7));
    output.set(true).or_throw();
    CHECK(chip.value(7));
    const std::string who = refusal([&] { (void)GpioLine::input({.line = "sim7"}); });
    CHECK_MESSAGE(has(who, "busy"), who);
    CHECK_MESSAGE(has(who, "\"rtdata pump\" has it"), who);
  }

  TEST_CASE("US-36 NFR-3 gpio: every edge at 100 us comes with its level and the kernel's time, in order") {
    const Chip chip;
    chip.pull(1, false);
    Loop loop;
    constexpr std::uint64_t wanted = 200;
    bool level = false;
    std::vector<GpioEdge> seen;
    GpioEdges edges(loop, {.line = "sim1"}, [&](const GpioEdge& edge) {
      seen.push_back(edge);
      if (seen.size() == wanted) loop.stop();
    });
    const MonotonicTime begun = now();
    std::uint64_t sent = 0;
    Ticker driver(loop, 100us, [&](const Tick&) {
      if (sent < wanted) {
        chip.pull(1, level = !level);
        ++sent;
      }
    });
    const Timer patience = limit(loop);
    loop.run();
    REQUIRE(seen.size() == wanted);
    MonotonicTime before = begun;
    for (std::size_t i = 0; i < seen.size(); ++i) {
      CHECK(seen[i].level == (i % 2 == 0));
      CHECK(seen[i].number == i + 1);
      CHECK(seen[i].time >= before);
      before = seen[i].time;
    }
    CHECK(before <= now());
    CHECK(edges.counts().lost == 0);
    CHECK(edges.counts().overflows == 0);
  }

  TEST_CASE("US-36 NFR-3 gpio: only the edges that are asked for, and active low turns them round") {
    const Chip chip;
    chip.pull(2, false);
    Loop loop;
    int rising = 0, falling = 0, inverted = 0;
    {
      GpioEdges one(loop, {.line = "sim2", .edges = GpioEdgeKind::rising}, [&](const GpioEdge& edge) {
        CHECK(edge.level);
        ++rising;
      });
      for (int i = 0; i < 6; ++i) chip.pull(2, i % 2 == 0);
      loop.poll();
    }
    {
      GpioEdges one(loop, {.line = "sim2", .active_low = true, .edges = GpioEdgeKind::rising},
                    [&](const GpioEdge& edge) {
                      CHECK(edge.level);
                      ++inverted;
                    });
      for (int i = 0; i < 5; ++i) chip.pull(2, i % 2 == 0);
      loop.poll();
    }
    {
      GpioEdges one(loop, {.line = "sim2", .edges = GpioEdgeKind::falling}, [&](const GpioEdge& edge) {
        CHECK_FALSE(edge.level);
        ++falling;
      });
      chip.pull(2, false);
      chip.pull(2, true);
      loop.poll();
    }
    CHECK(rising == 3);
    CHECK(inverted == 2);
    CHECK(falling == 1);
  }

  TEST_CASE("US-36 NFR-3 gpio: bounces are no edges when there is a debounce") {
    const Chip chip;
    chip.pull(3, false);
    Loop loop;
    std::vector<GpioEdge> seen;
    GpioEdges edges(loop, {.line = "sim3", .debounce = 20ms}, [&](const GpioEdge& edge) { seen.push_back(edge); });
    for (int i = 0; i < 9; ++i) chip.pull(3, i % 2 == 0);
    loop.run_for(100ms);
    REQUIRE(seen.size() == 1);
    CHECK(seen[0].level);
    chip.pull(3, false);
    chip.pull(3, true);
    loop.run_for(100ms);
    CHECK(seen.size() == 1);
    chip.pull(3, false);
    loop.run_for(100ms);
    REQUIRE(seen.size() == 2);
    CHECK_FALSE(seen[1].level);
  }

  TEST_CASE("US-36 NFR-1 edge: of 10 000 in a burst each is received, lost, or told to be not detectable") {
    const Chip chip;
    chip.pull(8, false);
    Loop loop;
    be_quiet(loop);
    std::set<std::string> errors;
    loop.on_error([&](const ErrorReport& report) { errors.insert(std::string(report.error.id())); });
    EdgeSensor sensor(loop, {.name = "burst"}, {.input = {.line = "sim8"}, .required = true});
    for (int i = 0; i < 10'000; ++i) chip.pull(8, i % 2 == 0);  // nobody reads meanwhile
    for (int i = 0; i < 100; ++i) loop.poll();
    const SensorCounts counts = sensor.counts();
    CHECK(counts.published == kept);
    CHECK(counts.lost_is_known == has_numbers);
    CHECK(counts.lost == (has_numbers ? 10'000 - kept : 0));
    CHECK(errors.contains("backlog"));
    CHECK(counts.balances());
    // Read before the store is full, none is lost.
    std::uint64_t sent = 0;
    const Timer patience = limit(loop);
    while (sent < 10'000 && patience.is_running()) {
      if (sensor.counts().published == kept + sent)
        for (int i = 0; i < 10; ++i) chip.pull(8, sent++ % 2 == 0);
      loop.poll();
    }
    while (sensor.counts().published < kept + sent && patience.is_running()) loop.poll();
    CHECK(sensor.counts().published == kept + 10'000);
    CHECK(sensor.counts().lost == counts.lost);
  }

  TEST_CASE("US-36 NFR-3 counter: number and frequency of pulses, also of a burst") {
    const Chip chip;
    chip.pull(9, false);
    Loop loop;
    be_quiet(loop);
    CounterSensor sensor(loop, {.name = "fan", .rate = 10_Hz, .required = true},
                         {.input = {.line = "sim9", .edges = GpioEdgeKind::rising}, .per_pulse = 0.5, .per = "min"});
    std::vector<CounterReading> readings;
    const auto heard = loop.subscribe("fan", [&](const EventView& event) {
      CounterReading reading;
      std::memcpy(&reading, event.payload().data(), sizeof reading);
      readings.push_back(reading);
      if (reading.count >= 500 && readings.size() >= 3) loop.stop();
    });
    bool level = false;
    std::uint64_t sent = 0;
    Ticker driver(loop, 1ms, [&](const Tick&) {  // 500 Hz
      if (sent < 1000) {
        chip.pull(9, level = !level);
        ++sent;
      }
    });
    const Timer patience = limit(loop);
    loop.run();
    REQUIRE(!readings.empty());
    CHECK(readings.back().count == 500);
    double best = 0;
    for (const CounterReading& reading : readings) best = std::max(best, reading.frequency.value_or(0));
    CHECK(best > 0);
    CHECK(best < 2000);
    CHECK(readings.back().overflows == 0);
    for (int i = 0; i < 20'000; ++i) chip.pull(9, i % 2 == 0);
    readings.clear();
    loop.run_for(300ms);
    REQUIRE(!readings.empty());
    CHECK((readings.back().count == 10'500) == has_numbers);
    CHECK((readings.back().overflows > 0) == !has_numbers);
  }

  TEST_CASE("US-36 NFR-1 edge: the chip goes away and comes back: a gap, and another sensor goes on") {
    Chip chip;
    Loop loop;
    be_quiet(loop);
    loop.on_error([](const ErrorReport&) {});
    EdgeSensor sensor(loop, {.name = "door"},
                      {.input = {.line = "sim10"}, .retry_first = 50ms, .retry_longest = 200ms, .required = true});
    Sensor<EdgeReading> other(loop, {.name = "other", .rate = 20_Hz}, [] { return EdgeReading{}; });
    const auto until = [&](const std::function<bool()>& is_so) {
      Ticker look(loop, 5ms, [&](const Tick&) {
        if (is_so()) loop.stop();
      });
      const Timer patience = limit(loop);
      loop.run();
      CHECK(is_so());
    };
    chip.pull(10, true);
    until([&] { return sensor.counts().published == 1; });
    chip.unplug();
    until([&] { return sensor.health() == Health::faulted; });
    loop.run_for(300ms);
    chip.plug_in();
    until([&] { return loop.runtime().sensors().front().outages.number == 1 && chip.is_taken(10); });
    chip.pull(10, true);
    until([&] { return sensor.counts().published == 2; });
    CHECK(sensor.health() == Health::ok);
    CHECK(other.counts().failed == 0);
    CHECK(sensor.counts().balances());
    sensor.stop();
    CHECK_FALSE(chip.is_taken(10));
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("gpio: this is the libgpiod that it should be") {
    const char* expected = std::getenv("RTDATA_TEST_LIBGPIOD");  // "1" or "2", by who runs this
    if (expected != nullptr) CHECK(has_numbers == (std::string(expected) == "2"));
  }
}
