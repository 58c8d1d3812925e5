// The BNO055: its scales, and a chip on a fake bus that starts slowly, loses its settings, reports errors.
#include <doctest/doctest.h>

#include <array>
#include <cerrno>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "rtdata/chips/bno055.hpp"
#include "rtdata/testing/fake_i2c.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

/// A quarter turn to the right, 1 g downwards, 2 m/s2 along x.
void put_example(FakeI2cChip& chip) {
  chip.set(0x00, {0xa0, 0xfb, 0x32, 0x0f});
  chip.set(0x36, {0x0f});
  const auto put = [&](std::uint8_t first, std::initializer_list<int> words) {
    for (const int word : words) {
      chip.set(first, {static_cast<std::uint8_t>(word & 0xff), static_cast<std::uint8_t>(word >> 8 & 0xff)});
      first = static_cast<std::uint8_t>(first + 2);
    }
  };
  put(0x08, {200, 0, 981});
  put(0x0e, {320, -160, 16});
  put(0x14, {900, -450, 0});
  put(0x1a, {1414, 0, -90});
  put(0x20, {11585, 0, 0, -11585});
  put(0x28, {200, 0, -1});
  chip.set(0x34, {0xfb, 0xe6});  // -5 degrees; system 3, gyroscope 2, accelerometer 1, magnetometer 2
  chip.set(0x39, {5, 0});
}

struct Bno055Bench {
  std::shared_ptr<FakeI2c> wires = std::make_shared<FakeI2c>();
  I2cBus bus{"i2c1", wires, {.timeout = 200ms}};
  FakeI2cChip& chip = wires->chip(0x28);
  Loop loop{Loop::Manual{}};
  std::vector<std::string> errors;
  std::vector<OrientationReading> readings;
  Subscription heard;
  Bno055Bench() {
    put_example(chip);
    be_quiet(loop);
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
    heard = loop.subscribe<OrientationReading>("attitude",
                                               [this](const Event<OrientationReading>& e) { readings.push_back(*e); });
  }
  bool told(const char* words) const {
    for (const std::string& error : errors)
      if (error.find(words) != std::string::npos) return true;
    return false;
  }
};

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-15 BNO055: its registers become a quaternion, radians, m/s2, tesla and calibration") {
    Bno055Bench bench;
    DriverSensor<Bno055> attitude(bench.loop, {.name = "attitude", .rate = 50_Hz}, bench.bus);
    bench.loop.advance(500ms);
    CHECK(bench.errors.empty());
    REQUIRE(bench.readings.size() >= 24);
    const OrientationReading& r = bench.readings.back();
    CHECK(r.quaternion_w == doctest::Approx(std::sqrt(0.5)).epsilon(1e-4));
    CHECK(r.quaternion_z == doctest::Approx(-std::sqrt(0.5)).epsilon(1e-4));
    CHECK(r.heading == doctest::Approx(1.5711).epsilon(1e-4));
    CHECK(r.pitch == doctest::Approx(-0.1));
    CHECK(r.acceleration_z == doctest::Approx(9.81));
    CHECK(r.linear_acceleration_x == doctest::Approx(2));
    CHECK(r.linear_acceleration_z == doctest::Approx(-0.01));
    CHECK(r.angular_velocity_x == doctest::Approx(1));
    CHECK(r.angular_velocity_y == doctest::Approx(-0.5));
    CHECK(r.magnetic_field_x.value() == doctest::Approx(20e-6));
    CHECK(r.magnetic_field_y.value() == doctest::Approx(-10e-6));
    CHECK(r.temperature == -5);
    CHECK(r.calibration_system == 3);
    CHECK(r.calibration_gyroscope == 2);
    CHECK(r.calibration_accelerometer == 1);
    CHECK(r.calibration_magnetometer.value() == 2);
    CHECK(bench.chip.get(0x3b) == 0x06);
    CHECK(bench.chip.get(0x3d) == 0x0c);
    attitude.close();
    bench.loop.advance(100ms);
    CHECK(bench.chip.get(0x3d) == 0);
    CHECK(bench.chip.get(0x3e) == 2);  // it sleeps
    bench.readings.clear();
    DriverSensor<Bno055> without(bench.loop, {.name = "attitude", .rate = 50_Hz}, bench.bus, Bno055::place,
                                 {.mode = Bno055Mode::imu});
    bench.loop.advance(200ms);
    REQUIRE(!bench.readings.empty());
    CHECK(!bench.readings.back().magnetic_field_x);
    CHECK(!bench.readings.back().calibration_magnetometer);
    CHECK(bench.chip.get(0x3d) == 0x08);
  }

  TEST_CASE("US-15 US-27 a BNO055 that starts, loses its settings, fails, or is another chip is told, and comes back") {
    Bno055Bench bench;
    bench.chip.set(0x39, {3, 0});  // starting
    DriverSensor<Bno055> attitude(bench.loop, {.name = "attitude", .rate = 20_Hz, .retry_longest = 1s}, bench.bus);
    bench.loop.advance(500ms);
    CHECK(bench.readings.empty());
    CHECK(bench.errors.empty());
    CHECK(attitude.counts().failed == 0);
    bench.loop.advance(1s);
    CHECK(bench.told("its sensor fusion does not run: its status is 3"));
    bench.chip.set(0x39, {5});
    bench.loop.advance(3s);
    CHECK(attitude.health() == Health::ok);
    const std::size_t before = bench.readings.size();
    CHECK(before > 10);

    bench.chip.set(0x3d, {0});  // a reset
    bench.loop.advance(500ms);
    CHECK(attitude.counts().unreadable == 1);
    CHECK(bench.told("it has lost its settings"));
    CHECK(bench.readings.size() >= before + 8);

    bench.chip.set(0x20, {0, 0, 0, 0, 0, 0, 0, 0});
    bench.loop.advance(100ms);
    CHECK(attitude.counts().unreadable >= 2);
    CHECK(attitude.status().reason.find("its quaternion has the length 0.000000, not 1") != std::string::npos);
    put_example(bench.chip);
    bench.chip.set(0x39, {1, 9});
    bench.loop.advance(100ms);
    CHECK(attitude.status().reason.find("it reports error 9") != std::string::npos);
    put_example(bench.chip);
    bench.loop.advance(3s);
    CHECK(attitude.health() == Health::ok);

    bench.chip.unplug();
    bench.loop.advance(1s);
    CHECK(attitude.health() == Health::faulted);
    bench.chip.set(0x00, {0x60});
    bench.chip.plug_in();
    bench.loop.advance(3s);
    CHECK(bench.told("its identity is 0x60, that of a BNO055 is 0xa0"));
    put_example(bench.chip);
    bench.chip.set(0x36, {0x0b});
    bench.loop.advance(3s);
    CHECK(bench.told("its self-test found a fault in its gyroscope"));
    put_example(bench.chip);
    bench.loop.advance(3s);
    CHECK(attitude.health() == Health::ok);
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("US-15 whichever transfers of a BNO055 fail, the account balances and it goes on") {
    for (int at = 0; at < 60; ++at) {
      CAPTURE(at);
      Bno055Bench bench;
      bench.chip.set_duration(1ms);
      DriverSensor<Bno055> attitude(
          bench.loop, {.name = "attitude", .rate = 20_Hz, .retry_first = 10ms, .retry_longest = 10ms}, bench.bus);
      bench.loop.advance(at * 3ms);
      bench.chip.fail(2, EIO);
      bench.loop.advance(1s);
      CHECK(attitude.health() == Health::ok);
      CHECK(bench.readings.size() > 12);
      CHECK(bench.loop.runtime().balances());
    }
  }
}
