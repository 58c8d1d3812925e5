#include "rtdata/process/vertical_kalman.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>

using namespace rtdata;
using namespace std::chrono_literals;

namespace {

constexpr double none = VerticalReadings::none;

Time second(double seconds) { return from_nanoseconds(1'000'000'000'000 + static_cast<std::int64_t>(seconds * 1e9)); }

/// A rocket: 10 s on the pad, 2 s of 8 g, then a free fall; the apogee is at 26.0 s, 1648 m high.
struct FreeFlight {
  double height = 0, speed = 0, felt = 1;
  explicit FreeFlight(double time) {
    constexpr double g = 9.80665, push = 7 * g, burnt = 12;
    const double t = time - 10;
    if (t < 0) return;
    felt = time < burnt ? 8 : 0;
    const double b = std::min(t, 2.0), c = std::max(0.0, time - burnt);
    height = push * b * b / 2 + push * b * c - g * c * c / 2;
    speed = push * b - g * c;
  }
};
constexpr double apogee = 26;

/// When it surely falls, in s; 0: never. `change(time, readings)` says what goes wrong.
template <class Change>
double falls_at(VerticalKalman& estimate, double rate, Change&& change) {
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  for (double t = 0; t < 60; t += 1 / rate) {
    const FreeFlight truth(t);
    VerticalReadings readings{200 + truth.height + normal(random), truth.felt + 0.02 * normal(random)};
    change(t, readings);
    estimate.take(second(t), readings);
    if (t > 12 && estimate.now().speed + estimate.now().speed_deviation < 0) return t;
  }
  return 0;
}

}  // namespace

TEST_SUITE_BEGIN("process");

TEST_CASE("vertical: height, speed and acceleration of a flight, and how sure they are") {
  VerticalKalman estimate;
  for (double t = 0; t < 20; t += 0.02) {
    const FreeFlight truth(t);
    estimate.take(second(t), {200 + truth.height, truth.felt + 0.01 * std::sin(t * 50)});
  }
  const FreeFlight truth(19.98);
  const VerticalState& state = estimate.now();
  CHECK(std::abs(state.height - 200 - truth.height) < 2);
  CHECK(std::abs(state.speed - truth.speed) < 2);
  CHECK(std::abs(state.acceleration + 9.8) < 0.5);
  CHECK(state.speed_deviation < 2);
  CHECK(std::abs(state.ground - 200) < 1);
  CHECK(state.is_flying);
  CHECK(state.accelerometer);
  CHECK(state.barometer == BarometerUse::used);
}

TEST_CASE("vertical: each sensor alone, at 10 to 200 values a second") {
  for (const double rate : {10.0, 50.0, 200.0}) {
    VerticalKalman both, barometer, accelerometer;
    CHECK(std::abs(falls_at(both, rate, [](double, VerticalReadings&) {}) - apogee) < 1);
    CHECK(std::abs(falls_at(barometer, rate, [](double, VerticalReadings& r) { r.acceleration = none; }) - apogee) < 2);
    CHECK(std::abs(falls_at(accelerometer, rate, [](double, VerticalReadings& r) { r.height = none; }) - apogee) < 2);
  }
}

TEST_CASE("vertical: a dip of 1000 m for 5 s is refused, and what stays is believed again") {
  VerticalKalman estimate;
  bool was_refused = false;
  const double at = falls_at(estimate, 50, [&](double t, VerticalReadings& readings) {
    if (t > 14 && t < 19) readings.height -= 1000 * std::sin(3.14159 * (t - 14) / 5);
    was_refused = was_refused || estimate.now().barometer == BarometerUse::refused;
  });
  CHECK(was_refused);
  CHECK(std::abs(at - apogee) < 1);
  VerticalKalman lifted;  // the barometer's zero has changed for good
  CHECK(std::abs(falls_at(lifted, 50, [](double t, VerticalReadings& r) { r.height += t > 14 ? 500 : 0; }) - apogee) <
        1);
  CHECK(lifted.now().barometer == BarometerUse::used);
}

TEST_CASE("vertical: a value at the end of the accelerometer's range is no measurement") {
  VerticalKalman found, told({.range = 2});
  for (VerticalKalman* const one : {&found, &told}) {
    const double at = falls_at(*one, 50, [](double, VerticalReadings& readings) {
      readings.acceleration = std::clamp(readings.acceleration, -2.0, 2.0);
    });
    CHECK(std::abs(at - apogee) < 2);
  }
}

TEST_CASE("vertical: an accelerometer that is stuck or silent locks the barometer out for a while only") {
  for (const double stuck_at : {1.03, 8.0, none}) {
    VerticalKalman estimate;
    const double at = falls_at(estimate, 50, [&](double t, VerticalReadings& readings) {
      if (t > 11) readings.acceleration = stuck_at;
    });
    CHECK_MESSAGE(std::abs(at - apogee) < 2, stuck_at << " " << at);
  }
}

TEST_CASE("vertical: without an accelerometer the barometer is locked out for `burn` after the liftoff") {
  VerticalKalman estimate({.burn = 7s});
  bool is_ever_down = false;
  for (double t = 0; t < 16; t += 0.02) {
    const FreeFlight truth(t);
    estimate.take(second(t), {truth.height - (t > 11.5 && t < 16 ? 800 : 0), none});
    is_ever_down = is_ever_down || (t > 11 && estimate.now().speed + estimate.now().speed_deviation < 0);
    if (t > 12 && t < 15) CHECK(estimate.now().barometer == BarometerUse::locked);
  }
  CHECK(!is_ever_down);
}

TEST_CASE("vertical: readings less than 1 us apart are of one instant, of which the last counts") {
  VerticalKalman estimate, other;
  for (double t = 0; t < 15; t += 0.02) {
    const FreeFlight truth(t);
    other.take(second(t), {truth.height, truth.felt});
    estimate.take(second(t), {truth.height + 500, truth.felt});
    estimate.take(second(t) + 300ns, {none, truth.felt});
    estimate.take(second(t) + 600ns, {truth.height, none});
  }
  CHECK(std::abs(estimate.now().height - other.now().height) < 0.01);
  CHECK(std::abs(estimate.now().speed - other.now().speed) < 0.01);
}

TEST_SUITE_END();
