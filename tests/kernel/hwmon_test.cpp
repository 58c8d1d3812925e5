// The host's temperatures, of the kernel's own driver for the LM75.
#include <doctest/doctest.h>

#include <algorithm>
#include <cerrno>

#include "kernel/bench.hpp"
#include "rtdata/sensors/host.hpp"

using namespace bench;

namespace {

/// As HostConfig names it.
std::string thermometer() { return "lm75/temp1"; }

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

  TEST_CASE("NFR-3 ina226: voltage, current and power of the kernel's driver, by the chip's name and by its device's") {
    const std::string adapter = "/sys/bus/i2c/devices/" + device("I2C").substr(5);
    put(adapter + "/new_device", "ina226 0x40");
    const Chip chip("i2c-40");
    chip.set_word(2, 9600);   // 1.25 mV each (data sheet, 7.6.3): 12 V
    chip.set_word(4, -8000);  // 250 uA each at the driver's 10 mOhm: -2 A
    chip.set_word(3, 3840);   // 25 times that: 24 W
    Loop loop;
    double voltage = 0, current = 0, power = 0;
    HostSensor volts(loop, {.name = "v", .rate = 20_Hz}, {.quantity = HostQuantity::voltage, .device = "ina226/in1"});
    HostSensor amperes(loop, {.name = "i", .rate = 20_Hz}, {.quantity = HostQuantity::current, .device = "ina226"});
    HostSensor watts(loop, {.name = "p", .rate = 20_Hz},
                     {.quantity = HostQuantity::power, .device = device("I2C").substr(9) + "-0040/power1"});
    const auto v = loop.topic<HostVoltage>("v").subscribe(loop, [&](const auto& event) { voltage = event->voltage; });
    const auto i = loop.topic<HostCurrent>("i").subscribe(loop, [&](const auto& event) { current = event->current; });
    const auto p = loop.topic<HostPower>("p").subscribe(loop, [&](const auto& event) {
      power = event->power;
      if (voltage != 0 && current != 0) loop.stop();
    });
    const Timer patience = limit(loop);
    loop.run();
    CHECK(voltage == doctest::Approx(12));
    CHECK(current == doctest::Approx(-2));
    CHECK(power == doctest::Approx(24));
    CHECK(volts.counts().failed + amperes.counts().failed + watts.counts().failed == 0);
    close_balanced(loop);
    put(adapter + "/delete_device", "0x40");
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
