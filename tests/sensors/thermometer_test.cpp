// Thermometers on a fake SPI bus: MAX31855, MAX31856, MAX31865.
#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <memory>
#include <string>
#include <vector>

#include "rtdata/chips/max31855.hpp"
#include "rtdata/chips/max31856.hpp"
#include "rtdata/chips/max31865.hpp"
#include "sensors/bus_bench.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

/// A chip with registers: the first byte of a transfer is the number, with bit 7 to write; then it goes on by itself.
template <std::size_t N>
struct Registers {
  std::array<std::uint8_t, N> memory{};
  std::size_t at = 0;
  void (*written)(Registers&, std::size_t number) = nullptr;
  FakeSpi::Chip chip() {
    return [this](std::span<const std::uint8_t> write, std::span<std::uint8_t> read) {
      if (!write.empty()) at = write[0] & 0x7f;
      for (std::size_t i = 1; i < write.size(); ++i) {
        memory[at % N] = write[i];
        if (written != nullptr) written(*this, at % N);
        ++at;
      }
      for (std::uint8_t& byte : read) byte = memory[at++ % N];
    };
  }
};

FakeSpi::Chip always(std::uint8_t byte) {
  return [byte](std::span<const std::uint8_t>, std::span<std::uint8_t> read) {
    std::fill(read.begin(), read.end(), byte);
  };
}

FakeSpi::Chip answering(std::uint32_t word) {
  return [word](std::span<const std::uint8_t>, std::span<std::uint8_t> read) {
    for (std::size_t i = 0; i < read.size(); ++i) read[i] = static_cast<std::uint8_t>(word >> (24 - 8 * i) & 0xff);
  };
}

Result<ThermocoupleReading> max31855(std::uint32_t word) {
  std::array<std::uint8_t, 4> bytes{};
  answering(word)({}, bytes);
  return Max31855::decode(bytes);
}

constexpr std::array<std::uint8_t, 16> max31856_after_reset{0x00, 0x03, 0xff, 0x7f, 0xc0, 0x7f, 0xff, 0x80};
SensorConfig fast(const char* name, Rate rate) {
  return {.name = name, .rate = rate, .retry_first = 10ms, .retry_longest = 20ms};
}

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-11 MAX31855: the data sheet's tables of temperatures, its fault bits, and nobody") {
    struct Row {
      std::uint32_t code;
      double degrees;
    };
    // 19-5793, table 4: bits 31 to 18.
    for (const Row& row : {Row{0x1900, 1600.00}, Row{0x0fa0, 1000.00}, Row{0x0193, 100.75}, Row{0x0064, 25.00},
                           Row{0x0000, 0.00}, Row{0x3fff, -0.25}, Row{0x3ffc, -1.00}, Row{0x3c18, -250.00}})
      CHECK(max31855(row.code << 18 | 0x10).or_throw().temperature == row.degrees);
    // Table 5: bits 15 to 4.
    for (const Row& row : {Row{0x7f0, 127.0000}, Row{0x649, 100.5625}, Row{0x190, 25.0000}, Row{0x000, 0.0000},
                           Row{0xfff, -0.0625}, Row{0xff0, -1.0000}, Row{0xec0, -20.0000}, Row{0xc90, -55.0000}})
      CHECK(max31855(1u << 18 | row.code << 4).or_throw().cold_junction == row.degrees);
    CHECK(max31855(0x00010191).error().why == "the thermocouple is open");
    CHECK(max31855(0x00010192).error().why == "the thermocouple is shorted to ground");
    CHECK(max31855(0x00010194).error().why == "the thermocouple is shorted to the supply");
    CHECK(max31855(0x00010190).error().why == "it reports an unknown fault");
    CHECK(max31855(0xffffffff).error().why == "bits that must be 0 are 1: no chip answers");
    CHECK(max31855(0x00000000).error().why == "it gives only zeros: no chip answers");
  }

  TEST_CASE("US-11 US-27 a MAX31855: absent, open, shorted, failing transfers, and what it measures") {
    SpiBench bench;
    std::vector<ThermocoupleReading> all;
    const auto heard = bench.loop.subscribe<ThermocoupleReading>(
        "oven", [&](const Event<ThermocoupleReading>& event) { all.push_back(*event); });
    DriverSensor<Max31855> oven(bench.loop, fast("oven", 10_Hz), bench.bus);
    bench.loop.advance(1s);
    CHECK(all.empty());
    CHECK(oven.health() == Health::faulted);
    CHECK(oven.counts().failed > 2);
    bench.wires->on_transfer(0, answering(0x0193u << 18 | 0x1900));
    bench.loop.advance(1s);
    CHECK(oven.health() == Health::ok);
    REQUIRE(!all.empty());
    CHECK(all[0].temperature == 100.75);
    CHECK(all[0].cold_junction == 25);
    const std::size_t before = all.size();
    bench.wires->on_transfer(0, answering(0x0193u << 18 | 0x11901));
    bench.loop.advance(1s);
    CHECK(all.size() == before);
    CHECK(bench.told("cannot read the MAX31855: bus spi1, chip select 0: the thermocouple is open"));
    bench.wires->on_transfer(0, always(0));
    bench.loop.advance(1s);
    CHECK(all.size() == before);
    bench.wires->on_transfer(0, answering(0x0064u << 18 | 0x1900));
    bench.wires->fail(0, 2, EIO);
    bench.loop.advance(2s);
    CHECK(oven.health() == Health::ok);
    CHECK(all.back().temperature == 25);
    oven.stop();
    CHECK(oven.counts().balances());
  }

  TEST_CASE("US-11 MAX31856: the data sheet's tables of temperatures, and its fault register") {
    std::array<std::uint8_t, 16> registers{};
    const auto tip = [&](std::uint32_t code) {
      registers[12] = static_cast<std::uint8_t>(code >> 16 & 0xff);
      registers[13] = static_cast<std::uint8_t>(code >> 8 & 0xff);
      registers[14] = static_cast<std::uint8_t>(code & 0xff);
      return Max31856::decode(registers).or_throw().temperature;
    };
    // 19-7534, linearized thermocouple temperature: 19 bits, left-aligned.
    CHECK(tip(0x640000) == 1600);
    CHECK(tip(0x3e8000) == 1000);
    CHECK(tip(0x064f00) == 100.9375);
    CHECK(tip(0x019000) == 25);
    CHECK(tip(0x000100) == 0.0625);
    CHECK(tip(0x000000) == 0);
    CHECK(tip(0xffff00) == -0.0625);
    CHECK(tip(0xfff000) == -1);
    CHECK(tip(0xf06000) == -250);
    CHECK(tip(0x000020) == 0.0078125);
    const auto cold = [&](unsigned code) {
      registers[10] = static_cast<std::uint8_t>(code >> 8 & 0xff);
      registers[11] = static_cast<std::uint8_t>(code & 0xff);
      return Max31856::decode(registers).or_throw().cold_junction;
    };
    // Cold-junction temperature: 14 bits, left-aligned.
    CHECK(cold(0x7d00) == 125);
    CHECK(cold(0x1900) == 25);
    CHECK(cold(0x0080) == 0.5);
    CHECK(cold(0x0004) == 0.015625);
    CHECK(cold(0xff80) == -0.5);
    CHECK(cold(0xc900) == -55);
    const auto fault = [&](unsigned bits) {
      registers[15] = static_cast<std::uint8_t>(bits);
      return Max31856::decode(registers).error();
    };
    CHECK(fault(0x01).why == "the thermocouple is open");
    CHECK(fault(0x02).why == "an input is below ground or above the supply");
    CHECK(fault(0x40).code == Errc::out_of_range);
    CHECK(fault(0x80).why == "the cold junction is outside its range");
  }

  TEST_CASE("US-11 US-27 a MAX31856: its settings, its time, a reset in a measurement, faults, nobody there") {
    SpiBench bench;
    Registers<16> chip;
    chip.memory = max31856_after_reset;
    chip.written = [](Registers<16>& all, std::size_t number) {
      if (number != 0 || (all.memory[0] & 0x40) == 0) return;
      all.memory[0] &= 0xbf;  // has measured
      all.memory[10] = 0x19;
      all.memory[12] = 0x06;
      all.memory[13] = 0x4f;
    };
    std::vector<ThermocoupleReading> all;
    std::vector<Duration> heard_at;
    const auto heard = bench.loop.subscribe<ThermocoupleReading>("oven", [&](const Event<ThermocoupleReading>& event) {
      all.push_back(*event);
      heard_at.push_back(bench.loop.now() - MonotonicTime{});
    });
    DriverSensor<Max31856> oven(bench.loop, fast("oven", 2_Hz), bench.bus, {.mode = 1},
                                {.thermocouple = Thermocouple::t, .average = 4});
    CHECK(oven.health() == Health::faulted);
    CHECK(bench.told("it does not keep its settings"));  // ones
    bench.wires->on_transfer(0, always(0));
    bench.loop.advance(1s);
    CHECK(oven.health() == Health::faulted);
    bench.wires->on_transfer(0, chip.chip());
    bench.loop.advance(2s);
    CHECK(oven.health() == Health::ok);
    CHECK(chip.memory[0] == 0x11);
    CHECK(chip.memory[1] == 0x27);
    REQUIRE(all.size() >= 2);
    CHECK(all[0].temperature == 100.9375);
    CHECK(all[0].cold_junction == 25);
    CHECK(heard_at[1] - heard_at[0] == 500ms);
    const auto before = oven.counts();
    bench.loop.advance(100ms);  // into a measurement
    chip.memory = max31856_after_reset;
    bench.loop.advance(400ms);
    CHECK(oven.counts().unreadable == before.unreadable + 1);
    CHECK(bench.told("it has lost its settings since the start"));
    bench.loop.advance(1s);
    CHECK(oven.counts().published == before.published + 2);
    chip.memory[15] = 1;
    bench.loop.advance(500ms);
    CHECK(oven.status().reason.find("the thermocouple is open") != std::string::npos);
    chip.memory[15] = 0;
    chip.written = nullptr;  // never ends
    bench.loop.advance(1s);
    CHECK(oven.status().reason.find("the measurement takes too long") != std::string::npos);
    oven.stop();
    CHECK(oven.counts().balances());
    CHECK_THROWS_WITH_AS(
        DriverSensor<Max31856>(bench.loop, fast("b", 1_Hz), bench.bus, {.chip_select = 1}, {.average = 3}),
        doctest::Contains("take 1, 2, 4, 8 or 16"), SetupError);
  }

  TEST_CASE("US-11 MAX31865: platinum's resistances of IEC 60751 from -200 to 850 degrees, and wires that are faulty") {
    struct Row {
      double degrees, ohm;
    };
    for (const Row& row : {Row{-200, 18.52}, Row{-150, 39.72}, Row{-100, 60.26}, Row{-50, 80.31}, Row{-10, 96.09},
                           Row{0, 100.00}, Row{10, 103.90}, Row{50, 119.40}, Row{100, 138.51}, Row{200, 175.86},
                           Row{400, 247.09}, Row{600, 313.71}, Row{850, 390.48}}) {
      CAPTURE(row.degrees);
      const auto degrees = Max31865::temperature_of(row.ohm / 100);
      REQUIRE(degrees);
      CHECK(std::abs(*degrees - row.degrees) < 0.02);
    }
    CHECK(Max31865::temperature_of(1) == 0);
    CHECK_FALSE(Max31865::temperature_of(0.18));
    CHECK_FALSE(Max31865::temperature_of(3.92));
    CHECK_FALSE(Max31865::temperature_of(0));
    const auto decoded = [](unsigned code, unsigned fault, const Max31865::Config& config = {}) {
      std::array<std::uint8_t, 8> registers{};
      registers[1] = static_cast<std::uint8_t>(code >> 7 & 0xff);
      registers[2] = static_cast<std::uint8_t>(code << 1 & 0xff);
      registers[7] = static_cast<std::uint8_t>(fault);
      return Max31865::decode(registers, config);
    };
    // 19-6478, with the data sheet's reference of 400 Ohm: 100 Ohm is code 0x2000, and code / 32 - 256 about its
    // degrees.
    const Max31865::Config sheet{.reference_resistance = 400};
    CHECK(decoded(0x2000, 0, sheet).or_throw().resistance == 100);
    CHECK(decoded(0x2000, 0, sheet).or_throw().temperature == doctest::Approx(0));
    CHECK(decoded(11346, 0, sheet).or_throw().temperature == doctest::Approx(100).epsilon(0.001));
    CHECK(decoded(0x2000, 0, {.element = RtdElement::pt1000}).or_throw().resistance == 1075);
    CHECK(decoded(0x7fff, 0).error().code == Errc::out_of_range);
    CHECK(decoded(0, 0).error().code == Errc::out_of_range);
    CHECK(decoded(0x2000, 0x20).error().why == "the element, or a wire to it, is open");
    CHECK(decoded(0x2000, 0x10).error().code == Errc::bad_data);
    CHECK(decoded(0x2000, 0x08).error().why == "the wire RTDIN- is open or shorted");
    CHECK(decoded(0x2000, 0x04).error().why == "an input is below ground or above the supply");
    CHECK(decoded(0x2000, 0x80).error().code == Errc::bad_data);
  }

  TEST_CASE("US-11 US-27 a MAX31865: current only while it measures, wires, faults, a reset, nobody there") {
    SpiBench bench;
    Registers<8> chip;
    chip.written = [](Registers<8>& all, std::size_t number) {
      if (number != 0) return;
      if ((all.memory[0] & 0x04) != 0) all.memory[0] &= 0xf3;  // has looked for faults
      if ((all.memory[0] & 0x20) != 0) {
        all.memory[0] &= 0xdf;
        all.memory[1] = 0x40;
      }
      all.memory[0] &= 0xfd;
    };
    std::vector<RtdReading> all;
    const auto heard = bench.loop.subscribe<RtdReading>("tank", [&](const Event<RtdReading>& e) { all.push_back(*e); });
    DriverSensor<Max31865> tank(bench.loop, fast("tank", 10_Hz), bench.bus, {.mode = 1},
                                {.wires = 3, .reference_resistance = 400});
    CHECK(tank.health() == Health::faulted);
    CHECK(bench.told("it does not keep its settings"));
    bench.wires->on_transfer(0, chip.chip());
    bench.loop.advance(1s);
    CHECK(tank.health() == Health::ok);
    REQUIRE(!all.empty());
    CHECK(all[0].resistance == 100);
    CHECK(std::abs(all[0].temperature) < 1e-9);
    const auto count = tank.counts();
    CHECK(count.missed + count.late == 0);
    bench.loop.advance(1ms);  // settling
    CHECK(chip.memory[0] == 0x91);
    bench.loop.advance(98ms);
    CHECK(chip.memory[0] == 0x11);  // the current is off
    bench.loop.advance(31ms);       // into a measurement
    const auto before = tank.counts();
    chip.memory = {};
    bench.loop.advance(70ms);
    CHECK(tank.counts().unreadable == before.unreadable + 1);
    CHECK(bench.told("it has lost its settings since the start"));
    bench.loop.advance(1s);
    CHECK(tank.health() == Health::ok);
    CHECK(tank.counts().published >= before.published + 9);
    chip.memory[7] = 0x20;
    bench.loop.advance(200ms);
    CHECK(tank.status().reason.find("the element, or a wire to it, is open") != std::string::npos);
    chip.memory[7] = 0;
    bench.wires->fail(0, 1, EIO);
    bench.loop.advance(1s);
    CHECK(tank.health() == Health::ok);
    bench.wires->on_transfer(0, {});
    bench.loop.advance(1s);
    CHECK(tank.health() == Health::faulted);
    tank.stop();
    CHECK(tank.counts().balances());
    CHECK_THROWS_AS(DriverSensor<Max31865>(bench.loop, fast("b", 1_Hz), bench.bus, {.chip_select = 1}, {.wires = 5}),
                    SetupError);
  }
}
