#include "rtdata/sensors/analog.hpp"

#include <doctest/doctest.h>
#include <fcntl.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <unistd.h>

#include "rtdata/config/format.hpp"
#include "rtdata/config/read.hpp"
#include "rtdata/loop/timer.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace rtdata::literals;

TEST_SUITE_BEGIN("sensors");

namespace {

struct Number {
  double number = 0;
  RTDATA_FIELDS(Number, (number))
};

struct Heard {
  explicit Heard(Loop& loop, const char* pattern = "#")
      : subscription(loop.subscribe(pattern, [this](const EventView& event) {
          if (const auto reading = analog_reading(event)) readings.push_back(*reading);
          unit = event.description().find("value") != nullptr ? event.description().find("value")->unit : "";
        })) {}
  std::vector<AnalogReading> readings;
  std::string unit;
  Subscription subscription;
};

}  // namespace

TEST_CASE("US-10 the default conversion is the documented formula") {
  AnalogConfig config;
  config.quantization_bits = 12;
  config.span_voltage = 3.3;
  config.scale = 100;
  CHECK(convert(config, 0) == 0);
  CHECK(convert(config, 2048) == doctest::Approx(50));
  CHECK(convert(config, 4095) == doctest::Approx(100.0 * 4095 / 4096));
  config = {.zero_value_voltage = 0.5,
            .span_value_voltage = 4.5,
            .scale = 10,
            .quantization_bits = 10,
            .zero_voltage = 0.25,
            .span_voltage = 5};
  const double zero = 1024 * (0.5 - 0.25) / 5;
  const double span = 1024 * 4.5 / 5;
  for (const int adc : {0, 1, 51, 512, 1023}) CHECK(convert(config, adc) == doctest::Approx((adc - zero) * 10 / span));
}

TEST_CASE("US-10 the two-point conversion differs exactly when the value does not begin at 0 V") {
  AnalogConfig config{
      .zero_value_voltage = 0.5, .span_value_voltage = 4.5, .scale = 10, .quantization_bits = 10, .span_voltage = 5};
  AnalogConfig two_point = config;
  two_point.conversion = AnalogConversion::two_point;
  // 4.5 V is code 921.6, 0.5 V is 102.4; scaled by 10 bits more to be whole
  config.quantization_bits = two_point.quantization_bits = 20;
  const std::int64_t full = 943718, zero = 104858;
  CHECK(convert(two_point, full) == doctest::Approx(10).epsilon(1e-5));
  CHECK(convert(two_point, zero) == doctest::Approx(0).epsilon(1e-5));
  CHECK(convert(config, zero) == doctest::Approx(0).epsilon(1e-5));
  CHECK(convert(config, full) == doctest::Approx(10 * 4.0 / 4.5).epsilon(1e-5));

  config.zero_value_voltage = two_point.zero_value_voltage = 0;
  for (const double zero_voltage : {0.0, 1.0, -2.5}) {
    config.zero_voltage = two_point.zero_voltage = zero_voltage;
    for (const int adc : {0, 7, 100000}) CHECK(convert(config, adc) == convert(two_point, adc));
  }
}

TEST_CASE("US-10 any text that is no code in the converter's range is an error") {
  AnalogConfig config{.file = "adc0", .quantization_bits = 12};
  CHECK(parse_adc(config, "4095\n").value() == 4095);
  CHECK(parse_adc(config, " 0\r\n").value() == 0);
  for (const char* bad : {"abc", "12abc", "1.5", "1 2", "0x10", "--1", "+3", "1\n2"}) {
    CAPTURE(bad);
    CHECK(parse_adc(config, bad).error().code == Errc::not_a_number);
  }
  for (const char* bad : {"4096", "-1", "99999999999999999999999", "-99999999999999999999999"}) {
    CAPTURE(bad);
    CHECK(parse_adc(config, bad).error().code == Errc::out_of_range);
  }
  for (const std::string& bad :
       {std::string(), std::string("\n"), std::string(200, '1'), std::string("1") + std::string(300, ' ')}) {
    CAPTURE(bad);
    CHECK(parse_adc(config, bad).error().code == Errc::bad_data);
  }
  config.signed_adc = true;
  CHECK(parse_adc(config, "-2048").value() == -2048);
  CHECK(parse_adc(config, "2047").value() == 2047);
  CHECK(parse_adc(config, "2048").error().code == Errc::out_of_range);
  CHECK(parse_adc(config, "-2049").error().code == Errc::out_of_range);
}

TEST_CASE("US-10 a sensor publishes the value in the user's unit, and each bad reading is a counted failure") {
  ScratchDirectory directory;
  const std::string file = directory.file("adc0", "1024\n");
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  Heard heard(loop);
  std::vector<std::string> errors;
  AnalogSensor sensor(loop, {.name = "chamber", .rate = 10_Hz, .faulted_after = 100},
                      {.file = file, .scale = 100, .unit = "bar"});
  sensor.on_error([&](const ErrorReport& report) { errors.emplace_back(report.error.id()); });
  loop.advance(250ms);  // ticks at 0, 100, 200
  REQUIRE(heard.readings.size() == 3);
  CHECK(heard.readings[2].value == doctest::Approx(25));
  CHECK(heard.readings[2].raw == 1024);
  CHECK(heard.unit == "bar");

  for (const char* bad : {"", "abc", "4096", "-1", "12 13"}) {
    ScratchDirectory::write(file, bad);
    loop.advance(100ms);
  }
  ::unlink(file.c_str());
  loop.advance(100ms);
  CHECK(errors == std::vector<std::string>{"bad-data", "not-a-number", "out-of-range", "out-of-range", "not-a-number",
                                           "not-found"});
  CHECK(heard.readings.size() == 3);
  CHECK(sensor.health() == Health::degraded);
  CHECK(sensor.counts().failed == 6);

  ScratchDirectory::write(file, "4095");
  loop.advance(100ms);
  CHECK(heard.readings.size() == 4);
  CHECK(sensor.health() == Health::ok);
  CHECK(sensor.counts().taken == 4);
  CHECK(sensor.counts().scheduled == 10);
  CHECK(sensor.counts().balances());
}

TEST_CASE("US-10 a reading that no finite number stands for is unreadable, and is not published") {
  ScratchDirectory directory;
  const std::string file = directory.file("adc0", "4095\n");
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  Heard heard(loop);
  std::vector<std::string> errors;
  AnalogSensor sensor(loop, {.name = "chamber", .rate = 10_Hz, .faulted_after = 100}, {.file = file, .scale = 1e308});
  sensor.on_error([&](const ErrorReport& report) { errors.emplace_back(report.error.id()); });
  loop.advance(250ms);  // ticks at 0, 100, 200
  CHECK(heard.readings.empty());
  REQUIRE(!errors.empty());
  CHECK(errors.front() == "out-of-range");
  CHECK(sensor.counts().failed == 3);
  CHECK(sensor.counts().unreadable == 3);
  CHECK(sensor.counts().balances());
}

TEST_CASE("US-10 a file that is missing at the start is retried, and throws when it is required") {
  ScratchDirectory directory;
  const std::string file = directory.file("adc0");
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  CHECK_THROWS_AS(AnalogSensor(loop, {.name = "must", .rate = 10_Hz, .required = true}, {.file = file}), SetupError);
  CHECK_THROWS_AS(AnalogSensor(loop, {.name = "must", .rate = 10_Hz, .required = true}, {.file = directory.path()}),
                  SetupError);
  Heard heard(loop);
  AnalogSensor sensor(loop, {.name = "may", .rate = 10_Hz}, {.file = file});
  CHECK(sensor.health() == Health::faulted);
  loop.advance(1s);
  CHECK(heard.readings.empty());
  ScratchDirectory::write(file, "7");
  loop.advance(2s);
  CHECK(!heard.readings.empty());
  CHECK(sensor.health() == Health::ok);
  CHECK(sensor.counts().balances());
  CHECK(sensor.counts().scheduled == 31);
}

TEST_CASE("US-10 a configuration that cannot convert is refused") {
  Loop loop{Loop::Manual{}};
  const auto refuses = [&](AnalogConfig config) {
    CHECK_THROWS_AS(AnalogSensor(loop, {.name = "bad", .rate = 1_Hz, .start = false}, std::move(config)), SetupError);
  };
  refuses({});
  refuses({.file = "f", .quantization_bits = 0});
  refuses({.file = "f", .quantization_bits = 63});
  refuses({.file = "f", .span_voltage = 0});
  refuses({.file = "f", .span_value_voltage = 0});
  refuses({.file = "f", .zero_value_voltage = 2, .span_value_voltage = 2, .conversion = AnalogConversion::two_point});
  AnalogSensor(loop, {.name = "good", .rate = 1_Hz, .start = false}, {.file = "f"});
}

TEST_CASE("US-9 US-10 after stop a slow read that is under way is discarded") {
  ScratchDirectory directory;
  const std::string file = directory.file("adc0", "1");
  Loop loop{Loop::Manual{}};
  loop.script_lane_duration(30ms);
  Heard heard(loop);
  AnalogSensor sensor(loop, {.name = "slow", .rate = 10_Hz}, {.file = file});
  loop.advance(110ms);
  CHECK(heard.readings.size() == 1);
  CHECK(sensor.counts().in_flight == 1);
  sensor.stop();
  loop.advance(1s);
  CHECK(heard.readings.size() == 1);
  CHECK(sensor.counts().failed == 1);
  CHECK(sensor.counts().in_flight == 0);
  CHECK(sensor.counts().balances());
  sensor.start();
  loop.advance(50ms);
  CHECK(heard.readings.size() == 2);
}

TEST_CASE("NFR-1 a FIFO without a writer is given up in time, and costs no other sensor anything") {
  ScratchDirectory directory;
  const std::string fifo = directory.file("fifo");
  REQUIRE(::mkfifo(fifo.c_str(), 0600) == 0);
  {
    Loop loop;
    be_quiet(loop);
    std::uint64_t other_read = 0;
    std::vector<std::string> errors;
    Sensor<Number> other;
    AnalogSensor stuck(loop, {.name = "stuck", .rate = 100_Hz, .retry_first = 1ms, .retry_longest = 1ms},
                       {.file = fifo, .timeout = 20ms});
    stuck.on_error([&](const ErrorReport& report) {
      errors.emplace_back(report.error.id());
      if (errors.size() == 6) loop.stop();
    });
    other = Sensor<Number>(loop, {.name = "other", .rate = 1_kHz}, [&] {
      ++other_read;
      return Number{1};
    });
    loop.run();
    CHECK(errors == std::vector<std::string>(6, "timed-out"));
    CHECK(stuck.counts().published == 0);
    CHECK(stuck.counts().balances());
    CHECK(stuck.health() == Health::faulted);
    CHECK(other.counts().failed == 0);
    CHECK(other.counts().taken == other_read);
    CHECK(other_read > 0);

    // The threads left behind come back when a writer appears; so does the sensor.
    Heard heard(loop, "stuck");
    const int writer = ::open(fifo.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC);
    REQUIRE(writer >= 0);
    Ticker feeder(loop, 1ms, [&](const Tick&) {
      int waiting = 0;
      if (::ioctl(writer, FIONREAD, &waiting) == 0 && waiting == 0 && ::write(writer, "12\n", 3) != 3) loop.stop();
      if (heard.readings.size() >= 3) loop.stop();
    });
    loop.run();
    CHECK(heard.readings.size() >= 3);
    CHECK(stuck.counts().balances());
    ::close(writer);
  }
  // Whoever still waits in open() is let go.
  const int writer = ::open(fifo.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC);
  ::close(writer);
}

TEST_CASE("US-17 every parameter of an analog sensor can be set from a file") {
  const ConfigItem item = parse_config(R"({
    "file": "adc0", "device": "", "channel": "", "zero_value_voltage": 0.5, "span_value_voltage": 4.5, "scale": 10, "quantization_bits": 16,
    "zero_voltage": 0.1, "span_voltage": 5, "unit": "bar", "conversion": "two_point", "signed_adc": true, "timeout": "200 ms"})")
                              .root;
  const auto config = read_config<AnalogConfig>(item);
  CHECK(config.file == "adc0");
  CHECK(config.zero_value_voltage == 0.5);
  CHECK(config.span_value_voltage == 4.5);
  CHECK(config.scale == 10);
  CHECK(config.quantization_bits == 16);
  CHECK(config.zero_voltage == 0.1);
  CHECK(config.span_voltage == 5);
  CHECK(config.unit == "bar");
  CHECK(config.conversion == AnalogConversion::two_point);
  CHECK(config.signed_adc);
  CHECK(config.timeout == 200ms);
  CHECK(parameters_of<AnalogConfig>().size() == 13);
}

TEST_CASE("US-10 US-17 a converter is named by its file, or by its device and channel, and by nothing else") {
  const auto mistakes = [](const char* text) -> std::string {
    try {
      (void)read_config<AnalogConfig>(parse_config(text).or_throw());
      return "";
    } catch (const SetupError& error) {
      return error.what();
    }
  };
  CHECK(mistakes(R"({"file": "adc0"})").empty());
  CHECK(mistakes(R"({"device": "mcp3208", "channel": "voltage0"})").empty());
  CHECK(mistakes(R"({})").find("neither `file` nor `device`") != std::string::npos);
  CHECK(mistakes(R"({"file": "adc0", "device": "mcp3208", "channel": "voltage0"})").find("both") != std::string::npos);
  CHECK(mistakes(R"({"device": "mcp3208"})").find("need each other") != std::string::npos);
  CHECK(mistakes(R"({"file": "adc0", "channel": "voltage0"})").find("need each other") != std::string::npos);
  CHECK(mistakes(R"({"device": "mcp3208", "channel": "volt0"})").find("is not the name of a channel") !=
        std::string::npos);
}

TEST_SUITE_END();
