#include "rtdata/sensors/encoder.hpp"

#include <doctest/doctest.h>
#include <unistd.h>

#include <cstring>
#include <fstream>
#include <vector>

#include "rtdata/config/format.hpp"
#include "rtdata/config/read.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace rtdata::literals;

TEST_SUITE_BEGIN("sensors");

namespace {

using Way = CountTracker::Way;

/// A kernel's folder of a counter.
struct Counter {
  ScratchDirectory directory;
  std::string folder = "sys/bus/counter/devices/counter0/";
  explicit Counter(const std::string& name = "qep") { put("name", name); }
  std::string put(const std::string& file, const std::string& text) {
    return directory.file(folder + file, text + "\n");
  }
  std::string text(const std::string& file) const {
    std::string text;
    std::getline(std::ifstream(directory.path() + "/" + folder + file), text);
    return text;
  }
};

std::string refusal(const Counter& counter, EncoderConfig config) {
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  config.root = counter.directory.path();
  try {
    EncoderSensor sensor(loop, {.name = "e", .rate = 1_Hz, .required = true}, config);
  } catch (const SetupError& error) {
    return error.error().why;
  }
  return {};
}

}  // namespace

TEST_CASE("US-12 a count is carried on where its counter wraps around, both ways and one way") {
  CountTracker shaft(Way::both, 65536);
  for (const std::uint64_t raw : {65530u, 4u, 65530u, 40000u, 10000u}) CHECK(shaft.take(raw));
  CHECK(shaft.count() == 10000);
  CHECK(*shaft.change() == -30000);
  CHECK(shaft.take(0));
  CHECK(shaft.take(65535));
  CHECK(shaft.count() == -1);

  CountTracker pulses(Way::up, 65536);  // more than half of the range at a time
  CHECK(pulses.take(10));
  CHECK(!pulses.change());
  CHECK(pulses.take(60000));
  CHECK(pulses.take(5));
  CHECK(pulses.count() == 65541);
  CHECK(*pulses.change() == 5541);

  CountTracker down(Way::down, 1000);
  CHECK(down.take(1));
  CHECK(down.take(999));
  CHECK(down.count() == -1);
  CHECK(down.take(999));
  CHECK(*down.change() == 0);
}

TEST_CASE("US-12 without a known range, a negative number is one, and a count that somebody set begins anew") {
  CountTracker shaft(Way::both, 0);
  CHECK(shaft.take(3));
  CHECK(shaft.take(static_cast<std::uint64_t>(-5)));
  CHECK(shaft.count() == -5);
  CHECK(shaft.take(7));
  CHECK(*shaft.change() == 12);

  // interrupt-cnt counts in an int, and shows it as a number of 64 bits without a sign.
  CountTracker pulses(Way::up, 0);
  CHECK(pulses.take(2147483646));
  CHECK(pulses.take(static_cast<std::uint64_t>(-2147483647)));
  CHECK(*pulses.change() == 3);
  CHECK(pulses.count() == 2147483649);
  CHECK(pulses.take(static_cast<std::uint64_t>(-1)));
  CHECK(pulses.take(1));
  CHECK(*pulses.change() == 2);
  CHECK(pulses.count() == 4294967297);

  CountTracker set(Way::up, 0);
  CHECK(set.take(1000));
  CHECK(!set.take(3));
  CHECK(!set.change());
  CHECK(set.count() == 3);
  CHECK(set.take(4));
  CHECK(set.count() == 4);
}

TEST_CASE("US-12 an encoder's count, position, speed and direction, in virtual time") {
  Counter counter;
  counter.put("count0/name", "Shaft");
  counter.put("count0/ceiling", "999");
  counter.put("count0/enable", "0");
  counter.put("count0/function", "quadrature x4");
  const std::string direction = counter.put("count0/direction", "forward");
  const std::string count = counter.put("count0/count", "900");
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  std::vector<Error> errors;
  loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error); });
  std::vector<EncoderReading> readings;
  const auto heard = loop.subscribe("shaft", [&](const EventView& event) {
    EncoderReading reading;
    std::memcpy(&reading, event.payload().data(), sizeof reading);
    readings.push_back(reading);
  });
  EncoderSensor sensor(loop, {.name = "shaft", .rate = 1_Hz, .retry_first = 100ms},
                       {.device = "qep",
                        .channel = "Shaft",
                        .per_count = 0.01,
                        .unit = "{rev}",
                        .per = "min",
                        .root = counter.directory.path()});
  loop.advance(100ms);
  CHECK(counter.text("count0/enable") == "1");
  REQUIRE(readings.size() == 1);
  CHECK(readings[0].count == 900);
  CHECK(readings[0].position == doctest::Approx(9));
  CHECK(!readings[0].speed);
  CHECK(readings[0].direction == EncoderDirection::forward);

  ScratchDirectory::write(count, "50\n");
  loop.advance(1s);
  REQUIRE(readings.size() == 2);
  CHECK(readings[1].count == 1050);
  CHECK(*readings[1].speed == doctest::Approx(1.5 * 60));

  ScratchDirectory::write(count, "950\n");
  ScratchDirectory::write(direction, "backward\n");
  loop.advance(1s);
  REQUIRE(readings.size() == 3);
  CHECK(readings[2].count == 950);
  CHECK(*readings[2].speed == doctest::Approx(-1.0 * 60));
  CHECK(readings[2].direction == EncoderDirection::backward);

  for (const char* garbage : {"", "12x", "-3", "99999999999999999999"}) {
    CAPTURE(garbage);
    ScratchDirectory::write(count, garbage);
    const std::uint64_t before = sensor.counts().unreadable;
    loop.advance(1s);
    CHECK(sensor.counts().unreadable == before + (sensor.health() == Health::faulted ? 0 : 1));
    ScratchDirectory::write(count, "950\n");
    loop.advance(2s);
    CHECK(sensor.health() == Health::ok);
  }
  ScratchDirectory::write(direction, "sideways\n");
  loop.advance(1s);
  CHECK(errors.back().why == "\"sideways\n\" is no direction");
  ScratchDirectory::write(direction, "forward\n");

  // Another ceiling: what is above the one that it knows is no value, and it is opened again.
  counter.put("count0/ceiling", "1999");
  ScratchDirectory::write(count, "1500\n");
  loop.advance(1s);
  CHECK(errors.back().code == Errc::out_of_range);
  loop.advance(5s);
  CHECK(sensor.health() == Health::ok);
  CHECK(readings.back().count == 1500);

  // Unplugged, and back with another number.
  ::rename((counter.directory.path() + "/sys/bus/counter/devices/counter0").c_str(),
           (counter.directory.path() + "/sys/bus/counter/devices/gone").c_str());
  loop.advance(5s);
  CHECK(sensor.health() == Health::faulted);
  CHECK(errors.back().code == Errc::not_found);
  ::rename((counter.directory.path() + "/sys/bus/counter/devices/gone").c_str(),
           (counter.directory.path() + "/sys/bus/counter/devices/counter7").c_str());
  loop.advance(10s);
  CHECK(sensor.health() == Health::ok);
  CHECK(sensor.counts().balances());
}

TEST_CASE("US-12 a count of pulses that somebody sets back is told, and is no value") {
  Counter counter;
  counter.put("count0/function", "increase");
  const std::string count = counter.put("count0/count", "500");
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  std::vector<Error> errors;
  loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error); });
  EncoderSensor sensor(loop, {.name = "flow", .rate = 1_Hz}, {.root = counter.directory.path()});
  loop.advance(1500ms);
  CHECK(errors.empty());
  ScratchDirectory::write(count, "2\n");
  loop.advance(1s);
  REQUIRE(errors.size() == 1);
  CHECK(errors[0].why == "its count has gone back from 500 to 2");
  CHECK(sensor.counts().failed == 1);
  loop.advance(1s);
  CHECK(errors.size() == 1);
  CHECK(sensor.health() == Health::ok);
  CHECK(sensor.counts().balances());
}

TEST_CASE(
    "US-12 a counter and its count are found by name, number and path, and where there are several, not guessed") {
  Counter counter;
  CHECK(refusal(counter, {}) == "this machine has no counter");  // it has no count yet
  counter.put("count0/count", "1");
  counter.put("count0/name", "Channel 1 Count");
  CHECK(refusal(counter, {}).empty());
  CHECK(refusal(counter, {.device = "0", .channel = "0"}).empty());
  CHECK(refusal(counter, {.device = "counter0", .channel = "count0"}).empty());
  CHECK(refusal(counter, {.device = "/sys/bus/counter/devices/counter0", .channel = "Channel 1 Count"}).empty());
  CHECK(refusal(counter, {.device = "qeb"}) == "available: counter0 (qep)");
  CHECK(refusal(counter, {.channel = "1"}) == "available: count0 (Channel 1 Count)");
  counter.put("count1/count", "1");
  CHECK(refusal(counter, {}) == "there are several: count0 (Channel 1 Count), count1");
  CHECK(refusal(counter, {.channel = "count1"}).empty());
  counter.directory.file("sys/bus/counter/devices/counter1/name", "qep\n");
  CHECK(refusal(counter, {.device = "qep"}) == "there are several: counter0 (qep), counter1 (qep)");
  CHECK(refusal(counter, {.device = "1"}) == "this machine has no counter");
}

TEST_CASE("US-12 what an encoder counts is set when it is opened, and a function that the driver lacks is refused") {
  Counter counter;
  counter.put("count0/count", "1");
  counter.put("count0/function", "quadrature x1 a");
  CHECK(refusal(counter, {.function = "quadrature x4"}) == "the driver has no function \"quadrature x4\"");
  counter.put("count0/function_available", "quadrature x1 a\nquadrature x4");
  CHECK(refusal(counter, {.function = "x4"}) ==
        "the driver has no function \"x4\"; it has quadrature x1 a, quadrature x4");
  CHECK(counter.text("count0/function") == "quadrature x1 a");
  CHECK(refusal(counter, {}).empty());
  CHECK(counter.text("count0/function") == "quadrature x1 a");
  CHECK(refusal(counter, {.function = "quadrature x4"}).empty());
  CHECK(counter.text("count0/function").starts_with("quadrature x4"));
}

TEST_CASE("US-17 every parameter of an encoder can be set from a file, and a wrong one is refused") {
  const auto config = read_config<EncoderConfig>(
      parse_config(
          R"({"device": "qep", "channel": "count1", "function": "quadrature x4", "per_count": 0.5, "unit": "mm", "per": "h", "bits": 16,
                       "root": "/host", "timeout": "2 s"})")
          .root);
  CHECK(config.device == "qep");
  CHECK(config.channel == "count1");
  CHECK(config.function == "quadrature x4");
  CHECK(config.per_count == 0.5);
  CHECK(config.bits == 16);
  CHECK(encoder_description(config).or_throw()->fields().size() == 4);
  CHECK(parameters_of<EncoderConfig>().size() == 9);
  Counter counter;
  CHECK(!refusal(counter, {.per_count = 0}).empty());
  CHECK(!refusal(counter, {.per = "day"}).empty());
  CHECK(!refusal(counter, {.bits = 64}).empty());
}

TEST_SUITE_END();
