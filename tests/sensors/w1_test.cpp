#include "rtdata/sensors/w1.hpp"

#include <doctest/doctest.h>
#include <unistd.h>

#include "rtdata/loop/timer.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace rtdata::literals;

TEST_SUITE_BEGIN("sensors");

namespace {

constexpr const char* good = "91 01 4b 46 7f ff 0c 10 5e : crc=5e YES\n91 01 4b 46 7f ff 0c 10 5e t=25062\n";
constexpr const char* power_on = "50 05 4b 46 7f ff 0c 10 1c : crc=1c YES\n50 05 4b 46 7f ff 0c 10 1c t=85000\n";

}  // namespace

TEST_CASE("FW-2 a thermometer's text is degrees, and whatever else it may be is none") {
  CHECK(parse_w1(good).or_throw() == doctest::Approx(25.062));
  CHECK(parse_w1("5e ff 4b 46 7f ff 02 10 d8 : crc=d8 YES\n5e ff 4b 46 7f ff 02 10 d8 t=-10125\n").or_throw() ==
        doctest::Approx(-10.125));
  // Measured, 85 degrees are 85 degrees: byte 6 is another.
  CHECK(parse_w1("50 05 4b 46 7f ff 10 10 00 : crc=00 YES\n50 05 4b 46 7f ff 10 10 00 t=85000\n").or_throw() == 85);
  CHECK(parse_w1("").error().code == Errc::disconnected);
  CHECK(parse_w1("\n").error().code == Errc::disconnected);
  CHECK(parse_w1(power_on).error().why == "85 degrees is its value before the first measurement");
  CHECK(parse_w1("91 01 4b 46 7f ff 0c 10 5f : crc=5e NO\n91 01 4b 46 7f ff 0c 10 5e t=25062\n").error().why ==
        "its checksum is wrong");
  CHECK(parse_w1("00 00 00 00 00 00 00 00 00 : crc=00 YES\n00 00 00 00 00 00 00 00 00 t=0\n").error().why ==
        "all bits are 0");
  CHECK(parse_w1("ff 07 4b 46 7f ff 0c 10 00 : crc=00 YES\nff 07 4b 46 7f ff 0c 10 00 t=127937\n").error().code ==
        Errc::out_of_range);
  for (const char* bad : {"garbage", "91 01 4b 46 7f ff 0c 10 : crc=5e YES\nt=1",
                          "9101 4b 46 7f ff 0c 10 5e : crc=5e YES\nt=1", "91 01 4b 46 7f ff 0c 10 5e : crc=5e YES\n t=",
                          "91 01 4b 46 7f ff 0c 10 5e : crc=5e YES\n t=1.5", "t=25062", "91 01 4b 46 7f ff 0c 10 5e"}) {
    CAPTURE(bad);
    CHECK(parse_w1(bad).error().code == Errc::bad_data);
  }
}

TEST_CASE("FW-2 a thermometer is read, refused, gone and back, in virtual time") {
  ScratchDirectory directory;
  const std::string file = directory.file("sys/bus/w1/devices/28-000000c0ffee/w1_slave", good);
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  std::vector<Error> errors;
  loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error); });
  std::vector<double> degrees;
  const auto heard = loop.topic<W1Temperature>("boiler").subscribe(
      loop, [&](const Event<W1Temperature>& event) { degrees.push_back(event->temperature); });
  W1Sensor sensor(loop, {.name = "boiler", .rate = 1_Hz, .retry_first = 100ms}, {.root = directory.path()});
  loop.advance(3s);
  CHECK(degrees.size() >= 3);
  CHECK(degrees.back() == doctest::Approx(25.062));
  const std::size_t before = degrees.size();

  ScratchDirectory::write(file, power_on);
  loop.advance(2s);
  CHECK(degrees.size() == before);
  CHECK(sensor.counts().unreadable >= 2);

  ScratchDirectory::write(file, "");
  loop.advance(5s);
  CHECK(degrees.size() == before);
  CHECK(sensor.health() == Health::faulted);
  CHECK(errors.back().code == Errc::disconnected);

  ::unlink(file.c_str());
  loop.advance(5s);
  CHECK(errors.back().code == Errc::not_found);

  ScratchDirectory::write(file, good);
  loop.advance(10s);
  CHECK(degrees.size() > before);
  CHECK(sensor.health() == Health::ok);
  CHECK(sensor.counts().balances());
}

TEST_CASE("FW-2 without a name there has to be one thermometer; a name is no path") {
  ScratchDirectory directory;
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  const auto refusal = [&](W1Config config) {
    config.root = directory.path();
    try {
      W1Sensor sensor(loop, {.name = "t", .rate = 1_Hz, .required = true}, config);
    } catch (const SetupError& error) {
      return error.error().why;
    }
    return std::string();
  };
  CHECK(refusal({}) == "there is no thermometer");
  directory.file("sys/bus/w1/devices/28-000000000001/w1_slave", good);
  directory.file("sys/bus/w1/devices/w1_bus_master1/name", "w1_bus_master1\n");
  CHECK(refusal({}).empty());
  directory.file("sys/bus/w1/devices/10-000000000002/w1_slave", good);
  CHECK(refusal({}) == "available: 10-000000000002, 28-000000000001");
  CHECK(refusal({.device = "28-000000000001"}).empty());
  CHECK(refusal({.device = "28-1"}) == "No such file or directory");
  CHECK(refusal({.device = "/sys/x"}).find("not a path") != std::string::npos);
}

TEST_CASE("FW-2 a conversion of 750 ms holds no loop, and is one read at a time") {
  ScratchDirectory directory;
  directory.file("sys/bus/w1/devices/28-000000c0ffee/w1_slave", good);
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  loop.script_lane_duration(750ms);
  std::uint64_t others = 0;
  Ticker other(loop, 10ms, [&](const Tick& tick) {
    ++others;
    CHECK(tick.missed == 0);
  });
  W1Sensor sensor(loop, {.name = "boiler", .rate = 1_Hz}, {.root = directory.path()});
  loop.advance(10s);
  CHECK(sensor.counts().taken >= 9);
  CHECK(sensor.counts().missed == 0);
  CHECK(others >= 1000);
}

TEST_SUITE_END();
