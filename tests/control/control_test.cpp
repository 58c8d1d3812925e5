// Controllers against simulated plants, with times of the test.
#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "rtdata/control/controllers.hpp"

using namespace rtdata;
using namespace std::chrono_literals;

namespace {

Time at(Duration since) { return Time{} + since; }

}  // namespace

TEST_SUITE("outputs") {
  TEST_CASE("US-35 hysteresis: cooling and heating, noise between the thresholds, and what is no number") {
    Hysteresis cools({.on = 28, .off = 26});
    Hysteresis heats({.on = 18, .off = 20});
    std::vector<bool> cooling, heating;
    for (double value : {27.0, 28.0, 26.5, 27.9, 26.0, 27.9}) cooling.push_back(cools.update(value));
    for (double value : {19.0, 18.0, 19.9, 18.5, 20.0, 18.1}) heating.push_back(heats.update(value));
    const std::vector<bool> expected{false, true, true, true, false, false};
    CHECK(cooling == expected);
    CHECK(heating == expected);
    cools.update(30);
    CHECK(cools.update(std::nan("")));
    cools.reset();
    CHECK_FALSE(cools.is_on());
  }

  TEST_CASE("US-35 Pid: each part by itself, with numbers by hand") {
    Pid p({.setpoint = 10, .kp = 2, .least = -100, .most = 100});
    CHECK(p.update(7, at(0s)) == 6);
    CHECK(p.update(11, at(5s)) == -2);
    Pid i({.setpoint = 10, .ki = 0.5, .least = -100, .most = 100});
    CHECK(i.update(8, at(0s)) == 0);
    CHECK(i.update(8, at(2s)) == 2);
    CHECK(i.update(9, at(4s)) == 3);
    CHECK(i.update(9, at(4s)) == 3);  // no time has passed
    CHECK(i.update(9, at(3s)) == 3);
    Pid d({.setpoint = 10, .kd = 4, .least = -100, .most = 100});
    CHECK(d.update(8, at(0s)) == 0);
    CHECK(d.update(9, at(2s)) == -2);
    d.set_setpoint(1000);
    CHECK(d.update(9, at(4s)) == 0);  // the derivative is that of what is measured
    CHECK(d.update(std::numeric_limits<double>::infinity(), at(5s)) == 0);
  }

  TEST_CASE("US-35 Pid: values 1 ns apart are one instant, of which the last counts") {
    const PidConfig config{.setpoint = 10, .kp = 0.5, .ki = 2, .kd = 1, .least = -1000, .most = 1000};
    Pid bundled(config), plain(config);
    for (int i = 0; i < 20; ++i) {
      for (int line = 0; line < 16; ++line) bundled.update(0.1 * i * i + line - 15, at(i * 16ms + Duration{line}));
      CHECK(bundled.output() == doctest::Approx(plain.update(0.1 * i * i, at(i * 16ms))));
    }
  }

  TEST_CASE("US-35 Pid: a value so large that the arithmetic overflows costs only itself") {
    Pid pid({.setpoint = 20, .kp = 0.1, .ki = 0.01, .kd = 0.01, .least = 0, .most = 10});
    double output = 0;
    int tick = 0;
    for (int i = 0; i < 3; ++i) output = pid.update(10, at(++tick * 100ms));
    const double before = output;
    CHECK(before > 0.9);
    for (double huge : {1e308, -1e308}) {
      CHECK(std::isfinite(pid.update(huge, at(++tick * 100ms))));
      for (int i = 0; i < 4; ++i) output = pid.update(10, at(++tick * 100ms));
      CHECK(output == doctest::Approx(before).epsilon(0.1));
    }
    Pid first({.setpoint = 20, .kp = 0.1, .kd = 1, .least = 0, .most = 10});
    CHECK(first.update(-1e308, at(0s)) == 10);
    for (int i = 1; i < 4; ++i) output = first.update(10, at(i * 100ms));
    CHECK(output == doctest::Approx(1));  // what the formula says: nothing would ever bring it back
  }

  TEST_CASE("US-35 Pid: without an integral its output is what the formula says, whatever the actuator had") {
    for (double kd : {0.0, 0.5}) {
      Pid p({.setpoint = 20, .kp = 0.1, .kd = kd, .least = 0, .most = 1});
      CHECK(p.update(15, at(0s)) == 0.5);
      p.follow(0);  // its safe value
      CHECK(p.update(15, at(5s)) == 0.5);
      CHECK(p.update(15, at(6s)) == 0.5);
      p.change({.setpoint = 20, .kp = 0.02, .kd = kd, .least = 0, .most = 1});
      CHECK(p.update(15, at(7s)) == doctest::Approx(0.1));
      p.change({.setpoint = 25, .kp = 0.02, .kd = kd, .least = 0, .most = 1});
      CHECK(p.update(15, at(8s)) == doctest::Approx(0.2));
    }
    Pid first({.setpoint = 20, .kp = 0.1, .least = 0, .most = 1});
    first.follow(0);  // disarmed from the start
    CHECK(first.update(15, at(0s)) == 0.5);
    Pid had({.setpoint = 20, .kp = 0.1, .ki = 0.1, .least = 0, .most = 1});
    for (int i = 0; i < 4; ++i) had.update(19, at(i * 1s));
    had.change({.setpoint = 20, .kp = 0.1, .least = 0, .most = 1});
    CHECK(had.update(19, at(4s)) == doctest::Approx(0.1));
  }

  TEST_CASE("US-35 Pid: another set point makes no step, but at a limit the formula holds") {
    const PidConfig config{.setpoint = 20, .kp = 0.1, .ki = 0.01, .least = 0, .most = 1};
    PidConfig warmer = config;
    warmer.setpoint = 25;
    Pid pid(config);
    for (int i = 0; i < 5; ++i) pid.update(18, at(i * 1s));
    const double before = pid.output();
    pid.change(warmer);
    CHECK(pid.update(18, at(4s)) == doctest::Approx(before));
    CHECK(pid.update(18, at(5s)) == doctest::Approx(before + 0.07));
    CHECK(pid.setpoint() == 25);
    Pid heats({.setpoint = 60, .kp = 0.1, .ki = 0.01, .least = 0, .most = 1});
    CHECK(heats.update(20, at(0s)) == 1);
    heats.change({.setpoint = 22, .kp = 0.1, .ki = 0.01, .least = 0, .most = 1});
    CHECK(heats.update(20, at(0s)) == doctest::Approx(0.2));  // and does not heat until an integral is lost
  }

  TEST_CASE("US-35 Pid: the derivative's filter answers a step as a low pass of first order") {
    Pid d({.kd = 1, .least = -100, .most = 100, .derivative_filter = 1s});
    double measured = 0;
    d.update(measured, at(0s));
    double output = 0;
    for (int i = 1; i <= 1000; ++i) output = d.update(measured += 0.001, at(i * 1ms));  // a ramp of 1 a second
    CHECK(output == doctest::Approx(-(1 - std::exp(-1))).epsilon(0.001));
  }

  TEST_CASE("US-35 Pid: no windup: it leaves the limit as soon as the error changes its sign") {
    Pid pid({.setpoint = 10, .kp = 0.1, .ki = 1});
    for (int i = 0; i < 100; ++i) CHECK(pid.update(0, at(i * 1s)) == 1);
    CHECK(pid.update(10.5, at(100s)) < 1);
    Pid down({.setpoint = 0, .kp = 0.1, .ki = 1});
    for (int i = 0; i < 100; ++i) CHECK(down.update(50, at(i * 1s)) == 0);
    CHECK(down.update(-1, at(100s)) > 0);
  }

  TEST_CASE("US-35 Pid: no bump: other gains and an actuator that was set by hand change nothing at that moment") {
    Pid pid({.setpoint = 10, .kp = 0.05, .ki = 0.02, .kd = 0.1});
    double measured = 4;
    for (int i = 0; i < 20; ++i) pid.update(measured += 0.1, at(i * 1s));
    const double before = pid.output();
    pid.change({.setpoint = 10, .kp = 0.4, .ki = 0.001, .kd = 0.3});
    CHECK(pid.update(measured, at(19s)) == doctest::Approx(before));
    pid.follow(0.7);
    CHECK(pid.output() == 0.7);
    CHECK(pid.update(3, at(60s)) == doctest::Approx(0.7));
    CHECK(pid.update(3, at(61s)) == doctest::Approx(0.7 + 0.001 * 7));
  }

  TEST_CASE("US-35 Pid: a plant with a dead time settles without a lasting error, also under a load") {
    Pid pid({.setpoint = 50, .kp = 0.02, .ki = 0.001, .kd = 0.05, .derivative_filter = 2s});
    std::vector<double> pipe(5, 0.0);  // seconds of dead time
    double temperature = 20, load = 0;
    for (int i = 0; i < 2400; ++i) {
      if (i == 1200) load = 0.2;
      pipe.push_back(pid.update(temperature, at(i * 1s)));
      temperature += pipe.front() - load - 0.01 * (temperature - 20);
      pipe.erase(pipe.begin());
      if (i == 1199 || i == 2399) CHECK(temperature == doctest::Approx(50).epsilon(0.01));
    }
    CHECK(pid.output() == doctest::Approx(0.5).epsilon(0.02));
  }
}
