// The host's temperatures, of the kernel's own driver for the LM75.
#include <doctest/doctest.h>

#include <algorithm>
#include <cerrno>

#include "kernel/bench.hpp"
#include "rtdata/sensors/host.hpp"

using namespace bench;

namespace {

/// As HostConfig names it: "hwmon0/temp1".
std::string thermometer() {
  const std::string folder = device("LM75");
  return folder.substr(folder.rfind('/') + 1) + "/temp1";
}

void set(const Chip& chip, double degrees) { chip.set_word(0, static_cast<int>(degrees * 256)); }

}  // namespace

TEST_SUITE("drivers") {
  TEST_CASE("NFR-3 lm75: the thermometer is listed, and its temperature followed to half a degree") {
    const auto listed = available_host_sensors();
    CHECK(std::any_of(listed.begin(), listed.end(), [](const HostSensorInfo& info) {
      return info.quantity == HostQuantity::temperature && info.device == thermometer() && info.name == "lm75";
    }));
    const std::vector<double> degrees = {25, -55, -0.5, 0, 0.5, 99.5, 125};
    const Chip chip("i2c-48");
    set(chip, degrees[0]);
    Loop loop;
    std::size_t at = 0;
    std::uint64_t strays = 0;
    HostSensor sensor(loop, {.name = "board", .rate = 50_Hz},
                      {.quantity = HostQuantity::temperature, .device = thermometer()});
    const auto heard = loop.topic<HostTemperature>("board").subscribe(loop, [&](const Event<HostTemperature>& event) {
      if (event->temperature == degrees[at]) {
        if (++at < degrees.size()) return set(chip, degrees[at]);
        return loop.stop();
      }
      if (at == 0 || event->temperature != degrees[at - 1]) ++strays;  // one read before the change may still come
    });
    const Timer patience = limit(loop);
    loop.run();
    CHECK(at == degrees.size());
    CHECK(strays == 0);
    CHECK(sensor.counts().failed == 0);
    close_balanced(loop);
  }

  TEST_CASE("NFR-3 lm75: transfers that fail are failed ticks, and the next reading is taken") {
    const Chip chip("i2c-48");
    set(chip, 21.5);
    Loop loop;
    be_quiet(loop);
    std::uint64_t before = 0, after = 0;
    std::vector<std::string> errors;
    HostSensor sensor(loop, {.name = "board", .rate = 50_Hz, .faulted_after = 5},
                      {.quantity = HostQuantity::temperature, .device = thermometer()});
    sensor.on_error([&](const ErrorReport& report) { errors.emplace_back(report.error.id()); });
    const auto heard = loop.topic<HostTemperature>("board").subscribe(loop, [&](const Event<HostTemperature>& event) {
      CHECK(event->temperature == 21.5);
      if (sensor.counts().failed == 0) {
        if (++before == 3) chip.fail(4, EREMOTEIO);
      } else if (++after == 3) {
        loop.stop();
      }
    });
    const Timer patience = limit(loop);
    loop.run();
    CHECK(after == 3);
    CHECK(sensor.counts().failed == 4);
    CHECK(errors == std::vector<std::string>(4, "io-failed"));
    CHECK(sensor.health() == Health::ok);
    close_balanced(loop);
  }
}
