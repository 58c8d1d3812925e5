#include "rtdata/sensors/derived.hpp"

#include <doctest/doctest.h>

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "rtdata/app/program.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/config/system.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace std::chrono_literals;

namespace {

struct Imu {
  double x = 0;
  float y = 0;
  std::int16_t z = 0;
  std::optional<double> heat = {};
  bool ok = true;
  RTDATA_FIELDS(Imu, (x, "m/s2"), (y, "m/s2"), (z, "m/s2"), (heat, "Cel"), (ok))
};
struct Room {
  double temperature = 0;
  RTDATA_FIELDS(Room, (temperature, "Cel"))
};

/// A derived sensor and what it brings.
struct DerivedBench {
  explicit DerivedBench(DerivedConfig config) : loop(Loop::Manual{}) {
    be_quiet(loop);
    imu = Feed<Imu>(loop, {.name = "imu"});
    room = Feed<Room>(loop, {.name = "room", .topic = "room/climate"});
    sensor = DerivedSensor(loop, {.name = "out"}, std::move(config));
    sensor.on_error([this](const ErrorReport& report) { errors.push_back(report.error.why); });
    subscription = loop.subscribe("out", [this](const EventView& event) {
      times.push_back(event.time());
      for (const Leaf& leaf : event.description().leaves()) values.push_back(to_string(event.value(leaf)));
    });
  }
  void take(Imu value, Duration after = 100ms) {
    loop.advance(after);
    imu.publish(value, loop.time());
    loop.poll();
  }
  void heat(double value) {
    room.publish(Room{value});
    loop.poll();
  }
  using Texts = std::vector<std::string>;

  Loop loop;
  Feed<Imu> imu;
  Feed<Room> room;
  DerivedSensor sensor;
  Subscription subscription;
  Texts values;
  Texts errors;
  std::vector<Time> times;
};

Problems problems_of(const std::string& sensors) {
  return plan_system(standard_registry(), parse_config(R"({"sensors": [)" + sensors + "]}", "f.json")).problems;
}
const std::string load = R"({"name": "load", "type": "host", "quantity": "load", "rate": "10 Hz"}, )";

}  // namespace

TEST_SUITE_BEGIN("sensors");

TEST_CASE("a derived sensor that is refused leaves nothing behind") {
  Loop loop(Loop::Manual{});
  be_quiet(loop);
  for (int i = 0; i < 3; ++i)
    CHECK_THROWS_AS(DerivedSensor(loop, {.name = "out"}, {.on = "imu", .expression = "x +"}), SetupError);
  CHECK(loop.runtime().sensors().empty());
  const DerivedSensor right(loop, {.name = "out"}, {.on = "imu", .expression = "x"});
  CHECK(loop.runtime().sensors().size() == 1);
}

TEST_CASE("a derived topic has the time of what it is derived from, and several fields") {
  DerivedBench bench(
      {.on = "imu",
       .fields = {{"norm", "sqrt(x^2 + imu.y^2 + z^2)", "m/s2"}, {"good", "ok and norm_like < 5 or ok", ""}}});
  // A field that is not there: each event is unreadable, and says so.
  bench.take({3, 4, 0});
  CHECK(bench.errors == DerivedBench::Texts{"the topic \"imu\" has no number `norm_like`"});
  CHECK(bench.sensor.counts().unreadable == 1);

  DerivedBench right(
      {.on = "imu", .fields = {{"norm", "sqrt(x^2 + imu.y^2 + z^2)", "m/s2"}, {"good", "ok and z > -2", ""}}});
  right.take({3, 4, 0});
  const Time first = right.loop.time();
  right.take({0, 0, -7, {}, true});
  CHECK(right.values == DerivedBench::Texts{"5", "1", "7", "0"});
  CHECK(right.times == std::vector<Time>{first, first + 100ms});
  CHECK(right.sensor.counts().published == 2);
  CHECK(right.sensor.counts().received == 2);
  CHECK(right.errors.empty());
}

TEST_CASE("a field that waits is absent") {
  DerivedBench bench({.on = "imu", .fields = {{"rate", "rate(x)", ""}, {"warm", "heat + 1", ""}, {"x", "x", ""}}});
  bench.take({1, 0, 0, 20.0});
  bench.take({2, 0, 0, {}});
  bench.take({2, 0, 0, 21.5});
  CHECK(bench.values == DerivedBench::Texts{"absent", "21", "1", "10", "absent", "2", "0", "22.5", "2"});
  bench.sensor.stop();
  bench.take({9});
  bench.sensor.start();
  bench.take({3});
  CHECK(bench.values.size() == 12);
  CHECK(bench.values[9] == "absent");  // it begins anew
}

TEST_CASE("a topic that never comes, comes late, stops: a gap, and nothing made up") {
  DerivedBench bench({.on = "imu", .with = {"room/climate"}, .age = 1s, .expression = "x + room.climate"});
  bench.take({1});
  bench.take({1});
  CHECK(bench.values.empty());
  CHECK(bench.errors == DerivedBench::Texts{"the topic \"room/climate\" has had no event yet"});  // once
  CHECK(bench.sensor.health() == Health::faulted);
  bench.heat(20);
  CHECK(bench.values.empty());
  bench.take({1});
  bench.take({2}, 900ms);
  CHECK(bench.values == DerivedBench::Texts{"21", "22"});
  CHECK(bench.sensor.health() == Health::ok);
  bench.take({2}, 100ms);
  CHECK(bench.values.size() == 2);
  CHECK(bench.errors.back() == "the topic \"room/climate\" has had no event for more than 1 s");
  CHECK(bench.sensor.health() == Health::faulted);
  bench.heat(21);
  bench.take({2});
  CHECK(bench.values == DerivedBench::Texts{"21", "22", "23"});
  const SensorCounts counts = bench.sensor.counts();
  CHECK(counts.received == 3);
  CHECK(counts.published == 3);
}

TEST_CASE("a division by zero is unreadable, told with its column, and costs its own event only") {
  DerivedBench bench({.on = "imu", .expression = "highest(x) + 1 / x"});
  bench.take({2});
  bench.take({0});
  CHECK(bench.sensor.health() == Health::degraded);
  bench.take({1});
  CHECK(bench.values == DerivedBench::Texts{"2.5", "3"});
  CHECK(bench.errors == DerivedBench::Texts{"division by zero, or the logarithm of 0, in column 16"});
  CHECK(bench.sensor.health() == Health::ok);
  const SensorCounts counts = bench.sensor.counts();
  CHECK(counts.received == 3);
  CHECK(counts.published == 2);
  CHECK(counts.unreadable == 1);
}

TEST_CASE("derived from a derived one, and closed from a handler of it") {
  DerivedBench bench({.on = "imu", .expression = "x * 2"});
  DerivedSensor second(bench.loop, {.name = "second"}, {.on = "out", .expression = "out + 1"});
  std::vector<double> got;
  Subscription subscription = bench.loop.subscribe("second", [&](const EventView& event) {
    got.push_back(std::get<double>(*event.value("value")));
    if (got.size() == 2) second.close();
  });
  for (double x = 1; x < 5; ++x) {
    bench.take({x});
    bench.loop.advance(1ms);
  }
  CHECK(got == std::vector<double>{3, 5});
  CHECK(bench.values.size() == 4);
}

TEST_CASE("making a derived sensor refuses what cannot work") {
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  const auto refused = [&](DerivedConfig config, std::string_view why) {
    try {
      DerivedSensor(loop, {.name = "s"}, std::move(config));
      FAIL("it was made");
    } catch (const SetupError& error) {
      CHECK_MESSAGE(std::string(error.what()).find(why) != std::string::npos, error.what());
    }
  };
  refused({.on = "a"}, "neither `expression` nor");
  refused({.on = "a", .expression = "x", .fields = {{"x", "x"}}}, "not both");
  refused({.on = "a", .with = {"b", "b"}, .expression = "x"}, "listed twice");
  refused({.on = "a", .with = {"a"}, .expression = "x"}, "listed twice");
  refused({.on = "a", .expression = "x +"}, "the expression ends, but a value is missing");
  refused({.on = "a", .fields = {{"x", "x"}, {"x", "y"}}}, "x");
  refused({.on = "a", .fields = {{"time", "x"}}}, "time");
}

TEST_CASE("check finds each mistake of a derived topic, with its column in the file") {
  CHECK(problems_of(load + R"({"name": "d", "type": "derived", "on": "load", "expression": "running * 2"})").empty());
  const auto shows = [](const std::string& item, std::string_view id, std::string_view why,
                        std::string_view meant = "") {
    const Problems problems = problems_of(load + item);
    CAPTURE(item);
    REQUIRE(problems.size() >= 1);
    CHECK_MESSAGE(problems[0].id == id, problems.text());
    CHECK_MESSAGE(problems[0].message.find(why) != std::string::npos, problems.text());
    CHECK(problems[0].suggestion == meant);
    return problems[0];
  };
  const std::string item = R"({"name": "d", "type": "derived", "on": "load", "expression": "1 + runing"})";
  const Problem problem = shows(item, "bad-value", "there is no name `runing` (column 5 of the expression)", "running");
  CHECK(problem.path == "sensors[1].expression");
  CHECK(problem.place.column == std::string(R"({"sensors": [)").size() + load.size() + item.find("runing") + 1);
  shows(R"({"name": "d", "type": "derived", "on": "load", "expression": "running ="})", "bad-value", "write `==`");
  shows(R"({"name": "d", "type": "derived", "on": "load", "expression": "load + 1"})", "bad-value",
        "there is no name `load`");
  shows(R"({"name": "d", "type": "derived", "on": "laod", "expression": "x"})", "unknown-topic", "nothing of this",
        "load");
  shows(R"({"name": "d", "type": "derived", "on": "load", "with": ["x"], "expression": "x"})", "unknown-topic",
        "\"x\"");
  shows(R"({"name": "d", "type": "derived", "on": "load"})", "bad-value", "neither `expression` nor");
  shows(R"({"name": "d", "type": "derived", "expression": "x"})", "missing-key", "on");
  shows(R"({"name": "d", "type": "derived", "on": "load", "expression": ")" + std::string(1 << 20, '(') + "\"}",
        "bad-value", "at most 4096");
  shows(R"({"name": "d", "type": "derived", "on": "load", "fields": [{"name": "a", "expression": "running"},
        {"name": "b", "expression": "rate() "}]})",
        "bad-value", "takes 1 argument");
}

TEST_CASE("a field that is called as a constant is not taken for that in silence") {
  const std::string line = R"({"name": "line", "type": "serial", "device": "/dev/null", "fields": [{"name": "e"}]},)";
  const auto with = [&](const std::string& expression) {
    return problems_of(line + R"({"name": "d", "type": "derived", "on": "line", "expression": ")" + expression + "\"}");
  };
  const Problems bare = with("2 * e");
  REQUIRE(bare.size() == 1);
  CHECK(bare[0].message.find("`e` is the constant here, but the topic \"line\" also has a field with this name") !=
        std::string::npos);
  CHECK(with("2 * 'e'").size() == 0);
  CHECK(with("2 * line.e").size() == 0);
  CHECK(with("2 * line.e + pi").size() == 0);
}

TEST_CASE("derived topics that go round in a circle are a mistake") {
  const Problems circle = problems_of(R"({"name": "a", "type": "derived", "on": "b", "expression": "b"},
      {"name": "b", "type": "derived", "on": "a", "expression": "a"})");
  REQUIRE(circle.size() == 1);
  CHECK(circle[0].id == "uses-itself");
  const Problems itself = problems_of(
      load + R"({"name": "a", "type": "derived", "on": "load", "with": ["a"], "expression": "a"})");
  REQUIRE(itself.size() == 1);
  CHECK(itself[0].id == "uses-itself");
}

TEST_SUITE_END();
