#include "rtdata/sensors/limit.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "rtdata/app/program.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "sensors/fixture.hpp"
#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace std::chrono_literals;

namespace {

struct Tank {
  std::optional<double> pressure{};
  std::int16_t level = 0;
  RTDATA_FIELDS(Tank, (pressure, "Pa"), (level))
};

constexpr LimitLevel low_low = LimitLevel::low_low, low = LimitLevel::low, normal = LimitLevel::normal,
                     high = LimitLevel::high, high_high = LimitLevel::high_high, unknown = LimitLevel::unknown;

Time at(Duration since) { return Time{std::chrono::hours{24 * 365}} + since; }

/// A limit's sensor on a manual loop, and what it publishes.
struct LimitBench {
  explicit LimitBench(LimitConfig config) : loop(Loop::Manual{}) {
    be_quiet(loop);
    tank = Feed<Tank>(loop, {.name = "tank"});
    config.on = "tank";
    config.field = "pressure";
    sensor = LimitSensor(loop, {.name = "alarm"}, config);
    sensor.on_error([this](const ErrorReport& report) { errors.push_back(report.error.why); });
    subscription = loop.subscribe<Alarm>("alarm", [this](const Event<Alarm>& event) { alarms.push_back(*event); });
  }
  void take(std::optional<double> pressure, Duration after = 100ms) {
    loop.advance(after);
    tank.publish(Tank{pressure}, loop.time());
    loop.poll();
  }
  /// Levels and alarms since it was asked last.
  std::vector<LimitLevel> levels() {
    std::vector<LimitLevel> all;
    for (const Alarm& alarm : alarms) all.push_back(alarm.level);
    alarms.clear();
    return all;
  }

  Loop loop;
  Feed<Tank> tank;
  LimitSensor sensor;
  Subscription subscription;
  std::vector<Alarm> alarms;
  std::vector<std::string> errors;
};

std::vector<std::string> problems_of(const std::string& limit) {
  std::vector<std::string> all;
  const std::string load = R"({"name": "load", "type": "host", "quantity": "load", "rate": "10 Hz"})";
  for (const Problem& problem :
       plan_system(standard_registry(), parse_config(R"({"sensors": [)" + load + ", " + limit + "]}", "f.json"))
           .problems)
    all.push_back(problem.text());
  return all;
}

}  // namespace

TEST_SUITE_BEGIN("sensors");

TEST_CASE("limits: levels, hysteresis, and the edges of both") {
  LimitWatch watch({.low_low = 0, .low = 10, .high = 20, .high_high = 30, .hysteresis = 2});
  const std::vector<std::pair<double, LimitLevel>> steps{
      {15, normal},    {20, normal},      {20.1, high}, {18.1, high},  {18, normal},    {30, high},
      {31, high_high}, {28.1, high_high}, {28, high},   {-1, low_low}, {1.9, low_low},  {2, low},
      {11.9, low},     {12, normal},      {10, normal}, {9.9, low},    {35, high_high}, {15, normal}};
  Duration now{0};
  for (const std::pair<double, LimitLevel>& step : steps) {
    CAPTURE(step.first);
    watch.take(step.first, at(now += 1s));
    CHECK(watch.state().level == step.second);
    CHECK(watch.state().alarm == step.second);
    CHECK(watch.state().value == step.first);
  }
  CHECK(watch.take(31, at(now += 1s)));
  CHECK(watch.state().limit == 30);
  CHECK_FALSE(watch.take(32, at(now += 1s)));
}

TEST_CASE("limits: a delay wants every value beyond, and a gap confirms nothing") {
  LimitWatch watch({.high = 20, .delay = 1s});
  CHECK_FALSE(watch.take(21, at(0s)));
  CHECK_FALSE(watch.take(21, at(999ms)));
  CHECK(watch.take(21, at(1s)));
  CHECK(watch.take(20, at(1100ms)));  // it ends at once
  CHECK_FALSE(watch.take(21, at(2s)));
  CHECK_FALSE(watch.take(20, at(2500ms)));
  CHECK_FALSE(watch.take(21, at(2600ms)));
  CHECK_FALSE(watch.take(21, at(3500ms)));
  CHECK(watch.take_unknown());
  CHECK(watch.take(21, at(3700ms)));
  CHECK(watch.state().level == normal);
  CHECK(watch.take(21, at(4700ms)));
  CHECK(watch.state().level == high);
}

TEST_CASE("limits: a latched alarm stays until it is acknowledged") {
  LimitWatch watch({.low = 0, .high = 20, .high_high = 30, .latched = true});
  CHECK_FALSE(watch.acknowledge());
  watch.take(31, at(0s));
  watch.take(25, at(1s));
  CHECK(watch.state().level == high);
  CHECK(watch.state().alarm == high_high);
  CHECK(watch.acknowledge());
  CHECK(watch.state().alarm == high);
  CHECK(watch.state().acknowledged);
  CHECK_FALSE(watch.acknowledge());
  CHECK(watch.take(31, at(2s)));  // worse than what was acknowledged
  CHECK_FALSE(watch.state().acknowledged);
  watch.take(10, at(3s));
  CHECK(watch.state().level == normal);
  CHECK(watch.state().alarm == high_high);
  CHECK(watch.state().limit == 30);
  CHECK(watch.acknowledge());
  CHECK(watch.state().alarm == normal);
  // Of the other side, and unknown: a new alarm.
  watch.take(25, at(4s));
  watch.take(-1, at(5s));
  CHECK(watch.state().alarm == low);
  CHECK(watch.acknowledge());
  watch.take_unknown();
  CHECK(watch.state().alarm == low);  // it stays what it was
  watch.take(10, at(6s));
  CHECK(watch.state().alarm == normal);
  watch.take_unknown();
  CHECK(watch.state().alarm == unknown);
  CHECK_FALSE(watch.state().acknowledged);
  watch.take(10, at(7s));
  CHECK(watch.state().alarm == normal);
  CHECK(watch.state().acknowledged);
}

TEST_CASE("limits: other limits keep the alarm and who has seen it, until the next value") {
  LimitWatch watch({.high = 30, .high_high = 40, .latched = true});
  const auto at = [](int ms) { return Time{std::chrono::milliseconds{ms}}; };
  CHECK(watch.take(45, at(0)));
  watch.change({.high = 30, .high_high = 50, .latched = true});
  CHECK(watch.state().alarm == LimitLevel::high_high);
  CHECK_FALSE(watch.state().acknowledged);
  CHECK(watch.take(45, at(1)));
  CHECK(watch.state().level == LimitLevel::high);
  CHECK(watch.state().alarm == LimitLevel::high_high);  // latched
  CHECK(watch.acknowledge());
  watch.change({.high_high = 50});
  CHECK(watch.take(45, at(2)));
  CHECK(watch.state().alarm == LimitLevel::normal);
  CHECK_THROWS_AS(watch.change({}), SetupError);
  CHECK(watch.state().alarm == LimitLevel::normal);
}

TEST_CASE("limits: random values against a plain account of each limit") {
  for (unsigned seed = 1; seed <= 50; ++seed) {
    CAPTURE(seed);
    std::mt19937 random(seed);
    const double hysteresis = static_cast<double>(random() % 30) / 10;
    const Duration delay = 100ms * static_cast<int>(random() % 4);
    LimitWatch watch({.low_low = -4, .low = -2, .high = 2, .high_high = 4, .hysteresis = hysteresis, .delay = delay});
    // Each limit by its own history: passed when it was beyond at all values of the last `delay`.
    struct One {
      double at;
      int side;
      LimitLevel level;
      bool passed;
      std::vector<std::pair<Time, double>> beyond;
    };
    std::vector<One> ones{
        {4, 1, high_high, false, {}}, {2, 1, high, false, {}}, {-4, -1, low_low, false, {}}, {-2, -1, low, false, {}}};
    double value = 0;
    Duration now{0};
    for (int step = 0; step < 2000; ++step) {
      now += 1ms * static_cast<int>(random() % 200);
      value = std::round((value * 0.9 + (static_cast<double>(random() % 2001) - 1000) / 400) * 10) / 10;
      watch.take(value, at(now));
      LimitLevel expected = normal;
      for (One& one : ones) {
        const double over = one.side > 0 ? value - one.at : one.at - value;
        if (one.passed && over <= -hysteresis) {
          one.passed = false;
          one.beyond.clear();
        }
        if (over <= 0) one.beyond.clear();
        if (over > 0) one.beyond.emplace_back(at(now), value);
        if (!one.passed && !one.beyond.empty() && at(now) - one.beyond.front().first >= delay) one.passed = true;
        if (one.passed && (expected == normal || (one.level == high_high) || (one.level == low_low && expected == low)))
          expected = one.level;
      }
      REQUIRE(watch.state().level == expected);
    }
  }
}

TEST_CASE("limits: settings that cannot work are refused, each with its reason") {
  const auto why = [](const LimitSettings& settings) {
    const auto good = check_limits(settings);
    if (!good) CHECK_THROWS_AS(LimitWatch{settings}, SetupError);
    return good ? std::string() : good.error().why;
  };
  CHECK(why({}) == "there is no limit");
  CHECK(why({.low = 2, .high = 1}) == "`low` is not less than `high`");
  CHECK(why({.low_low = 3, .high_high = 3}) == "`low_low` is not less than `high_high`");
  CHECK(why({.high = std::numeric_limits<double>::infinity()}) == "`high` is not finite");
  CHECK(why({.high = 1, .hysteresis = -1}) == "`hysteresis` must be 0 or more");
  CHECK(why({.low = 0, .high = 1, .hysteresis = 1}) ==
        "`hysteresis` is as large as the distance between the limits: the value could never become normal again");
  CHECK(why({.high = 1, .delay = Duration{-1}}) == "`delay` is negative");
  CHECK(why({.high = 1, .hysteresis = 100, .latched = true}).empty());
}

TEST_CASE("a limit's topic: the first value, each change, and the time of both") {
  LimitBench bench({.high = 100, .join = 0ms});
  bench.take(50);
  REQUIRE(bench.alarms.size() == 1);
  CHECK(bench.alarms[0].level == normal);
  CHECK_FALSE(bench.alarms[0].is_active);
  bench.take(60);
  CHECK(bench.alarms.size() == 1);
  bench.take(101);
  REQUIRE(bench.alarms.size() == 2);
  CHECK(bench.alarms[1].is_active);
  CHECK(bench.alarms[1].value == 101);
  CHECK(bench.alarms[1].limit == 100);
  CHECK_FALSE(bench.alarms[1].acknowledged);
  CHECK(bench.sensor.acknowledge());
  CHECK_FALSE(bench.sensor.acknowledge());
  bench.loop.poll();
  REQUIRE(bench.alarms.size() == 3);
  CHECK(bench.alarms[2].acknowledged);
  bench.take(std::nullopt);
  bench.take(std::nan(""));
  CHECK(bench.alarms.size() == 4);
  CHECK(bench.alarms[3].level == unknown);
  CHECK(bench.alarms[3].alarm == high);
  CHECK_FALSE(bench.alarms[3].value.has_value());
  CHECK(bench.sensor.health() == Health::ok);
  CHECK(bench.errors.empty());
}

TEST_CASE("a flood of alarms is joined and counted, and a worse one is never late") {
  LimitBench bench({.low = -100, .high = 100, .high_high = 200, .join = 1s});
  bench.take(0);
  CHECK(bench.levels() == std::vector{normal});
  bench.take(150, 10ms);
  CHECK(bench.levels() == std::vector{high});  // worse than what was published: at once
  for (int i = 0; i < 20; ++i) bench.take(i % 2 == 0 ? 0 : 150, 10ms);
  CHECK(bench.levels().empty());
  bench.take(250, 10ms);
  REQUIRE(bench.alarms.size() == 1);
  CHECK(bench.alarms[0].joined == 20);
  CHECK(bench.levels() == std::vector{high_high});
  bench.take(0, 10ms);
  CHECK(bench.levels().empty());
  bench.take(0, 999ms);
  CHECK(bench.levels() == std::vector{normal});  // what has become of it
  CHECK(bench.sensor.counts().published == 4);
}

TEST_CASE("what is joined is published when `join` is over, whether an event comes or not") {
  LimitBench bench({.high = 100, .silence = 0s, .join = 1s});
  bench.take(0);
  bench.take(150, 100ms);
  CHECK(bench.levels() == std::vector{normal, high});
  bench.take(0, 400ms);  // and then nothing for long: what follows the alarm is on until it is told
  bench.loop.advance(599ms);
  CHECK(bench.levels().empty());
  const Time due = bench.loop.time() + 1ms;
  Time told{};
  const Subscription watch = bench.loop.subscribe<Alarm>("alarm",
                                                         [&](const Event<Alarm>& event) { told = event.time; });
  bench.loop.advance(1ms);
  CHECK(told == due);
  CHECK(bench.levels() == std::vector{normal});
  bench.loop.advance(20s);
  CHECK(bench.alarms.empty());
  // It is worse than what was told last, though not than what was before that: `join` began anew.
  bench.take(150, 100ms);
  CHECK(bench.levels() == std::vector{high});
  // What ends while it is held, by a worse one or an acknowledgement, is not told twice.
  bench.take(0, 100ms);
  bench.take(150, 100ms);
  CHECK(bench.levels().empty());
  CHECK(bench.sensor.acknowledge());
  bench.loop.poll();
  REQUIRE(bench.alarms.size() == 1);
  CHECK(bench.alarms[0].joined == 1);
  bench.alarms.clear();
  bench.loop.advance(20s);
  CHECK(bench.alarms.empty());
  // Held when it is stopped: the unknown value is the last word.
  bench.take(0, 100ms);
  bench.take(150, 10ms);
  bench.alarms.clear();
  bench.take(0, 10ms);
  bench.sensor.stop();
  bench.loop.advance(20s);
  CHECK(bench.levels() == std::vector{unknown});
}

TEST_CASE("a change from too high to too low is told at once, and so is the way back") {
  LimitBench bench({.low = -100, .high = 100, .join = 10s});
  for (const double pressure : {0, 150, -150, 150}) bench.take(pressure, 10ms);
  CHECK(bench.levels() == std::vector{normal, high, low, high});
  for (const double pressure : {0, -150}) bench.take(pressure, 10ms);
  CHECK(bench.levels() == std::vector{low});
}

TEST_CASE("a topic that falls silent is an alarm, a gap and a fault, and told once") {
  LimitBench bench({.high = 100, .silence = 2s});
  bench.loop.advance(2s);
  CHECK(bench.levels() == std::vector{unknown});
  CHECK(bench.sensor.health() == Health::faulted);
  bench.loop.advance(20s);
  CHECK(bench.alarms.empty());
  CHECK(bench.errors == std::vector<std::string>{"the topic \"tank\" has had no event for 2 s"});
  bench.take(50, 1s);
  CHECK(bench.levels() == std::vector{normal});
  CHECK(bench.sensor.health() == Health::ok);
  // Joined when it falls silent: it is told all the same.
  bench.take(150, 100ms);
  CHECK(bench.levels() == std::vector{high});
  bench.take(0, 100ms);
  bench.loop.advance(2s);
  CHECK(bench.levels() == std::vector{normal, unknown});
  bench.sensor.stop();
  bench.loop.advance(10s);
  CHECK(bench.alarms.empty());
  bench.sensor.start();
  bench.take(150, 100ms);
  CHECK(bench.levels() == std::vector{high});
}

TEST_CASE("a limit that is stopped is an alarm: unknown, for all that follow it") {
  LimitBench bench({.high = 100, .silence = 0s});
  bench.take(50);
  CHECK(bench.levels() == std::vector{normal});
  bench.sensor.stop();
  bench.loop.advance(0ns);
  REQUIRE(bench.alarms.size() == 1);
  CHECK(bench.alarms[0].is_active);
  CHECK_FALSE(bench.alarms[0].value.has_value());
  CHECK(bench.levels() == std::vector{unknown});
  bench.sensor.stop();
  bench.take(200);
  CHECK(bench.alarms.empty());
  bench.sensor.start();
  bench.take(60);
  CHECK(bench.levels() == std::vector{normal});
  // One that has nothing yet, and one that has an alarm already: the alarm stays, its value is unknown.
  bench.take(150);
  CHECK(bench.levels() == std::vector{high});
  bench.sensor.stop();
  bench.loop.advance(0ns);
  REQUIRE(bench.alarms.size() == 1);
  CHECK(bench.alarms[0].alarm == high);
  CHECK(bench.levels() == std::vector{unknown});
  LimitBench silent({.high = 100, .silence = 0s});
  silent.sensor.stop();
  silent.loop.advance(0ns);
  CHECK(silent.levels() == std::vector{unknown});
}

TEST_CASE("a limit at the end of its run, or that is closed, publishes no alarm of its own: nothing has happened") {
  const recordings::Folder folder;
  const auto events = [&](const std::string& name, const std::function<void(LimitBench&)>& end) {
    const std::string path = folder / name;
    {
      LimitBench bench({.high = 100, .silence = 0s});
      const SqliteSink sink(bench.loop, {.path = path});
      bench.take(50);
      CHECK(bench.levels() == std::vector{normal});
      end(bench);
      CHECK(bench.levels().empty());
      bench.loop.close(1s);
    }
    return recordings::number(path, "SELECT count(*) FROM alarm");
  };
  CHECK(events("end.db", [](LimitBench&) {}) == 1);
  CHECK(events("closed.db", [](LimitBench& bench) {
          bench.sensor.close();
          bench.loop.advance(1s);
        }) == 1);
  CHECK(events("stopped.db", [](LimitBench& bench) { bench.sensor.stop(); }) == 2);
}

TEST_CASE("a change that a limit holds back to join it with others is published when it ends") {
  const recordings::Folder folder;
  const auto last = [&](const std::string& name, const std::function<void(LimitBench&)>& end) {
    const std::string path = folder / name;
    {
      LimitBench bench({.high = 100, .silence = 0s, .join = 10s});
      const SqliteSink sink(bench.loop, {.path = path});
      for (const double pressure : {50, 150, 50, 50}) bench.take(pressure);
      CHECK(bench.levels() == std::vector{normal, high});
      end(bench);
      bench.loop.close(1s);
    }
    CHECK(recordings::number(path, "SELECT count(*) FROM alarm") == 3);
    return recordings::number(path, "SELECT count(*) FROM alarm WHERE level = 'normal' AND sequence = 3");
  };
  CHECK(last("end.db", [](LimitBench&) {}) == 1);
  CHECK(last("closed.db", [](LimitBench& bench) { bench.sensor.close(); }) == 1);
}

TEST_CASE("a limit of a topic without that number says so with each event") {
  Loop loop(Loop::Manual{});
  be_quiet(loop);
  Feed<Tank> tank(loop, {.name = "tank"});
  LimitSensor sensor(loop, {.name = "alarm"}, {.on = "tank", .field = "presure", .high = 1});
  std::vector<std::string> errors;
  sensor.on_error([&](const ErrorReport& report) { errors.push_back(report.error.why); });
  tank.publish({5.0, 1});
  loop.poll();
  CHECK(errors == std::vector<std::string>{"the topic \"tank\" has no number `presure`"});
  CHECK(sensor.state().level == unknown);
  CHECK(sensor.counts().unreadable == 1);
  CHECK_THROWS_AS(LimitSensor(loop, {.name = "b"}, {.on = "#", .high = 1}), SetupError);
  CHECK_THROWS_AS(LimitSensor(loop, {.name = "c"}, {.on = "tank"}), SetupError);
  CHECK(loop.runtime().sensors().size() == 2);
}

TEST_CASE("a limit in a configuration: what cannot work is refused by check") {
  const auto first = [](const std::string& text) {
    const auto all = problems_of(text);
    return all.empty() ? std::string() : all.front();
  };
  CHECK(first(R"({"name": "a", "type": "limit", "on": "load", "field": "minutes_1", "high": 4})").empty());
  CHECK(first(R"({"name": "a", "type": "limit", "on": "load"})").find("there is no limit") != std::string::npos);
  CHECK(first(R"({"name": "a", "type": "limit", "on": "laod", "high": 1})").find("load") != std::string::npos);
  const std::string typo = first(R"({"name": "a", "type": "limit", "on": "load", "field": "minute_1", "high": 1})");
  CHECK(typo.find("the topic \"load\" has no number `minute_1`") != std::string::npos);
  CHECK(typo.find("minutes_1") != std::string::npos);
  CHECK(first(R"({"name": "a", "type": "limit", "on": "load", "field": "minutes_1", "high": 1, "low": 2})")
            .find("`low` is not less") != std::string::npos);
}

TEST_SUITE_END();
