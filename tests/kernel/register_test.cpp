// Chips with registers that have both buses: magnetometers, barometers and IMUs on I2C and on SPI.
#include <doctest/doctest.h>

#include <cerrno>
#include <string>
#include <vector>

#include "kernel/bench.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/chips/barometer.hpp"
#include "rtdata/chips/imu.hpp"
#include "rtdata/chips/magnetometer.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/io/spi.hpp"

using namespace bench;

namespace {

std::string controller() { return device("SPIDEV").substr(0, device("SPIDEV").rfind('.')); }
std::string place_on_spi(const char* name) {
  return R"("bus": "spi0", "chip_select": )" + device(name).substr(device(name).rfind('.') + 1);
}
/// A recording of one sensor, with both buses there.
std::string configuration(const std::string& sensor, const std::string& path) {
  return R"({"buses": {"i2c1": {"type": "i2c", "device": ")" + device("I2C") +
         R"("}, "spi0": {"type": "spi", "device": ")" + controller() + R"("}}, "sensors": [{)" + sensor +
         R"(}], "sinks": [{"type": "sqlite", "path": ")" + path + "\"}]}";
}

/// Runs it until `seen` events of the reading came, with a chip that fails three times after the fifth.
template <class Reading, class Check>
void record(const std::string& sensor, const char* chip_name, unsigned seen, Check check) {
  recordings::Folder folder;
  const std::string path = folder / "run.db";
  {
    Loop loop;
    const Chip chip(chip_name);
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) {
      if (report.object == "sensor chip") errors.emplace_back(report.error.id());
    });
    System system(loop, standard_registry(), parse_config(configuration(sensor, path), "chip.json"));
    unsigned events = 0, since = 0;
    const auto heard = loop.subscribe<Reading>("chip", [&](const Event<Reading>& event) {
      check(*event);
      if (++events == 5) chip.fail(3, EIO);
      if (!errors.empty() && ++since >= seen) loop.stop();
    });
    const Timer patience = limit(loop);
    loop.run();
    CHECK(since >= seen);
    CHECK(!chip.still_fails());
    REQUIRE(loop.runtime().sensors().size() == 1);
    CHECK(loop.runtime().sensors()[0].health == Health::ok);
    close_balanced(loop);
  }
  check_verifies(path);
}

void check_field(const MagnetometerReading& reading) {
  CHECK(reading.magnetic_field_x == doctest::Approx(25.0e-6).epsilon(0.001));
  CHECK(reading.magnetic_field_y == doctest::Approx(-50.0e-6).epsilon(0.001));
  CHECK(reading.magnetic_field_z == doctest::Approx(40.0e-6).epsilon(0.001));
  REQUIRE(reading.temperature.has_value());
  CHECK(*reading.temperature == doctest::Approx(27));
}

}  // namespace

TEST_SUITE("drivers") {
  TEST_CASE("US-15 NFR-3 magnetometer: an LIS3MDL on I2C and on SPI, through faults, verifies") {
    const std::string settings = R"("name": "chip", "type": "magnetometer", "rate": "40 Hz", "faulted_after": 20, )";
    record<MagnetometerReading>(settings + R"("bus": "i2c1", "address": "0x1c")", "i2c-1c", 5, check_field);
    record<MagnetometerReading>(settings + place_on_spi("SPIDEV_MAGNETOMETER"), "spi", 5, check_field);
  }

  TEST_CASE(
      "US-11 NFR-3 barometer: a BMP280 on SPI has the data sheet's worked example, through faults, and verifies") {
    const std::string trimming(
        "\x70\x6b\x43\x67\x18\xfc\x7d\x8e\x43\xd6\xd0\x0b\x27\x0b\x8c\x00\xf9\xff\x8c\x3c\xf8\xc6\x70\x17", 24);
    const std::string registers = device("SIM") + "/spi/regs";
    put(registers, trimming, 0x08);  // without bit 7, which says that it is read
    put(registers, "\x58", 0x50);
    put(registers, std::string("\x65\x5a\xc0\x7e\xed\x00", 6), 0x77);
    record<BarometerReading>(
        R"("name": "chip", "type": "barometer", "rate": "20 Hz", "faulted_after": 20, )" + place_on_spi("SPIDEV_REGS"),
        "spi", 5, [](const BarometerReading& reading) {
          CHECK(reading.pressure == doctest::Approx(100653.27).epsilon(1e-6));
          CHECK(reading.temperature == doctest::Approx(25.08).epsilon(0.001));
        });
  }

  TEST_CASE("US-11 US-15 NFR-3 imu: an LSM6DSO on SPI gives each sample of its FIFO once, in order, and verifies") {
    recordings::Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop;
      System system(loop, standard_registry(),
                    parse_config(configuration(R"("name": "chip", "type": "imu", "model": "lsm6dso", "rate": "20 Hz",
                      "sample_rate": 104, )" + place_on_spi("SPIDEV_IMU"),
                                               path),
                                 "imu.json"));
      std::vector<double> counts;
      const auto heard = loop.subscribe<ImuReading>("chip", [&](const Event<ImuReading>& event) {
        counts.push_back(event->angular_velocity_z);
        if (counts.size() >= 200) loop.stop();
      });
      const Timer patience = limit(loop);
      loop.run();
      REQUIRE(counts.size() >= 200);
      const double step = counts[1] - counts[0];
      CHECK(step > 0);
      for (std::size_t at = 1; at < counts.size(); ++at)
        CHECK(counts[at] - counts[at - 1] == doctest::Approx(step).epsilon(0.001));
      close_balanced(loop);
    }
    check_verifies(path);
  }
}
