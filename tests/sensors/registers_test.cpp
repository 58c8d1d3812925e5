// Chips with registers on SPI, whose drivers are those of I2C: what is sent, and what a place cannot be.
#include <doctest/doctest.h>

#include <array>
#include <memory>
#include <string>
#include <vector>

#include "rtdata/app/program.hpp"
#include "rtdata/chips/barometer.hpp"
#include "rtdata/chips/imu.hpp"
#include "rtdata/chips/magnetometer.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/testing/fake_i2c.hpp"
#include "rtdata/testing/fake_spi.hpp"
#include "sensors/fixture.hpp"
#include "sensors/spi_bridge.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

using Bytes = std::vector<std::uint8_t>;

/// What was sent to the chip; it answers with zeros.
struct Written {
  std::shared_ptr<FakeSpi> wires = std::make_shared<FakeSpi>();
  SpiBus bus{"spi0", wires};
  Bytes sent;
  Written() {
    wires->on_transfer(1, [this](std::span<const std::uint8_t> write, std::span<std::uint8_t> read) {
      sent.insert(sent.end(), write.begin(), write.end());
      std::fill(read.begin(), read.end(), std::uint8_t{0});
    });
  }
  RegisterDevice chip(const RegisterAddressing& addressing) {
    RegisterDevice device = static_cast<RegisterBus&>(bus).device({.chip_select = 1});
    device.set_addressing(addressing);
    return device;
  }
};

void put_words(FakeI2cChip& chip, std::uint8_t first, std::initializer_list<int> words) {
  for (const int word : words) {
    chip.set(first, {static_cast<std::uint8_t>(word & 0xff), static_cast<std::uint8_t>(word >> 8 & 0xff)});
    first = static_cast<std::uint8_t>(first + 2);
  }
}

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-11 registers on SPI: bits for reading and for several, bytes before the answer; I2C as it was") {
    Written spi;
    std::array<std::uint8_t, 2> two{};
    RegisterDevice plain = spi.chip({});
    CHECK(plain.is_on_spi());
    plain.read_register(0x0f).or_throw();
    plain.read_registers(0x28, two).or_throw();
    plain.write_register(0xf4, 0x27).or_throw();
    CHECK(spi.sent == Bytes{0x8f, 0xa8, 0x74, 0x27});
    spi.sent.clear();
    RegisterDevice burst = spi.chip({.i2c_burst_bit = 0x80, .spi_burst_bit = 0x40});
    burst.read_register(0x0f).or_throw();
    burst.read_registers(0x28, two).or_throw();
    CHECK(spi.sent == Bytes{0x8f, 0xe8});
    spi.sent.clear();
    RegisterDevice late = spi.chip({.spi_dummy_bytes = 1});
    late.read_register(0x00).or_throw();
    CHECK(spi.sent == Bytes{0x80, 0x00});
    spi.sent.clear();
    RegisterDevice commands = spi.chip({.spi_read_bit = 0});
    commands.command(0x1e).or_throw();
    commands.read_word(0xa2).or_throw();
    CHECK(spi.sent == Bytes{0x1e, 0xa2});

    auto wires = std::make_shared<FakeI2c>();
    I2cBus i2c("i2c1", wires);
    wires->chip(0x1c).set(0x28, {1, 2});
    wires->chip(0x1c).set(0xa8, {3, 4});
    RegisterDevice chip = static_cast<RegisterBus&>(i2c).device({.address = 0x1c});
    CHECK_FALSE(chip.is_on_spi());
    CHECK(chip.read_word(0x28).or_throw() == 0x0102);
    chip.set_addressing({.i2c_burst_bit = 0x80});
    CHECK(chip.read_register(0x28).or_throw() == 1);
    CHECK(chip.read_word(0x28).or_throw() == 0x0304);
    CHECK(i2c.counts(0x1c).transfers == 3);
    chip.abandon();
    CHECK(chip.read_register(0x28).error().code == Errc::closed);
  }

  TEST_CASE("US-11 barometers on SPI measure what they measure on I2C") {
    FakeI2c registers;
    FakeI2cChip& bmp280 = registers.chip(0x76);
    bmp280.set(0xd0, {0x58});
    put_words(bmp280, 0x88, {27504, 26435, -1000, 36477, -10685, 3024, 2855, 140, -7, 15500, -14600, 6000});
    bmp280.set(0xf7, {0x65, 0x5a, 0xc0, 0x7e, 0xed, 0x00});
    FakeI2cChip& bmp388 = registers.chip(0x77);
    bmp388.set(0x00, {0x50});
    bmp388.set(0x03, {0x60});
    put_words(bmp388, 0x31, {27000, 19000, 0x00f6, 5000, 1000, 0x2300, 25000, 30000, 0x0003, 1000, 0x00f4});
    bmp388.set(0x04, {0x00, 0x20, 0x6b, 0x00, 0x50, 0x82});
    auto wires = std::make_shared<FakeSpi>();
    bridge(*wires, 0, registers, 0x76, {}, 0x80);
    bridge(*wires, 1, registers, 0x77, {.spi_dummy_bytes = 1});
    SpiBus spi("spi0", wires);
    auto i2c_wires = std::make_shared<FakeI2c>();
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
    std::vector<BarometerReading> small, large;
    const auto heard = loop.subscribe<BarometerReading>("small", [&](const auto& event) { small.push_back(*event); });
    const auto other = loop.subscribe<BarometerReading>("large", [&](const auto& event) { large.push_back(*event); });
    DriverSensor<Barometer> one(loop, {.name = "small", .rate = 10_Hz}, spi, {.chip_select = 0});
    DriverSensor<Barometer> two(loop, {.name = "large", .rate = 10_Hz}, spi, {.chip_select = 1},
                                {.model = BarometerModel::bmp388});
    CHECK_THROWS_AS(DriverSensor<Barometer>(loop, {.name = "third", .rate = 10_Hz}, spi, {.chip_select = 1}),
                    SetupError);  // taken
    loop.advance(1s);
    CHECK(errors.empty());
    REQUIRE(small.size() >= 9);
    CHECK(small.back().pressure == doctest::Approx(100653.27).epsilon(1e-6));
    CHECK(small.back().temperature == doctest::Approx(25.08).epsilon(1e-3));
    REQUIRE(large.size() >= 9);
    std::array<std::uint8_t, 21> trimming{};
    std::array<std::uint8_t, 6> data{};
    for (std::size_t i = 0; i < trimming.size(); ++i) trimming[i] = bmp388.get(static_cast<std::uint8_t>(0x31 + i));
    for (std::size_t i = 0; i < data.size(); ++i) data[i] = bmp388.get(static_cast<std::uint8_t>(0x04 + i));
    const AirMeasurement wanted = Bmp388Trimming::decode(trimming).measurement(data).or_throw();
    CHECK(large.back().pressure == doctest::Approx(wanted.pressure));
    CHECK(bmp280.get(0xf4) == 0x25);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("US-11 NFR-6 a place on the other kind of bus, and a chip without SPI, are told with what to do") {
    const auto problems = [](const std::string& members) {
      const std::string text = R"({"buses": {"i2c1": {"type": "i2c", "device": "/dev/i2c-1"},
        "spi0": {"type": "spi", "device": "/dev/spidev0"}}, "sensors": [{"name": "s", "rate": "10 Hz", )" +
                               members + "}]}";
      return plan_system(standard_registry(), parse_config(text, "spi.json")).problems.text();
    };
    const auto has = [](const std::string& text, const char* words) { return text.find(words) != std::string::npos; };
    CHECK(problems(R"("type": "imu", "model": "mpu9250", "bus": "spi0", "chip_select": 0, "clock": 500000)") == "");
    CHECK(problems(R"("type": "accelerometer", "bus": "spi0", "chip_select": 1)") == "");
    CHECK(problems(R"("type": "barometer", "model": "ms5611", "bus": "spi0", "chip_select": 1, "mode": 0)") == "");
    CHECK(problems(R"("type": "magnetometer", "bus": "spi0", "chip_select": 1)") == "");
    CHECK(has(problems(R"("type": "imu", "bus": "spi0", "chip_select": 0)"), "the MPU-6050 does not support SPI"));
    CHECK(has(problems(R"("type": "magnetometer", "model": "hmc5883l", "bus": "spi0", "chip_select": 0)"),
              "the HMC5883L does not support SPI"));
    CHECK(has(problems(R"("type": "barometer", "bus": "spi0")"), "on SPI, set the chip's `chip_select`"));
    CHECK(has(problems(R"("type": "barometer", "bus": "i2c1", "chip_select": 0)"),
              "on I2C, set the chip's `address`, and remove `chip_select`"));
    CHECK(has(problems(R"("type": "barometer", "bus": "spi0", "chip_select": 0, "address": "0x76")"),
              "a chip on SPI has a `chip_select` and no `address`"));
    CHECK(has(problems(R"("type": "barometer", "bus": "i2c1", "clock": 100000)"), "this works only on SPI"));

    auto wires = std::make_shared<FakeSpi>();
    SpiBus spi("spi0", wires);
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    CHECK_THROWS_WITH_AS(DriverSensor<Barometer>(loop, {.name = "a", .rate = 1_Hz}, spi),
                         doctest::Contains("this bus is of type spi: on SPI, set the chip's"), SetupError);
    CHECK_THROWS_WITH_AS(DriverSensor<Imu>(loop, {.name = "a", .rate = 1_Hz}, spi, {.chip_select = 0}),
                         doctest::Contains("the MPU-6050 does not support SPI"), SetupError);
  }
}
