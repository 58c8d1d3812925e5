// Drivers of user space on the kernel's I2C adapters: I2C_RDWR, and an adapter that has SMBus only.
#include <doctest/doctest.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <string>
#include <vector>

#include "app/machine/scan.hpp"
#include "kernel/bench.hpp"
#include "kernel/gpio_bench.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/chips/barometer.hpp"
#include "rtdata/chips/imu.hpp"
#include "rtdata/chips/lm75.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/io/i2c.hpp"

using namespace bench;

TEST_SUITE("drivers") {
  TEST_CASE(
      "US-12 NFR-3 barometer: a configuration records the data sheet's worked example, through faults, and verifies") {
    recordings::Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop;
      const Chip chip("i2c-76");
      const std::string text = R"({"buses": {"i2c1": {"type": "i2c", "device": ")" + device("I2C") +
                               R"("}}, "sensors": [{"name": "air", "type": "barometer", "rate": "20 Hz", "bus": "i2c1",
          "address": "0x76", "faulted_after": 10}], "sinks": [{"type": "sqlite", "path": ")" +
                               path + "\"}]}";
      std::vector<std::string> errors;
      loop.on_error([&](const ErrorReport& report) {
        if (report.object == "sensor air") errors.emplace_back(report.error.id());
      });
      System system(loop, standard_registry(), parse_config(text, "weather.json"));
      int before = 0, after = 0;
      const auto heard = loop.subscribe<BarometerReading>("air", [&](const Event<BarometerReading>& event) {
        CHECK(event->pressure == doctest::Approx(100653.27).epsilon(1e-6));
        CHECK(event->temperature == doctest::Approx(25.08).epsilon(0.001));
        if (errors.empty()) {
          if (++before == 5) chip.fail(3, ENXIO);
        } else if (++after == 5) {
          loop.stop();
        }
      });
      const Timer patience = limit(loop);
      loop.run();
      CHECK(after == 5);
      REQUIRE(!errors.empty());  // those that are alike are told as one
      CHECK(errors.front() == "disconnected");
      REQUIRE(loop.runtime().sensors().size() == 1);
      CHECK(loop.runtime().sensors()[0].counts.failed == 3);
      CHECK(loop.runtime().sensors()[0].health == Health::ok);
      close_balanced(loop);
    }
    check_verifies(path);
  }

  TEST_CASE("US-12 NFR-3 i2c: an address without a chip, a chip that the kernel has, and an adapter with SMBus only") {
    I2cBus bus({.device = device("I2C")});
    CHECK(bus.device({0x10}).read_register(0).error().code == Errc::disconnected);
    CHECK(bus.device({0x48}).look_at().error().code == Errc::busy);
    CHECK(bus.device({0x76}).read_register(0xd0).or_throw() == 0x58);
    I2cBus smbus({.device = device("I2C_STUB")});
    I2cDevice chip = smbus.device({0x68});
    chip.write_register(7, 42).or_throw();
    CHECK(chip.read_register(7).or_throw() == 42);
    chip.write_word(8, 0x1234).or_throw();
    CHECK(chip.read_word(8).or_throw() == 0x1234);
    std::array<std::uint8_t, 3> bytes{};
    const std::array<std::uint8_t, 4> four{20, 1, 2, 3};
    chip.write(four).or_throw();
    chip.read_registers(20, bytes).or_throw();
    CHECK(bytes == std::array<std::uint8_t, 3>{1, 2, 3});
    std::array<std::uint8_t, 40> many{};
    CHECK(chip.read_registers(0, many).error().code == Errc::bad_argument);
  }

  TEST_CASE("US-15 NFR-3 imu: every sample of the MPU-6050's FIFO, or its loss, is in the account") {
    recordings::Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop;
      put(device("SIM") + "/i2c-68/ramp", "1");  // Z of the angular velocity is the sample's number
      const std::string text = R"({"buses": {"i2c1": {"type": "i2c", "device": ")" + device("I2C") +
                               R"("}}, "sensors": [{"name": "imu", "type": "imu", "rate": "50 Hz", "bus": "i2c1",
          "sample_rate": 500}], "sinks": [{"type": "sqlite", "path": ")" +
                               path + "\"}]}";
      System system(loop, standard_registry(), parse_config(text, "imu.json"));
      int first = -1, last = -1, events = 0;
      Time before{};
      const auto heard = loop.subscribe<ImuReading>("imu", [&](const Event<ImuReading>& event) {
        const int number = static_cast<int>(
            std::lround(event->angular_velocity_z / (2000 / 32750.0 * 3.14159265 / 180)));
        CHECK(event->acceleration_x == doctest::Approx(0x400 / 32768.0 * 16 * 9.80665));
        CHECK(number > last);
        CHECK(event.time > before);
        before = event.time;
        last = number;
        if (first < 0) first = number;
        if (++events >= 1000) loop.stop();
      });
      const Timer patience = limit(loop);
      loop.run();
      CHECK(events >= 1000);
      const SensorCounts counts = loop.runtime().sensors()[0].counts;
      const int left_out = last - first + 1 - events;
      // A sample that the FIFO gave up is one that nobody has seen. The chip's clock is the kernel's timer here.
      CHECK(std::abs(left_out - static_cast<int>(counts.lost)) <= 2);
      if (is_time_simulated()) CHECK(left_out == 0);
      close_balanced(loop);
    }
    check_verifies(path);
  }

  TEST_CASE("US-15 NFR-3 imu: an LSM6DSO that is read too late loses samples, and each of them is counted") {
    recordings::Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop;
      const Chip chip("i2c-6a");
      const std::string text = R"({"buses": {"i2c1": {"type": "i2c", "device": ")" + device("I2C") +
                               R"("}}, "sensors": [{"name": "imu", "type": "imu", "model": "lsm6dso", "rate": "50 Hz",
          "bus": "i2c1", "address": "0x6a", "sample_rate": 833, "faulted_after": 1000}],
          "sinks": [{"type": "sqlite", "path": ")" +
                               path + "\"}]}";
      loop.on_error([](const ErrorReport&) {});
      System system(loop, standard_registry(), parse_config(text, "imu.json"));
      int first = -1, last = -1, events = 0;
      Time before{};
      const auto heard = loop.subscribe<ImuReading>("imu", [&](const Event<ImuReading>& event) {
        const int number = static_cast<int>(std::lround(event->angular_velocity_z / (70e-3 * 3.14159265 / 180)));
        CHECK(event->acceleration_x == doctest::Approx(0x400 * 0.488e-3 * 9.80665));
        CHECK(number > last);
        CHECK(event.time > before);
        before = event.time;
        last = number;
        if (first < 0) first = number;
        if (++events == 1500) chip.fail(30, ENXIO);  // 0.6 s; the FIFO is full after 0.3 s
        if (events >= 3000) loop.stop();
      });
      const Timer patience = limit(loop);
      loop.run();
      CHECK(events >= 3000);
      const SensorCounts counts = loop.runtime().sensors()[0].counts;
      const int left_out = last - first + 1 - events;
      CHECK(left_out > 50);
      // Their number is known from the time, and made exact by the counter of two bits: on a machine that held a
      // reading up for long, but for a multiple of four.
      const int difference = left_out - static_cast<int>(counts.lost);
      CHECK(difference % 4 == 0);
      CHECK(std::abs(difference) <= 40);
      if (is_time_simulated()) CHECK(difference == 0);
      close_balanced(loop);
    }
    check_verifies(path);
  }

  TEST_CASE("FW-2 NFR-3 scan: devices of the kernel, and the chips that answer when it may probe") {
    using namespace rtdata::app;
    const Scan scan = scan_machine(MachineFiles(), standard_registry(), Probing::yes);
    const auto has = [&](const std::string& path, const std::string& what) {
      return std::any_of(scan.devices.begin(), scan.devices.end(), [&](const FoundDevice& device) {
        return device.path == path && device.what.find(what) != std::string::npos && device.obstacle.empty();
      });
    };
    const auto line = [&](const std::string& text) {
      for (const FoundDevice& device : scan.devices)
        for (const FoundDevice::Line& one : device.lines)
          if (one.text.find(text) != std::string::npos) return true;
      return false;
    };
    CHECK(has(device("I2C"), "rtdata_sim"));
    CHECK(has(device("I2C"), "address 0x48: lm75, used by the kernel's driver lm75"));
    CHECK(has(device("I2C"), "address 0x76: BMP280"));
    CHECK(has(device("I2C"), "address 0x6a: LSM6DSO or LSM6DSOX"));
    CHECK(line(R"("model": "lsm6dso")"));
    CHECK(has(device("I2C"), "address 0x68: mpu6050, known to the kernel"));
    CHECK(has(device("SPIDEV"), "chip select"));
    const std::string gpio = gpio_bench::Chip().path();  // another one after it was plugged in again
    CHECK(has(gpio, ""));
    if (standard_registry().sensors().find("edge")) {  // there is libgpiod
      CHECK(has(gpio, "rtdata-bench, 16 lines; free: sim0 sim1"));
      CHECK(line(R"("type": "edge", "line": "sim0")"));
      CHECK(line(R"("type": "counter", "rate": "1 Hz", "line": "sim0")"));
    }
    CHECK(has(device("PPS"), ""));
    CHECK(line(R"("type": "barometer", "bus")"));
    CHECK(line(R"({"type": "i2c", "device": ")" + device("I2C")));
    CHECK(line("in_voltage0_raw"));
    CHECK(line(R"("quantity": "temperature")"));
  }
}
