// Power monitors with more bits or more channels than those of driver_test.cpp, by their data sheets and on a fake bus.
#include <doctest/doctest.h>

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "rtdata/chips/ina.hpp"
#include "rtdata/chips/ina3221.hpp"
#include "sensors/bus_bench.hpp"

using namespace rtdata;
using namespace rtdata::literals;

TEST_SUITE("sensors") {
  TEST_CASE("US-12 US-27 INA228: the data sheet's example; identity, trimming, lost settings, unplugged") {
    // 8.2.2.5: 311040 is 97.2 mV, at 16.2 mOhm 6 A; 245760 is 48 V; the same negative; 4 lower bits are not used.
    const Ina::Config config{InaModel::ina228, 0.0162};
    const PowerReading reading = Ina::decode(311040 << 4, 245760 << 4, config).or_throw();
    CHECK(reading.voltage == doctest::Approx(48).epsilon(1e-12));
    CHECK(reading.current == doctest::Approx(6).epsilon(1e-12));
    CHECK(reading.power == doctest::Approx(288).epsilon(1e-12));
    CHECK(Ina::decode(0xb4100f, 0x00000f, config).or_throw().current == doctest::Approx(-6).epsilon(1e-12));
    CHECK(Ina::decode(0, 0x00000f, config).or_throw().voltage == 0);
    CHECK(Ina::decode(0x7ffff0, 0, config).error().code == Errc::out_of_range);
    CHECK(Ina::decode(0x800000, 0, config).error().code == Errc::out_of_range);
    CHECK(Ina::decode(0x7fffe0, 0, config).or_throw().current == doctest::Approx(524286 * 312.5e-9 / 0.0162));
    CHECK(Ina::decode(0, 0x7ffff0, config).error().code == Errc::out_of_range);
    CHECK(Ina::decode(0, 0xffffff, config).error().code == Errc::out_of_range);

    I2cBench bench;
    FakeI2cChip& chip = bench.wires->chip(0x45);
    chip.set_width(FakeI2cChip::Width::words);
    const auto gives = [&chip](std::uint8_t number, std::array<std::uint8_t, 3> bytes) {
      chip.on_read(number, [bytes, at = std::size_t{0}]() mutable { return bytes[at++ % 3]; });
    };
    gives(0x04, {0x4b, 0xf0, 0x00});
    gives(0x05, {0x3c, 0x00, 0x00});
    chip.set_word(0x3e, 0x5449);
    chip.set_word(0x3f, 0x2381);  // an INA238
    DriverSensor<Ina> sensor(bench.loop, {.name = "panel", .rate = 10_Hz, .retry_longest = 200ms}, bench.bus, {0x45},
                             config);
    CHECK(sensor.health() == Health::faulted);
    CHECK(bench.told("cannot use the chip as an INA228"));
    std::uint16_t flags = 0x8001;
    chip.on_read(0x0b, [&flags, high = true]() mutable {  // conversion complete, until it is read
      const auto byte = static_cast<std::uint8_t>(high ? flags >> 8 : flags & 0xff);
      high = !high;
      if (high) flags = static_cast<std::uint16_t>(flags & ~2);
      return byte;
    });
    chip.set_word(0x3f, 0x2281);
    std::vector<PowerReading> all;
    const auto heard = bench.loop.subscribe<PowerReading>("panel",
                                                          [&](const Event<PowerReading>& e) { all.push_back(*e); });
    bench.loop.advance(450ms);
    CHECK(sensor.health() == Health::ok);
    CHECK(chip.word(0x00) == 0);
    CHECK(chip.word(0x01) == 0xbb68);
    CHECK(chip.word(0x0b) == 0x8001);
    CHECK(all.empty());
    CHECK(sensor.counts().repeated > 0);
    flags |= 2;
    bench.loop.advance(500ms);
    REQUIRE(all.size() == 1);  // one conversion, one event
    CHECK(all[0].power == doctest::Approx(288));
    flags = 0x8002;
    bench.loop.advance(100ms);
    CHECK(sensor.status().reason.find("the checksum of its trimming values is wrong") != std::string::npos);
    flags = 0x8003;
    chip.set_word(0x01, 0xfb68);  // as after a reset
    bench.loop.advance(100ms);
    CHECK(sensor.status().reason.find("it has lost its settings") != std::string::npos);
    CHECK(chip.word(0x01) == 0xbb68);
    CHECK(sensor.counts().unreadable == 2);
    chip.unplug();
    bench.loop.advance(1s);
    CHECK(sensor.health() == Health::faulted);
    CHECK(all.size() == 1);
    chip.plug_in();
    for (int i = 0; i < 10; ++i) {
      flags = 0x8003;
      bench.loop.advance(100ms);
    }
    CHECK(sensor.health() == Health::ok);
    CHECK(all.size() >= 6);
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("US-12 US-27 INA3221: the data sheet's codes; a channel beyond its range; identity, settings, unplugged") {
    // 8.6.2.2: 80 mV is 0x3e80, -80 mV 0xc180; 8 mV of the bus a code, in the upper 13 bits.
    CHECK(Ina3221::decode(0x3e80, 0x2ee0, 0.1).or_throw().current == doctest::Approx(0.8));
    CHECK(Ina3221::decode(0x3e80, 0x2ee0, 0.1).or_throw().voltage == doctest::Approx(12));
    CHECK(Ina3221::decode(0x3e80, 0x2ee0, 0.1).or_throw().power == doctest::Approx(9.6));
    CHECK(Ina3221::decode(0xc180, 0, 0.01).or_throw().current == doctest::Approx(-8));
    CHECK(Ina3221::decode(0xfff8, 0x0008, 0.1).or_throw().current == doctest::Approx(-0.0004));
    CHECK(Ina3221::decode(0x7ff0, 0, 0.1).or_throw().current == doctest::Approx(1.6376));
    CHECK(Ina3221::decode(0x7ff8, 0, 0.1).error().code == Errc::out_of_range);
    CHECK(Ina3221::decode(0x8000, 0, 0.1).error().code == Errc::out_of_range);
    CHECK(Ina3221::decode(0, 0x7ff8, 0.1).error().code == Errc::out_of_range);
    CHECK(Ina3221::decode(0, 0xfff8, 0.1).error().code == Errc::out_of_range);

    I2cBench bench;
    FakeI2cChip& chip = bench.wires->chip(0x41);
    chip.set_width(FakeI2cChip::Width::words);
    chip.set_word(0xfe, 0x5449);
    chip.set_word(0xff, 0x2260);  // an INA226
    DriverSensor<Ina3221> rails(bench.loop, {.name = "rails", .rate = 10_Hz, .retry_longest = 200ms}, bench.bus, {0x41},
                                {.shunt_resistance_2 = 0.01});
    CHECK(rails.health() == Health::faulted);
    CHECK(bench.told("cannot use the chip as an INA3221"));
    chip.set_word(0xff, 0x3220);
    chip.set_word(1, 0x3e80);
    chip.set_word(2, 0x2ee0);
    chip.set_word(3, 0xc180);
    chip.set_word(4, 0x3e80);
    std::vector<ThreePowersReading> all;
    const auto heard = bench.loop.subscribe<ThreePowersReading>(
        "rails", [&](const Event<ThreePowersReading>& e) { all.push_back(*e); });
    bench.loop.advance(450ms);
    CHECK(rails.health() == Health::ok);
    CHECK(chip.word(0) == 0x7127);
    CHECK(all.empty());  // no measurement is ready
    CHECK(rails.counts().repeated > 0);
    chip.set_word(0x0f, 0x0003);
    bench.loop.advance(100ms);
    REQUIRE(all.size() == 1);
    CHECK(all[0].power_1 == doctest::Approx(9.6));
    CHECK(all[0].current_2 == doctest::Approx(-8));
    CHECK(all[0].power_2 == doctest::Approx(-128));
    CHECK(all[0].voltage_3 == 0.0);
    chip.set_word(5, 0x7ff8);
    bench.loop.advance(100ms);
    REQUIRE(all.size() == 2);
    CHECK(all[1].power_1 == doctest::Approx(9.6));
    CHECK_FALSE(all[1].voltage_3);
    CHECK_FALSE(all[1].current_3);
    CHECK_FALSE(all[1].power_3);
    CHECK(rails.counts().unreadable == 1);
    CHECK(rails.status().reason.find("channel 3: the current is larger than the chip can measure") !=
          std::string::npos);
    chip.set_word(1, 0x8000);
    chip.set_word(4, 0x7ff8);
    bench.loop.advance(100ms);
    CHECK(all.size() == 2);  // none of the three
    CHECK(rails.counts().unreadable == 4);
    chip.set_word(1, 0);
    chip.set_word(4, 0);
    chip.set_word(5, 0);
    chip.set_word(0, 0x0000);
    bench.loop.advance(100ms);
    CHECK(rails.status().reason.find("it has lost its settings") != std::string::npos);
    CHECK(chip.word(0) == 0x7127);
    chip.set_word(0x0f, 0x0002);
    bench.loop.advance(1500ms);
    CHECK(bench.told("it has stopped measuring"));
    chip.unplug();
    const std::size_t before = all.size();
    bench.loop.advance(1s);
    CHECK(rails.health() == Health::faulted);
    CHECK(all.size() == before);
    chip.plug_in();
    chip.set_word(0x0f, 0x0003);
    bench.loop.advance(1s);
    CHECK(rails.health() == Health::ok);
    CHECK(all.size() >= before + 5);
    CHECK(bench.loop.runtime().balances());
    CHECK_THROWS_AS(
        DriverSensor<Ina3221>(bench.loop, {.name = "b", .rate = 1_Hz}, bench.bus, {0x42}, {.shunt_resistance_3 = 0}),
        SetupError);
  }
}
