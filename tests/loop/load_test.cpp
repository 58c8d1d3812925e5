#include "rtdata/loop/loop.hpp"

#include <doctest/doctest.h>

#include "loop/observed.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/sensors/analog.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/host.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using observed::Count;

namespace {

/// Says how long it takes.
struct Timed {
  Count read() { return {1}; }
  Duration read_time() const { return 300us; }
};

SensorLoad load(Duration period, std::optional<Duration> phase, std::optional<Duration> on_loop) {
  return {"x", period, phase, {.on_loop = on_loop, .on_lane = {}, .lane = {}}};
}

LoopLoad estimate(std::vector<SensorLoad> sensors) { return estimate_load("fast", sensors); }

}  // namespace

TEST_SUITE_BEGIN("loop");

TEST_CASE("NFR-4 the load of a loop is what comes due within its shortest period, and says what is not declared") {
  const LoopLoad all = estimate({load(2ms, 0ms, 500us), load(2ms, 1ms, 200us), load(1s, 0ms, 700us)});
  CHECK(all.worst == 1400us);  // in each 2 ms both of the first are read, whatever their phases
  CHECK(all.period == 2ms);
  CHECK(all.share() == doctest::Approx(0.7));
  CHECK_FALSE(all.is_overloaded());
  CHECK(all.text() == "fast: 3 sensors, worst 1.4 ms of 2 ms, 70 %");

  const LoopLoad some = estimate({load(2ms, 0ms, 1700us), load(2ms, 0ms, {}), load(0ms, {}, 10us)});
  CHECK(some.is_overloaded());
  CHECK(some.text() == "fast: 3 sensors, worst 1.7 ms of 2 ms, 86 % (2 of 3 declared)");
  CHECK(estimate({load(3ms, 0ms, {})}).text() ==
        "fast: 1 sensor, whose types do not say how long a reading takes; the shortest period is 3 ms");
  CHECK(estimate({load(0ms, {}, 500us)}).text() == "fast: 1 sensor, worst 500 us");
  CHECK(estimate({}).sensors == 0);
  CHECK(estimate({}).share() == 0);
}

TEST_CASE("NFR-4 readings of one longer period meet only when their phases are within the shortest period") {
  const SensorLoad often = load(1ms, 0ms, 100us);
  CHECK(estimate({often, load(10ms, 0ms, 300us), load(10ms, 0ms, 400us)}).worst == 800us);
  CHECK(estimate({often, load(10ms, 0ms, 300us), load(10ms, 5ms, 400us)}).worst == 500us);
  CHECK(estimate({often, load(10ms, 0ms, 300us), load(10ms, 1ms, 400us)}).worst == 500us);
  CHECK(estimate({often, load(10ms, 0ms, 300us), load(10ms, 999us, 400us)}).worst == 800us);
  CHECK(estimate({often, load(10ms, 0ms, 300us), load(10ms, 9500us, 400us)}).worst ==
        800us);  // across the period's end
  CHECK(estimate({often, load(10ms, 0ms, 300us), load(10ms, 29500us, 400us)}).worst ==
        800us);  // phases of several periods
  CHECK(estimate({often, load(10ms, 0ms, 300us), load(10ms, {}, 400us)}).worst ==
        800us);  // it may start whenever it is told
  CHECK(estimate({often, load(10ms, 0ms, 300us), load(20ms, 5ms, 400us)}).worst == 800us);  // another period
  // Three of 3 ms that are spread evenly: one in each millisecond.
  CHECK(estimate({load(1ms, 0ms, 0us), load(3ms, 0ms, 300us), load(3ms, 1ms, 300us), load(3ms, 2ms, 300us)}).worst ==
        300us);
}

TEST_CASE(
    "NFR-4 a lane is overloaded when its reads together do not fit the rates; the loop is held for the decode only") {
  const auto read = [](Duration period, std::optional<Duration> on_lane, const char* lane) {
    return SensorLoad{"x", period, 0ms, {.on_loop = 50us, .on_lane = on_lane, .lane = lane}};
  };
  const LoopLoad load = estimate({read(10ms, 5ms, "adc0"), read(20ms, 8ms, "adc0"), read(1s, {}, "adc0"),
                                  read(10ms, 1ms, "adc1"), read(1s, {}, "adc2")});
  CHECK(load.worst == 126us);  // of the shortest period, as much as they take of the time in the long run
  REQUIRE(load.lanes.size() == 3);
  CHECK(load.lanes[0].share == doctest::Approx(0.9));
  CHECK(load.lanes[0].is_overloaded());
  CHECK(load.lanes[0].text() == "lane adc0: 3 sensors, 90 % (2 of 3 declared)");
  CHECK_FALSE(load.lanes[1].is_overloaded());
  CHECK(load.lanes[1].text() == "lane adc1: 1 sensor, 10 %");
  CHECK(load.lanes[2].text() == "lane adc2: 1 sensor, read times not known");
}

TEST_CASE("NFR-4 a loop knows its load from its devices and settings, before it runs and while it does") {
  Loop loop{Loop::Manual{}};
  CHECK(loop.load().sensors == 0);
  const Sensor<Count> lambda(loop, {.name = "lambda", .rate = 1_kHz}, [] { return Count{1}; });
  const Sensor<Count> timed(loop, {.name = "timed", .rate = 100_Hz}, Timed{});
  const Sensor<Count> set(loop, {.name = "set", .rate = 100_Hz, .phase = 5ms, .read_time = 200us}, Timed{});
  const Feed<Count> fed(loop, {.name = "fed"});
  const AnalogSensor analog(loop, {.name = "analog", .rate = 100_Hz, .phase = 8ms, .read_time = 2ms},
                            {.file = "/sys/none/in_voltage0_raw"});
  const HostSensor process(loop, {.name = "process", .rate = 100_Hz, .phase = 8ms},
                           {.quantity = HostQuantity::process});
  const auto check = [&] {
    const LoopLoad load = loop.load();
    CHECK(load.loop == "main");
    CHECK(load.sensors == 5);
    CHECK(load.declared == 4);
    CHECK(load.period == 1ms);
    CHECK(load.worst == 305us);
    REQUIRE(load.lanes.size() == 1);
    CHECK(load.lanes[0].lane == "/sys/none");
    CHECK(load.lanes[0].share == doctest::Approx(0.2));
  };
  check();
  loop.advance(50ms);
  check();
}

TEST_CASE("NFR-4 a sensor that is stopped counts as one that may start at any time") {
  Loop loop{Loop::Manual{}};
  const Sensor<Count> often(loop, {.name = "often", .rate = 1_kHz, .read_time = 10us}, Timed{});
  const Sensor<Count> one(loop, {.name = "one", .rate = 100_Hz}, Timed{});
  Sensor<Count> other(loop, {.name = "other", .rate = 100_Hz, .phase = 5ms}, Timed{});
  CHECK(loop.load().worst == 310us);
  other.stop();
  CHECK(loop.load().worst == 610us);
  loop.advance(2ms);
  other.start();
  CHECK(loop.load().worst == 310us);
}

TEST_CASE("NFR-4 a tier's load is its own sensors'") {
  Loop loop;
  Tier fast(loop, {.name = "fast"});
  const Sensor<Count> here(loop, {.name = "here", .rate = 10_Hz}, Timed{});
  const Sensor<Count> there(fast.loop(), {.name = "there", .rate = 1_kHz}, Timed{});
  CHECK(fast.loop().load().text() == "fast: 1 sensor, worst 300 us of 1 ms, 30 %");
  CHECK(loop.load().text() == "main: 1 sensor, worst 300 us of 100 ms, 0 %");
  fast.start();
  CHECK(fast.call([](Loop& on) { return on.load(); }).worst == 300us);
}

TEST_CASE("NFR-4 what the library brings says how long it takes") {
  using enum HostQuantity;
  for (const HostQuantity what : {cpu, HostQuantity::load, memory, disk, network, scheduler, process}) {
    const ReadTime time = read_time(HostConfig{.quantity = what, .device = "x"});
    CHECK(time.on_loop.value() > 0us);
    CHECK(time.lane.empty());
  }
  for (const HostQuantity what : {temperature, frequency}) {
    for (const char* device : {"", "cpu0"}) {
      const ReadTime time = read_time(HostConfig{.quantity = what, .device = device});
      CHECK(time.on_loop.value() > 0us);
      CHECK(time.on_lane.value() > time.on_loop.value());
      CHECK_FALSE(time.lane.empty());
    }
  }
  // Readings of one converter share its lane.
  const ReadTime analog = read_time(AnalogConfig{.file = "/sys/bus/iio/devices/iio:device9/in_voltage0_raw"});
  CHECK(analog.on_loop.value() > 0us);
  CHECK_FALSE(analog.on_lane);
  CHECK(analog.lane == read_time(AnalogConfig{.file = "/sys/bus/iio/devices/iio:device9/in_voltage1_raw"}).lane);
}

TEST_SUITE_END();
