// Counters: a quadrature encoder behind the kernel's counter interface, and its own driver for pulses.
#include <doctest/doctest.h>

#include <cstring>

#include "kernel/bench.hpp"
#include "rtdata/sensors/encoder.hpp"

using namespace bench;

namespace {

void set(const char* what, std::uint64_t value) { put(device("SIM") + "/counter/" + what, std::to_string(value)); }

EncoderReading reading_of(const EventView& event) {
  EncoderReading reading;
  REQUIRE(event.payload().size() == sizeof reading);
  std::memcpy(&reading, event.payload().data(), sizeof reading);
  return reading;
}

}  // namespace

TEST_SUITE("drivers") {
  TEST_CASE("US-12 a quadrature encoder of 16 bits is switched on, and followed over both ends of its range") {
    set("count", 65000);
    set("backward", 0);
    Loop loop;
    std::size_t at = 0;
    const std::vector<std::int64_t> counts = {65000, 65636, 65636 + 30000, 65636, 64636, 34636, 4636, -1};
    EncoderSensor sensor(loop, {.name = "shaft", .rate = 50_Hz},
                         {.device = "rtdata_sim", .channel = "Shaft", .function = "quadrature x4"});
    const auto heard = loop.subscribe("shaft", [&](const EventView& event) {
      const EncoderReading reading = reading_of(event);
      if (reading.count != counts[at]) return;
      if (++at == counts.size()) {
        CHECK(reading.direction == EncoderDirection::backward);
        return loop.stop();
      }
      set("backward", counts[at] < counts[at - 1] ? 1 : 0);
      set("count", static_cast<std::uint16_t>(counts[at]));
    });
    const Timer patience = limit(loop);
    loop.run();
    CHECK(at == counts.size());
    CHECK(number_in(device("ENCODER") + "/count0/enable") == 1);
    std::string function;
    std::getline(std::ifstream(device("ENCODER") + "/count0/function"), function);
    CHECK(function == "quadrature x4");
    CHECK(sensor.counts().failed == 0);
    close_balanced(loop);
  }

  TEST_CASE("US-12 a counter that answers with errors is faulted, and found again") {
    set("count", 7);
    Loop loop;
    be_quiet(loop);
    std::vector<std::string> errors;
    EncoderSensor sensor(loop, {.name = "shaft", .rate = 50_Hz, .retry_first = 10ms, .retry_longest = 20ms},
                         {.device = "rtdata_sim"});
    sensor.on_error([&](const ErrorReport& report) {
      errors.emplace_back(report.error.id());
      if (sensor.health() == Health::faulted) set("fail_errno", 0);
    });
    bool is_failing = false;
    const auto heard = loop.subscribe("shaft", [&](const EventView& event) {
      CHECK(reading_of(event).count == 7);
      if (is_failing) return loop.stop();
      is_failing = true;
      set("fail_errno", EIO);
    });
    const Timer patience = limit(loop);
    loop.run();
    set("fail_errno", 0);
    CHECK(sensor.counts().failed >= 3);
    CHECK(!errors.empty());
    CHECK(errors.front() == "io-failed");
    CHECK(sensor.health() == Health::ok);
    close_balanced(loop);
  }

  TEST_CASE("US-12 pulses that the kernel's interrupt-cnt counts, each of them, and a missing counter by its name") {
    Loop loop;
    const std::string which = device("PULSES");
    std::int64_t first = -1, last = -1;
    EncoderSensor sensor(loop, {.name = "flow", .rate = 100_Hz},
                         {.device = which.substr(which.rfind('/') + 1), .per_count = 0.5, .unit = "L"});
    const auto heard = loop.subscribe("flow", [&](const EventView& event) {
      const EncoderReading reading = reading_of(event);
      if (first < 0) first = reading.count;
      CHECK(reading.count >= last);
      CHECK(reading.position == 0.5 * static_cast<double>(reading.count));
      CHECK(!reading.direction);          // this driver has none
      if (reading.count == last) return;  // the pulse has not come yet
      last = reading.count;
      if (last == first + 20) return loop.stop();
      set("pulse", 1);
    });
    const Timer patience = limit(loop);
    loop.run();
    CHECK(last == first + 20);
    CHECK(sensor.counts().failed == 0);
    close_balanced(loop);
    Loop other;
    CHECK_THROWS_AS(EncoderSensor(other, {.name = "x", .rate = 1_Hz, .required = true}, {.device = "no-such"}),
                    SetupError);
  }
}
