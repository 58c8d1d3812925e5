#include <doctest/doctest.h>

#include <algorithm>
#include <memory>
#include <vector>

#include "loop/observed.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using observed::Count;

namespace {

/// Counts, and takes virtual time for it when it is told to.
struct Reader {
  Loop& loop;
  Duration& takes;
  Count read() {
    if (takes.count() > 0) loop.manual_clock().pass(takes);
    return {1};
  }
};

/// In nanoseconds, so that a rate that cannot be written exactly does no harm.
Duration period_of(const AnySensor& sensor) { return sensor.rate().period(); }

}  // namespace

TEST_SUITE_BEGIN("loop");

TEST_CASE("NFR-4 p99 is estimated: 99 of 100 took no longer, to some 15 %") {
  std::uint32_t state = 12345;
  const auto random = [&] {
    state = state * 1664525U + 1013904223U;
    return (state >> 8) % 1000;  // 0 to 999
  };
  CallbackTimes steady;
  CHECK(steady.p99() == Duration{0});
  for (int i = 0; i < 1000; ++i) steady.add(20us);
  CHECK(steady.p99() > 19us);
  CHECK(steady.p99() <= 20us);

  CallbackTimes even;  // 1 to 1000 us, each as often
  for (int i = 0; i < 200'000; ++i) even.add(1us * (random() + 1));
  CHECK(even.p99() > 850us);
  CHECK(even.p99() <= 1ms);

  CallbackTimes rare;  // one in 500 is long: beyond the p99
  for (int i = 0; i < 200'000; ++i) rare.add(random() < 2 ? 5ms : 10us);
  CHECK(rare.p99() >= 9us);
  CHECK(rare.p99() < 15us);
  CHECK(rare.max == 5ms);
  CHECK(rare.count == 200'000);

  CallbackTimes frequent;  // three in 100 are
  for (int i = 0; i < 200'000; ++i) frequent.add(random() < 30 ? 5ms : 10us);
  CHECK(frequent.p99() > 4ms);
  CHECK(frequent.p99() <= 5ms);
}

TEST_CASE("NFR-4 every callback is listed with its name, place, times and how often it held the loop") {
  Loop loop{Loop::Manual{}};
  std::vector<std::string> reports;
  loop.on_error(
      [&](const ErrorReport& report) { reports.push_back(std::string(report.object) + "|" + report.error.where); });
  loop.runtime().note_place("sensor slow", "bench.json:3:5");
  Duration slow_takes{20ms}, quick_takes{0};
  Sensor<Count> slow(loop, {.name = "slow", .rate = 1_Hz}, Reader{loop, slow_takes});
  Sensor<Count> quick(loop, {.name = "quick", .rate = 1_Hz}, Reader{loop, quick_takes});
  auto handler = loop.subscribe("quick", [](const EventView&) {});
  Ticker ticker(loop, Ticker::Config{.period = 500ms, .name = "blink"}, [](const Tick&) {});
  Timer timer(loop, Timer::Config{.name = "launch"}, [&] { loop.manual_clock().pass(30ms); });
  timer.start(3900ms);
  loop.advance(4s);
  const auto all = loop.callbacks();
  REQUIRE(all.size() == 5);
  CHECK(all[0].name == "sensor slow");
  CHECK(all[0].place == "bench.json:3:5");
  CHECK(all[0].times.held == 5);
  CHECK(all[0].times.count == 5);
  CHECK(all[0].times.total == 100ms);
  CHECK(all[0].times.max == 20ms);
  CHECK(all[0].times.p99() <= 20ms);
  CHECK(all[0].times.p99() > 19ms);
  CHECK(all[1].name == "sensor quick");
  CHECK(all[1].place.empty());
  CHECK(all[1].times.held == 0);
  CHECK(all[1].times.count == 5);
  CHECK(all[2].name == "handler of quick");
  CHECK(all[2].times.count == 5);
  CHECK(all[3].name == "blink");
  CHECK(all[3].times.count >= 8);
  CHECK(all[4].name == "launch");
  CHECK(all[4].times.held == 1);
  REQUIRE(reports.size() > 1);
  for (std::size_t i = 0; i < reports.size(); ++i) {
    const bool is_timer = reports[i] == "launch|loop main";
    CHECK((is_timer || reports[i] == "sensor slow|bench.json:3:5: loop main"));
    CHECK((!is_timer || i + 1 == reports.size() || i + 2 == reports.size()));
  }
}

TEST_CASE("US-5 on_overrun warn: an overrun is reported and counted, and nothing more happens") {
  Loop loop{Loop::Manual{}};
  loop.on_error([](const ErrorReport&) {});
  Duration takes{12ms};
  Sensor<Count> sensor(loop, {.name = "s", .rate = 10_Hz}, Reader{loop, takes});
  loop.advance(1s);
  CHECK(sensor.times().held == 11);
  CHECK(period_of(sensor) == 100ms);
  CHECK(sensor.health() == Health::ok);
}

TEST_CASE("US-5 on_overrun slow down: each overrun halves the sensor's rate, to a sixteenth; others keep theirs") {
  Loop loop{Loop::Manual{}};
  std::vector<std::string> slowed;
  loop.on_error([&](const ErrorReport& report) {
    if (report.error.what.starts_with("slowed")) slowed.push_back(report.error.text());
  });
  Duration takes{0};
  Duration none{0};
  Sensor<Count> sensor(loop, {.name = "s", .rate = 10_Hz, .on_overrun = OnOverrun::slow_down}, Reader{loop, takes});
  Sensor<Count> other(loop, {.name = "other", .rate = 10_Hz, .on_overrun = OnOverrun::slow_down}, Reader{loop, none});
  loop.advance(950ms);
  CHECK(period_of(sensor) == 100ms);
  takes = 15ms;
  loop.advance(50ms);  // one overrun at 1 s
  CHECK(period_of(sensor) == 200ms);
  const auto before = sensor.counts().scheduled;
  takes = Duration{0};
  loop.advance(1s);
  CHECK(sensor.counts().scheduled - before == 5);  // no tick was taken twice, none left out
  REQUIRE(slowed.size() == 1);                     // within a second of what is told first: who held the loop
  CHECK(slowed[0].starts_with("slowed down to one read every 200 ms: sensor s: a read held the loop for 15 ms: "));
  CHECK(slowed[0].ends_with("; the configured period is 100 ms"));
  takes = 15ms;
  loop.advance(20s);
  CHECK(period_of(sensor) == 1600ms);
  CHECK(slowed.back().starts_with("slowed down to one read every 1.6 s: "));
  CHECK(sensor.health() == Health::ok);
  CHECK(period_of(other) == 100ms);
  CHECK(other.counts().missed == 0);
  sensor.set_rate(10_Hz);
  CHECK(period_of(sensor) == 100ms);
  takes = Duration{0};
  loop.advance(1s);
  CHECK(period_of(sensor) == 100ms);
  takes = 15ms;
  loop.advance(100ms);
  CHECK(period_of(sensor) == 200ms);  // from the newly wanted rate
  loop.close();
  CHECK(loop.runtime().balances());
}

TEST_CASE("US-5 on_overrun stop: the offender is stopped and faulted with the reason, until it is started again") {
  Loop loop{Loop::Manual{}};
  std::vector<std::string> ids;
  loop.on_error([&](const ErrorReport& report) {
    ids.push_back(std::string(report.object) + " " + std::string(report.error.id()));
  });
  loop.runtime().on_log([](const LogRecord&) {});
  Duration takes{15ms};
  Duration none{0};
  Sensor<Count> sensor(loop, {.name = "s", .rate = 10_Hz, .on_overrun = OnOverrun::stop}, Reader{loop, takes});
  Sensor<Count> other(loop, {.name = "other", .rate = 10_Hz, .on_overrun = OnOverrun::stop}, Reader{loop, none});
  loop.advance(1s);
  CHECK_FALSE(sensor.is_running());
  CHECK(sensor.health() == Health::faulted);
  CHECK(sensor.status().reason.find("held the loop for 15 ms") != std::string::npos);
  CHECK(sensor.counts().scheduled == 1);
  CHECK(sensor.counts().taken == 1);
  CHECK(other.is_running());
  CHECK(other.counts().taken == 11);
  CHECK(std::count(ids.begin(), ids.end(), "sensor s held-too-long") >= 1);
  takes = Duration{0};
  sensor.start();
  CHECK(sensor.health() == Health::ok);
  loop.advance(1s);
  CHECK(sensor.is_running());
  CHECK(sensor.counts().taken >= 11);
  loop.close();
  CHECK(loop.runtime().balances());
}

TEST_CASE("US-5 a sensor may be destroyed by the handler of the report on its overrun") {
  for (const OnOverrun what : {OnOverrun::warn, OnOverrun::slow_down, OnOverrun::stop}) {
    Loop loop{Loop::Manual{}};
    loop.runtime().on_log([](const LogRecord&) {});
    Duration takes{15ms};
    auto sensor = std::make_unique<Sensor<Count>>(loop, SensorConfig{.name = "s", .rate = 10_Hz, .on_overrun = what},
                                                  Reader{loop, takes});
    loop.on_error([&](const ErrorReport&) { sensor = nullptr; });
    loop.advance(1s);
    CHECK(sensor == nullptr);
  }
}

TEST_SUITE_END();
