#include "rtdata/sensors/vertical.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "rtdata/sensors/feed.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace std::chrono_literals;

namespace {

struct Board {
  std::optional<double> pressure{};
  double along = 9.80665;
  RTDATA_FIELDS(Board, (pressure, "hPa"), (along, "m/s2"))
};
struct Hot {
  double value = 0;
  RTDATA_FIELDS(Hot, (value, "Cel"))
};

}  // namespace

TEST_SUITE_BEGIN("sensors");

TEST_CASE("vertical: pressure in hPa and acceleration in m/s2 become metres and g, one event for each") {
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  Feed<Board> board(loop, {.name = "board"});
  VerticalSensor sensor(
      loop, {.name = "motion"},
      {.barometer = "board", .height = "pressure", .accelerometer = "board", .acceleration = "along"});
  std::vector<VerticalMotion> motions;
  const Subscription seen = loop.subscribe<VerticalMotion>(
      "motion", [&](const Event<VerticalMotion>& event) { motions.push_back(*event); });
  for (int i = 0; i < 300; ++i) {
    loop.advance(20ms);
    Board one{.pressure = 954.61, .along = 9.80665 + 0.01 * (i % 3)};
    if (i % 5 == 4) one.pressure.reset();
    board.publish(one, loop.time());
    loop.poll();
  }
  REQUIRE(motions.size() == 300);
  CHECK(std::abs(motions.back().height - 500) < 2);  // of the standard atmosphere
  REQUIRE(motions.back().above.has_value());
  CHECK(std::abs(*motions.back().above) < 1);
  CHECK(std::abs(motions.back().speed) < 0.5);
  CHECK(motions.back().accelerometer);
  CHECK(motions.back().barometer == BarometerUse::none);
  CHECK(!motions.back().flying);
}

TEST_CASE("vertical: a unit that is none of a height is told, and no event is made of it") {
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  Feed<Hot> hot(loop, {.name = "hot"});
  VerticalSensor sensor(loop, {.name = "motion"}, {.barometer = "hot"});
  std::vector<std::string> errors;
  sensor.on_error([&](const ErrorReport& report) { errors.push_back(report.error.why); });
  int events = 0;
  const Subscription seen = loop.subscribe<VerticalMotion>("motion", [&](const Event<VerticalMotion>&) { ++events; });
  hot.publish(Hot{20}, loop.time());
  loop.poll();
  REQUIRE(errors.size() == 1);
  CHECK(errors[0] == "`value` of the topic \"hot\" is in Cel; use m, Pa, hPa, kPa, mbar or bar");
  CHECK(events == 0);
  CHECK_THROWS_AS(VerticalSensor(loop, {.name = "none"}, {}), SetupError);
}

TEST_SUITE_END();
