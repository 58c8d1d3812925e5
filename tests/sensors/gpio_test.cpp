// Lines, edges and pulses on GPIO chips made of memory, in virtual time.
#include <doctest/doctest.h>

#include <cerrno>
#include <cstring>
#include <functional>
#include <string>
#include <vector>

#include "has.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/sensors/counter.hpp"
#include "rtdata/sensors/edge.hpp"
#include "rtdata/sensors/levels.hpp"
#include "rtdata/testing/fake_gpio.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace rtdata::literals;

TEST_SUITE_BEGIN("sensors");

namespace {

std::shared_ptr<FakeGpio> board(FakeGpio::Like like = FakeGpio::Like::libgpiod_2) {
  auto pins = std::make_shared<FakeGpio>(like);
  pins->add_chip("gpiochip0", 32, "GPIO", "pinctrl");
  return pins;
}

std::string refusal(const std::function<void()>& make) {
  try {
    make();
    return "";
  } catch (const SetupError& error) {
    return std::string(error.error().id()) + ": " + error.error().text();
  }
}
using rtdata::test::has;

/// Drives a line of gpiochip0 in the time of a manual loop.
struct Wire {
  Loop& loop;
  FakeGpio& pins;
  unsigned number;
  bool is_high = false;
  void set(bool high) { pins.drive("gpiochip0", number, is_high = high, loop.manual_clock().monotonic()); }
  void toggle() { set(!is_high); }
};

struct GpioBench {
  explicit GpioBench(FakeGpio::Like like = FakeGpio::Like::libgpiod_2) : pins(board(like)) {
    be_quiet(loop);
    loop.on_error([this](const ErrorReport& report) {
      if (report.error.code != Errc::held_too_long) errors.push_back(std::string(report.error.id()));
    });
  }
  Loop loop{Loop::Manual{}};
  std::shared_ptr<FakeGpio> pins;
  std::vector<std::string> errors;
  Wire wire{loop, *pins, 17};
};

CounterReading reading_of(const EventView& event) {
  REQUIRE(event.payload().size() == sizeof(CounterReading));
  CounterReading reading;
  std::memcpy(&reading, event.payload().data(), sizeof reading);
  return reading;
}

}  // namespace

TEST_CASE("US-36 a line is found by its name, its number and its chip, and what is wrong is said with what there is") {
  auto pins = board();
  for (const GpioLineName& name : std::initializer_list<GpioLineName>{"GPIO17", 17, "gpiochip0:17", "/dev/gpiochip0:17",
                                                                      "pinctrl:17", "gpiochip0:GPIO17"}) {
    CHECK(GpioLine::input({.line = name}, pins).place() == "gpiochip0:17 (GPIO17)");
  }
  CHECK(GpioLine::input({.line = 17, .chip = "pinctrl"}, pins).is_open());
  const auto said = [&](GpioInput input) { return refusal([&] { (void)GpioLine::input(input, pins); }); };
  CHECK(has(said({.line = 32}), "not-found: cannot use the GPIO line: line 32: gpiochip0 has the lines 0 to 31"));
  CHECK(has(said({.line = "GPIQ17"}), "did you mean GPIO17?"));
  CHECK(has(said({.line = 1, .chip = "gpiochip7"}),
            "there is no chip gpiochip7; available: gpiochip0 (pinctrl, 32 lines)"));
  CHECK(has(said({.line = "gpiochip7:1"}), "there is no chip gpiochip7"));

  pins->add_chip("gpiochip1", 8, "GPIO", "expander");
  CHECK(has(said({.line = 3}), "bad-argument"));
  CHECK(has(said({.line = 3}), "gpiochip0 (pinctrl, 32 lines), gpiochip1 (expander, 8 lines)"));
  CHECK(has(said({.line = "GPIO3"}), "several lines have this name: gpiochip0:3, gpiochip1:3"));
  CHECK(GpioLine::input({.line = "GPIO3", .chip = "expander"}, pins).place() == "gpiochip1:3 (GPIO3)");
  CHECK(GpioLine::input({.line = "GPIO17"}, pins).is_open());

  pins->refuse("gpiochip1", EACCES);
  CHECK(has(said({.line = 3, .chip = "gpiochip1"}), "not-permitted"));
  CHECK(has(said({.line = 3, .chip = "gpiochip1"}), "usermod -aG gpio"));
  CHECK(has(said({.line = 3}), "not-permitted"));  // the line may be there
  pins->unplug("gpiochip0");
  pins->unplug("gpiochip1");
  CHECK(has(said({.line = 3}), "this machine has no GPIO chip"));
}

TEST_CASE("US-36 a line that somebody has is refused, with who that is") {
  auto pins = board();
  pins->occupy("gpiochip0", 17, "led0");
  const auto said = [&] { return refusal([&] { (void)GpioLine::output({.line = "GPIO17"}, pins); }); };
  CHECK(has(said(), "busy: cannot use the GPIO line: gpiochip0:17 (GPIO17): \"led0\" has it"));
  pins->occupy("gpiochip0", 17, "");
  const GpioLine first = GpioLine::input({.line = 17, .consumer = "rtdata door"}, pins);
  CHECK(has(said(), "\"rtdata door\" has it"));
}

TEST_CASE("US-36 an output is set HIGH and LOW, and has its safe value at the end, whichever way that comes") {
  auto pins = board();
  {
    GpioLine line = GpioLine::output({.line = 5, .initial = true, .safe = false}, pins);
    CHECK(pins->level("gpiochip0", 5));
    line.set(false).or_throw();
    CHECK_FALSE(pins->level("gpiochip0", 5));
    line.set(true).or_throw();
    CHECK(line.read().or_throw());
    GpioLine other = std::move(line);
    CHECK_FALSE(line.is_open());
    CHECK(line.set(true).error().code == Errc::closed);
    CHECK(pins->level("gpiochip0", 5));
    other.close();
    CHECK_FALSE(pins->level("gpiochip0", 5));
    CHECK_FALSE(pins->is_taken("gpiochip0", 5));
    other.close();
    line = GpioLine::output({.line = 5, .active_low = true, .safe = true}, pins);  // safe is low on the wire
    CHECK(pins->level("gpiochip0", 5));
  }
  CHECK_FALSE(pins->level("gpiochip0", 5));
  {
    GpioLine left = GpioLine::output({.line = 6, .initial = true}, pins);
    left = GpioLine::output({.line = 7}, pins);
    CHECK_FALSE(pins->is_taken("gpiochip0", 6));
    CHECK(pins->level("gpiochip0", 6));  // without a safe value it is left as it is
    pins->unplug("gpiochip0");
    CHECK(left.set(true).error().code == Errc::disconnected);
  }
  pins->plug_in("gpiochip0");
  GpioLine input = GpioLine::input({.line = 8}, pins);
  CHECK(input.set(true).error().code == Errc::bad_argument);
}

TEST_CASE("US-36 edges come on the loop with the kernel's time, numbered, those that were dropped too") {
  GpioBench bench;
  std::vector<GpioEdge> seen;
  GpioEdges edges(
      bench.loop, {.line = 17}, [&](const GpioEdge& edge) { seen.push_back(edge); }, bench.pins);
  CHECK(edges.lost_is_known());
  bench.loop.advance(5ms);
  bench.wire.set(true);
  bench.loop.manual_clock().pass(3ms);  // read later than it came
  bench.loop.poll();
  REQUIRE(seen.size() == 1);
  CHECK(seen[0].level);
  CHECK(seen[0].number == 1);
  CHECK(seen[0].time.time_since_epoch() == 5ms);
  CHECK(edges.read().or_throw());
  for (int i = 0; i < 10'000; ++i) bench.wire.toggle();
  for (int i = 0; i < 100; ++i) bench.loop.poll();
  CHECK(seen.size() == 1 + 1024);
  CHECK(seen.back().number == 10'001);
  CHECK(edges.counts().lost == 10'000 - 1024);
  CHECK(edges.counts().edges + edges.counts().lost == 10'001);
  CHECK(bench.errors == std::vector<std::string>{"backlog"});
  seen.clear();
  bench.pins->drive("gpiochip0", 17, !bench.wire.is_high, MonotonicTime{1'700'000'000s});  // of the time of day
  bench.loop.poll();
  REQUIRE(seen.size() == 1);
  CHECK(seen[0].time == bench.loop.manual_clock().monotonic());
}

TEST_CASE("US-36 without numbers, edges that may be lost are told: libgpiod 1") {
  GpioBench bench(FakeGpio::Like::libgpiod_1);
  std::uint64_t seen = 0;
  GpioEdges edges(
      bench.loop, {.line = 17, .edges = GpioEdgeKind::rising}, [&](const GpioEdge&) { ++seen; }, bench.pins);
  CHECK_FALSE(edges.lost_is_known());
  for (int i = 0; i < 30; ++i) bench.wire.toggle();
  bench.loop.poll();
  CHECK(seen == 15);
  CHECK(edges.counts().overflows == 0);
  for (int i = 0; i < 10'000; ++i) bench.wire.toggle();
  for (int i = 0; i < 10; ++i) bench.loop.poll();
  CHECK(seen == 15 + 16);
  CHECK(edges.counts().overflows == 1);
  CHECK(edges.counts().lost == 0);
  CHECK(bench.errors == std::vector<std::string>{"backlog"});
}

TEST_CASE("US-36 debounce without the kernel's help: a level counts when it has lasted, bounces are filtered") {
  GpioBench bench(FakeGpio::Like::libgpiod_1);
  std::vector<GpioEdge> seen;
  GpioEdges edges(
      bench.loop, {.line = 17, .edges = GpioEdgeKind::rising, .debounce = 10ms},
      [&](const GpioEdge& edge) { seen.push_back(edge); }, bench.pins);
  bench.loop.advance(1s);
  for (int i = 0; i < 7; ++i) {  // a button that bounces for 6 ms, and ends high
    bench.wire.toggle();
    bench.loop.advance(1ms);
  }
  CHECK(seen.empty());
  bench.loop.advance(9ms);
  REQUIRE(seen.size() == 1);
  CHECK(seen[0].level);
  CHECK(seen[0].time.time_since_epoch() == 1s + 6ms);
  CHECK(edges.counts().filtered == 6);
  bench.wire.toggle();
  bench.loop.advance(1ms);
  bench.wire.toggle();  // a spike
  bench.loop.advance(1s);
  CHECK(seen.size() == 1);
  CHECK(edges.counts().filtered == 8);
  bench.wire.set(false);
  bench.loop.advance(20ms);
  bench.wire.set(true);
  for (int i = 0; i < 40; ++i) bench.wire.toggle();  // the kernel's store overflows: what the line is, counts
  bench.loop.advance(20ms);
  CHECK(seen.size() == 2);
  CHECK(seen.back().number == 2);
}

TEST_CASE("US-36 a chip that goes away is told once, also where the kernel does not say so") {
  for (const bool hangs_up : {true, false}) {
    GpioBench bench;
    std::uint64_t calls = 0;
    GpioEdges edges(
        bench.loop, {.line = 17}, [&](const GpioEdge&) { ++calls; }, bench.pins);
    bench.loop.advance(500ms);
    bench.pins->unplug("gpiochip0", hangs_up);
    bench.loop.poll();
    CHECK(edges.failure().has_value() == hangs_up);
    bench.loop.advance(1s);
    REQUIRE(edges.failure());
    CHECK(edges.failure()->code == Errc::disconnected);
    CHECK(edges.read().error().code == Errc::disconnected);
    bench.pins->plug_in("gpiochip0");
    bench.loop.advance(10s);
    edges.take_waiting();
    CHECK(bench.errors == std::vector<std::string>{"disconnected"});
    CHECK(edges.is_open());
  }
}

TEST_CASE("US-36 NFR-1 edge: a burst of 10 000 is received or counted as lost, an unplugged chip is a gap") {
  GpioBench bench;
  EdgeSensor sensor(bench.loop, {.name = "door"}, {.input = {.line = "GPIO17"}, .retry_first = 100ms}, bench.pins);
  std::uint64_t heard = 0, last = 0;
  Time before{};
  const auto subscription = bench.loop.subscribe<EdgeReading>("door", [&](const Event<EdgeReading>& event) {
    ++heard;
    CHECK(event->count > last);
    CHECK(event->level == (event->count % 2 == 1));
    CHECK(event.time > before);
    before = event.time;
    last = event->count;
  });
  CHECK(sensor.health() == Health::ok);
  for (int i = 0; i < 10'000; ++i) bench.wire.toggle();
  for (int i = 0; i < 100; ++i) bench.loop.poll();
  SensorCounts counts = sensor.counts();
  CHECK(counts.lost_is_known);
  CHECK(counts.published == 1024);
  CHECK(counts.lost == 10'000 - 1024);
  CHECK(heard == counts.published);
  CHECK(last == 10'000);
  CHECK(bench.errors == std::vector<std::string>{"backlog"});

  bench.pins->unplug("gpiochip0");
  bench.loop.advance(1s);
  CHECK(sensor.health() == Health::faulted);
  CHECK(sensor.status().reason.find("its chip is gone") != std::string::npos);
  bench.wire.toggle();  // nobody sees it
  bench.wire.toggle();
  bench.loop.advance(3s);
  bench.pins->plug_in("gpiochip0");
  bench.loop.advance(5s);
  CHECK(sensor.health() == Health::ok);
  bench.wire.toggle();
  bench.loop.poll();
  CHECK(last == 10'001);
  counts = sensor.counts();
  CHECK(counts.published == 1025);
  CHECK(counts.lost == 10'000 - 1024);
  REQUIRE(bench.loop.runtime().sensors().size() == 1);
  CHECK(bench.loop.runtime().sensors()[0].outages.number == 1);
  CHECK(counts.balances());

  sensor.stop();
  CHECK_FALSE(bench.pins->is_taken("gpiochip0", 17));
  bench.wire.toggle();
  bench.loop.advance(1s);
  CHECK(heard == 1025);
  sensor.start();
  CHECK(bench.pins->is_taken("gpiochip0", 17));
  CHECK(bench.loop.runtime().balances());
}

TEST_CASE("US-36 edge: with libgpiod 1 lost is not detectable, and a full store is told; bounces are filtered") {
  GpioBench bench(FakeGpio::Like::libgpiod_1);
  EdgeSensor sensor(bench.loop, {.name = "door"}, {.input = {.line = "GPIO17"}}, bench.pins);
  for (int i = 0; i < 10'000; ++i) bench.wire.toggle();
  bench.loop.poll();
  CHECK(sensor.counts().published == 16);
  CHECK_FALSE(sensor.counts().lost_is_known);
  CHECK(sensor.health() == Health::degraded);
  CHECK(bench.errors == std::vector<std::string>{"backlog"});
  CHECK(sensor.status().outages.number == 1);  // how many are missing is not known
  CHECK(bench.loop.runtime().has_loss());
  EdgeSensor button(bench.loop, {.name = "button"}, {.input = {.line = 3, .debounce = 5ms}}, bench.pins);
  Wire wire{bench.loop, *bench.pins, 3};
  for (int i = 0; i < 3; ++i) {
    wire.toggle();
    bench.loop.advance(1ms);
  }
  bench.loop.advance(10ms);
  CHECK(button.counts().published == 1);
  CHECK(button.counts().filtered == 2);
  CHECK(button.counts().received == 3);
  CHECK(bench.loop.runtime().balances());
}

TEST_CASE("US-36 edge: absent at the start, silent, taken by another, and required") {
  GpioBench bench;
  bench.pins->occupy("gpiochip0", 17, "another");
  EdgeSensor sensor(bench.loop, {.name = "door"},
                    {.input = {.line = 17}, .silence = 10s, .retry_first = 1s, .retry_longest = 1s}, bench.pins);
  CHECK(sensor.health() == Health::faulted);
  CHECK(has(std::string(sensor.status().reason), "\"another\" has it"));
  CHECK(has(refusal([&] {
              EdgeSensor(bench.loop, {.name = "other"}, {.input = {.line = 17}, .required = true}, bench.pins);
            }),
            "busy"));
  CHECK(has(refusal([&] { EdgeSensor(bench.loop, {.name = "other"}, {}, bench.pins); }), "it has no line"));
  bench.pins->occupy("gpiochip0", 17, "");
  bench.loop.advance(2s);
  bench.wire.toggle();
  bench.loop.poll();
  CHECK(sensor.health() == Health::ok);
  bench.loop.advance(11s);
  CHECK(sensor.health() == Health::degraded);
  bench.wire.toggle();
  bench.loop.poll();
  CHECK(sensor.health() == Health::ok);
  CHECK(bench.loop.runtime().sensors()[0].outages.number == 2);
}

TEST_CASE("US-36 counter: number, frequency and what they stand for, from the kernel's times") {
  GpioBench bench;
  CounterSensor sensor(bench.loop, {.name = "flow", .rate = 1_Hz},
                       {.input = {.line = 17, .edges = GpioEdgeKind::rising},
                        .per_pulse = 0.5,
                        .unit = "L",
                        .per = "min",
                        .still_after = 3s},
                       bench.pins);
  std::vector<CounterReading> readings;
  const auto heard = bench.loop.subscribe("flow",
                                          [&](const EventView& event) { readings.push_back(reading_of(event)); });
  const auto pulse = [&](Duration before, Duration after) {
    bench.loop.advance(before);
    bench.wire.set(true);
    bench.wire.set(false);
    bench.loop.advance(after);
  };
  bench.loop.advance(0ns);  // the first tick is at the start
  REQUIRE(readings.size() == 1);
  CHECK(readings[0].count == 0);
  CHECK_FALSE(readings[0].frequency);
  for (int i = 0; i < 10; ++i) pulse(50ms, 50ms);
  REQUIRE(readings.size() == 2);
  CHECK(readings[1].count == 10);
  CHECK(readings[1].total == doctest::Approx(5));
  REQUIRE(readings[1].frequency);
  CHECK(*readings[1].frequency == doctest::Approx(10));  // nine intervals of 0.1 s
  CHECK(*readings[1].speed == doctest::Approx(300));     // L/min
  pulse(450ms, 550ms);                                   // 0.5 s after the last
  REQUIRE(readings.size() == 3);
  CHECK(*readings[2].frequency == doctest::Approx(2));
  bench.loop.advance(1s);
  CHECK_FALSE(readings.back().frequency);  // nobody knows yet
  CHECK_FALSE(readings.back().speed);
  bench.loop.advance(3s);
  CHECK(*readings.back().frequency == 0);
  pulse(100ms, 0ms);
  pulse(200ms, 700ms);
  CHECK(*readings.back().frequency == doctest::Approx(5));  // not since long ago
  CHECK(readings.back().count == 13);
  // 10 000 at once are dropped by the kernel for the most part, and counted all the same.
  for (int i = 0; i < 10'000; ++i) {
    bench.wire.set(true);
    bench.wire.set(false);
  }
  bench.loop.advance(1s);
  CHECK(readings.back().count == 10'013);
  CHECK(readings.back().overflows == 0);
  CHECK(bench.errors.empty());

  const SensorCounts before = sensor.counts();
  CHECK(before.failed == 0);
  bench.pins->unplug("gpiochip0");
  bench.loop.advance(10s);
  CHECK(sensor.health() == Health::faulted);
  CHECK(sensor.counts().failed >= 9);
  bench.pins->plug_in("gpiochip0");
  bench.loop.advance(30s);
  CHECK(sensor.health() == Health::ok);
  pulse(100ms, 900ms);
  CHECK(readings.back().count == 10'014);
  CHECK_FALSE(readings.back().frequency);
  CHECK(sensor.counts().balances());
  CHECK(bench.loop.runtime().balances());
}

TEST_CASE("US-36 counter: with libgpiod 1 pulses that may be missing are told, and in the data") {
  GpioBench bench(FakeGpio::Like::libgpiod_1);
  CounterSensor sensor(bench.loop, {.name = "fan", .rate = 10_Hz}, {.input = {.line = 17}}, bench.pins);
  std::vector<CounterReading> readings;
  const auto heard = bench.loop.subscribe("fan",
                                          [&](const EventView& event) { readings.push_back(reading_of(event)); });
  for (int i = 0; i < 100; ++i) bench.wire.toggle();
  bench.loop.advance(100ms);
  CHECK(readings.back().count == 16);
  CHECK(readings.back().overflows == 1);
  CHECK(bench.errors == std::vector<std::string>{"backlog"});
  CHECK(sensor.health() == Health::ok);
  CHECK(has(counter_description({.unit = "kW.h", .per = "h"}).or_throw()->to_json(), "(kW.h)/h"));
}

TEST_CASE("US-36 gpio: the levels of several lines at a rate, read on a lane, through an outage") {
  GpioBench bench;
  LevelsConfig config{
      .lines = {{.name = "front", .line = "GPIO17"}, {.name = "back", .line = "gpiochip0:3", .active_low = true}}};
  LevelsSensor sensor(bench.loop, {.name = "doors", .rate = 10_Hz, .retry_first = 100ms}, config, bench.pins);
  std::vector<std::string> seen;
  const auto heard = bench.loop.subscribe("doors", [&](const EventView& event) {
    seen.push_back(to_string(event.value("front").value()) + " " + to_string(event.value("back").value()));
  });
  bench.loop.advance(50ms);
  bench.wire.set(true);
  bench.loop.advance(100ms);
  bench.pins->drive("gpiochip0", 3, true, {});
  bench.loop.advance(100ms);
  CHECK(seen == std::vector<std::string>{"false true", "true true", "true false"});
  CHECK(bench.pins->is_taken("gpiochip0", 3));
  bench.pins->unplug("gpiochip0");
  bench.loop.advance(5s);
  CHECK(sensor.health() == Health::faulted);
  CHECK(sensor.status().reason.find("its chip is gone") == std::string::npos);  // now it is: there is no chip
  bench.pins->plug_in("gpiochip0");
  bench.loop.advance(10s);
  CHECK(sensor.health() == Health::ok);
  CHECK(seen.back() == "true false");
  CHECK(sensor.counts().failed > 0);
  sensor.stop();
  bench.loop.advance(1s);
  CHECK_FALSE(bench.pins->is_taken("gpiochip0", 3));
  CHECK_FALSE(bench.pins->is_taken("gpiochip0", 17));
  CHECK(sensor.counts().balances());
  CHECK(has(refusal([&] { LevelsSensor(bench.loop, {.name = "x", .rate = 1_Hz}, {}, bench.pins); }),
            "there are no lines"));
  config.lines[1] = config.lines[0];
  config.lines[1].name = "again";
  CHECK(has(refusal([&] { LevelsSensor(bench.loop, {.name = "x", .rate = 1_Hz}, config, bench.pins); }),
            "GPIO17 is listed twice"));
}

TEST_CASE("US-36 NFR-5 two sensors on one line are a mistake that check tells, however its chip is written") {
  const Registry registry = standard_registry();
  if (!registry.sensors().find("edge")) {
    MESSAGE("skipped: there is no libgpiod");
    return;
  }
  const auto told = [&](const std::string& first, const std::string& second) {
    const std::string text = R"({"sensors": [{"name": "a", "type": "edge", )" + first +
                             R"(}, {"name": "b", "type": "counter", "rate": "1 Hz", )" + second + "}]}";
    return plan_system(registry, parse_config(text, "f.json")).problems.text();
  };
  const std::string mistake = "has the GPIO line gpiochip0:17 already; give each part its own";
  CHECK(has(told(R"("line": "gpiochip0:17")", R"("line": "gpiochip0:17")"), mistake));
  CHECK(has(told(R"("line": "gpiochip0:17")", R"("line": 17, "chip": "/dev/gpiochip0")"), mistake));
  CHECK(has(told(R"("line": "GPIO17")", R"("line": "GPIO17")"), "has the GPIO line GPIO17 already"));
  const std::string
      levels = R"({"sensors": [{"name": "a", "type": "gpio", "rate": "1 Hz", "lines": [{"name": "x", "line": 4,
      "chip": "gpiochip0"}, {"name": "y", "line": "gpiochip0:17"}]}, {"name": "b", "type": "edge", "line": "gpiochip0:17"}]})";
  CHECK(has(plan_system(registry, parse_config(levels, "f.json")).problems.text(), mistake));
  CHECK(told(R"("line": "GPIO17")", R"("line": "GPIO18")").empty());
  CHECK(told(R"("line": 17, "chip": "gpiochip0")", R"("line": 17, "chip": "gpiochip1")").empty());
}

TEST_SUITE_END();
