#include "rtdata/sensors/sensor.hpp"

#include <doctest/doctest.h>

#include <stdexcept>
#include <vector>

#include "rtdata/loop/timer.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace rtdata::literals;

TEST_SUITE_BEGIN("sensors");

namespace {

struct Number {
  std::int64_t number = 0;
  RTDATA_FIELDS(Number, (number))
};
struct Other {
  double other = 0;
  RTDATA_FIELDS(Other, (other))
};

}  // namespace

TEST_CASE("US-27 a sensor that cannot be made leaves nothing behind on its loop") {
  Loop loop{Loop::Manual{}};
  Sensor<Number> first(loop, {.name = "a", .rate = 10_Hz}, [] { return Number{1}; });
  CHECK_THROWS_AS(Sensor<Number>(loop, {.name = "a", .rate = 10_Hz}, [] { return Number{1}; }), SetupError);
  CHECK_THROWS_AS(Sensor<Other>(loop, {.name = "b", .topic = "a", .rate = 10_Hz}, [] { return Other{1}; }), SetupError);
  CHECK_THROWS_AS(Sensor<Number>(loop, {.name = "c"}, [] { return Number{1}; }), SetupError);
  loop.advance(1s);
  CHECK(first.counts().published == 11);
}

TEST_SUITE_END();
