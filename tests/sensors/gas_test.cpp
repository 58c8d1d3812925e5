// Sensors of gases and particles, by their data sheets and on a bus made of memory.
#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "rtdata/chips/barometer.hpp"
#include "rtdata/chips/bme680.hpp"
#include "rtdata/chips/scd4x.hpp"
#include "rtdata/chips/sgp.hpp"
#include "rtdata/chips/sps30.hpp"
#include "rtdata/testing/fake_i2c.hpp"
#include "sensors/fixture.hpp"
#include "sensors/sample_chip.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

constexpr std::string_view field_of_bme680 = "80 00 4b 1d 40 75 c8 40 4d 2c 00 00 00 7f b4 00 00";
template <std::size_t size>
std::array<std::uint8_t, size> array_of(std::string_view hexadecimal) {
  const std::vector<std::uint8_t> bytes = bytes_of(hexadecimal);
  std::array<std::uint8_t, size> all{};
  REQUIRE(bytes.size() == size);
  std::copy(bytes.begin(), bytes.end(), all.begin());
  return all;
}
Bme680Trimming trimming_of_sample() {
  const auto& bytes = Bme680::samples[0].bytes;
  return Bme680Trimming::decode(array_of<23>(bytes[2].bytes), array_of<14>(bytes[3].bytes),
                                array_of<5>(bytes[4].bytes));
}

/// A chip that answers commands, and acknowledges no other read.
class Answers final : public I2cTransport {
 public:
  void set(std::string_view request, std::string_view answer) { answers_[bytes_of(request)] = bytes_of(answer); }
  void forget(std::string_view request) { answers_.erase(bytes_of(request)); }
  std::size_t count(std::string_view request) const {
    return static_cast<std::size_t>(std::count(requests_.begin(), requests_.end(), bytes_of(request)));
  }
  bool is_plugged_in = true;

  int transfer(unsigned, std::span<const std::uint8_t> write, std::span<std::uint8_t> read) noexcept override {
    if (!is_plugged_in) return ENXIO;
    if (!write.empty()) requests_.emplace_back(write.begin(), write.end());
    if (read.empty()) return 0;
    const auto answer = requests_.empty() ? answers_.end() : answers_.find(requests_.back());
    if (answer == answers_.end() || answer->second.size() < read.size()) return ENXIO;
    std::copy_n(answer->second.begin(), read.size(), read.begin());
    return 0;
  }

 private:
  std::map<std::vector<std::uint8_t>, std::vector<std::uint8_t>> answers_;
  std::vector<std::vector<std::uint8_t>> requests_;
};

template <class Driver>
struct AnswersBench {
  std::shared_ptr<Answers> chip = std::make_shared<Answers>();
  I2cBus bus{"i2c1", chip};
  Loop loop{Loop::Manual{}};
  std::vector<std::string> errors;
  std::vector<typename Driver::Value> all;
  Subscription heard;
  DriverSensor<Driver> sensor;
  AnswersBench() {
    be_quiet(loop);
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
    for (const ChipBytes& one : Driver::samples[0].bytes)
      if (!one.at.empty()) chip->set(one.at, one.bytes);
  }
  void open(typename Driver::Config config = {}) {
    heard = loop.subscribe<typename Driver::Value>(
        "air", [this](const Event<typename Driver::Value>& e) { all.push_back(*e); });
    sensor = DriverSensor<Driver>(loop, {.name = "air", .rate = 1_Hz, .retry_longest = 200ms}, bus, Driver::place,
                                  config);
    loop.advance(500ms);  // between two ticks
  }
  bool says(const std::string& part) { return sensor.status().reason.find(part) != std::string::npos; }
  bool told(const std::string& part) const {
    return std::any_of(errors.begin(), errors.end(),
                       [&](const std::string& error) { return error.find(part) != std::string::npos; });
  }
  /// Unplugged, it gives nothing; plugged in again, it gives something.
  void expect_recovery() {
    chip->is_plugged_in = false;
    loop.advance(1s);
    const std::size_t before = all.size();
    loop.advance(9s);
    CHECK(sensor.health() == Health::faulted);
    CHECK(all.size() == before);
    chip->is_plugged_in = true;
    loop.advance(10s);
    CHECK(sensor.health() == Health::ok);
    CHECK(all.size() >= before + 5);
    CHECK(loop.runtime().balances());
  }
};

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-12 Sensirion's words: the data sheets' checksums, and each wrong bit") {
    CHECK(detail::sensirion_command(0x3682) == std::array<std::uint8_t, 2>{0x36, 0x82});
    // SGP40, table 9; SCD4x, 3.7.2: 1 has the checksum 0xb0.
    CHECK(detail::sensirion_command(0x260f, std::uint16_t{0x8000}, std::uint16_t{0x6666}) ==
          std::array<std::uint8_t, 8>{0x26, 0x0f, 0x80, 0x00, 0xa2, 0x66, 0x66, 0x93});
    CHECK(detail::sensirion_command(0x2416, std::uint16_t{1}) ==
          std::array<std::uint8_t, 5>{0x24, 0x16, 0x00, 0x01, 0xb0});
    constexpr std::array<std::uint8_t, 6> good{0xbe, 0xef, 0x92, 0x01, 0xe0, 0xb4};  // SHT3x, 4.12; SCD4x, 3.7.1
    REQUIRE(detail::sensirion_words(good));
    CHECK(*detail::sensirion_words(good) == std::array<std::uint16_t, 2>{0xbeef, 0x01e0});
    for (std::size_t byte = 0; byte < good.size(); ++byte) {
      for (int bit = 0; bit < 8; ++bit) {
        auto wrong = good;
        wrong[byte] = static_cast<std::uint8_t>(wrong[byte] ^ 1 << bit);
        CHECK_FALSE(detail::sensirion_words(wrong));
      }
    }
  }

  TEST_CASE("US-12 US-27 SCD4x: the data sheet's example; altitude, not ready, checksums, another chip, unplugged") {
    const Scd4xReading example = Scd4x::decode({0x01f4, 0x6667, 0x5eb9}).or_throw();
    CHECK(example.co2 == 500);
    CHECK(example.temperature == doctest::Approx(25).epsilon(2e-4));
    CHECK(example.humidity == doctest::Approx(37).epsilon(1e-4));
    CHECK(Scd4x::decode({0x9c40, 0, 0}).or_throw().temperature == -45);
    CHECK(Scd4x::decode({1, 0xffff, 0xffff}).or_throw().temperature == 130);
    CHECK(Scd4x::decode({1, 0xffff, 0xffff}).or_throw().humidity == 100);
    CHECK(Scd4x::decode({0, 0x6667, 0x5eb9}).error().code == Errc::bad_data);

    AnswersBench<Scd4x> bench;
    bench.chip->set("36 82", "f8 96 30 9f 07 c2 3b be 89");
    bench.open({.altitude = 520});
    CHECK(bench.told("cannot use the chip as an SCD40 or SCD41: bus i2c1, 0x62: its serial number"));
    CHECK(bench.chip->count("21 b1") == 0);
    bench.chip->set("36 82", "f8 96 31 9f 07 c2 3b be 89");
    bench.chip->set("e4 b8", "80 00 a2");
    bench.loop.advance(10s);
    CHECK(bench.sensor.health() == Health::ok);
    CHECK(bench.chip->count("24 27 02 08 e1") == 1);  // 520 m, before it measures
    CHECK(bench.chip->count("21 b1") == 1);
    CHECK(bench.all.empty());
    CHECK(bench.sensor.counts().repeated > 5);
    CHECK(bench.chip->count("ec 05") == 0);
    bench.chip->set("e4 b8", "80 06 04");
    bench.loop.advance(1s);
    REQUIRE(bench.all.size() == 1);
    CHECK(bench.all[0].co2 == 500);
    bench.chip->set("ec 05", "01 f4 33 66 67 a2 5e b9 3d");
    bench.loop.advance(1s);
    CHECK(bench.says("a checksum is wrong"));
    bench.chip->set("e4 b8", "80 06 05");
    bench.loop.advance(1s);
    CHECK(bench.says("a checksum is wrong"));
    CHECK(bench.sensor.counts().unreadable == 2);
    bench.chip->set("e4 b8", "80 06 04");
    bench.chip->set("ec 05", "00 00 81 66 67 a2 5e b9 3c");
    bench.loop.advance(1s);
    CHECK(bench.says("it reports 0 ppm"));
    CHECK(bench.all.size() == 1);
    bench.chip->set("e4 b8", "80 00 a2");  // as after a reset
    bench.loop.advance(14s);
    CHECK_FALSE(bench.told("it has stopped measuring"));
    bench.loop.advance(3s);
    CHECK(bench.told("it has stopped measuring"));
    bench.chip->set("e4 b8", "80 06 04");
    bench.chip->set("ec 05", "01 f4 33 66 67 a2 5e b9 3c");
    bench.expect_recovery();
    const std::size_t stops = bench.chip->count("3f 86");
    bench.sensor.stop();
    bench.loop.advance(10ms);
    CHECK(bench.chip->count("3f 86") == stops + 1);
    CHECK_THROWS_AS(DriverSensor<Scd4x>(bench.loop, {.name = "b", .rate = 1_Hz}, bench.bus, {0x63}, {.altitude = -1}),
                    SetupError);
    I2cBus quick("quick", bench.chip, {.timeout = 400ms});
    CHECK_THROWS_AS(DriverSensor<Scd4x>(bench.loop, {.name = "c", .rate = 1_Hz}, quick), SetupError);
  }

  TEST_CASE("US-12 US-27 SGP30: no air quality while it warms up; product type, checksums, unplugged") {
    const Sgp30Reading warm = Sgp30::decode(std::array<std::uint16_t, 2>{450, 12}, {0x3408, 0x4801});
    CHECK(warm.co2_equivalent == 450.0);
    CHECK(warm.tvoc == 12.0);
    CHECK(warm.hydrogen_signal == 0x3408);
    CHECK(warm.ethanol_signal == 0x4801);
    CHECK_FALSE(Sgp30::decode({}, {1, 2}).co2_equivalent);

    AnswersBench<Sgp30> bench;
    bench.chip->set("20 2f", "10 22 0b");  // an SGPC3
    bench.open();
    CHECK(bench.told("it does not answer with its product type"));
    bench.chip->set("20 2f", "00 22 65");
    bench.loop.advance(1s);
    CHECK(bench.sensor.health() == Health::ok);
    CHECK(bench.chip->count("20 03") == 1);
    bench.loop.advance(13s);
    REQUIRE(bench.all.size() >= 13);
    for (const Sgp30Reading& one : bench.all) {
      CHECK_FALSE(one.co2_equivalent);
      CHECK_FALSE(one.tvoc);
      CHECK(one.hydrogen_signal == 0x3408);
    }
    bench.loop.advance(3s);
    CHECK(bench.all.back().co2_equivalent == 400.0);
    CHECK(bench.all.back().tvoc == 0.0);
    CHECK(bench.chip->count("20 08") == bench.all.size());  // one a second, and no more
    const std::size_t before = bench.all.size();
    bench.chip->set("20 08", "01 90 4d 00 00 81");
    bench.loop.advance(1s);
    CHECK(bench.says("a checksum is wrong"));
    bench.chip->set("20 08", "01 90 4c 00 00 81");
    bench.chip->set("20 50", "34 08 09 48 01 0f");
    bench.loop.advance(1s);
    CHECK(bench.sensor.counts().unreadable == 2);
    CHECK(bench.all.size() == before);
    bench.chip->set("20 50", "34 08 09 48 01 0e");
    bench.loop.advance(1s);
    CHECK(bench.all.size() == before + 1);
    CHECK(bench.all.back().co2_equivalent == 400.0);
    bench.expect_recovery();
    CHECK_FALSE(bench.all.back().co2_equivalent);  // its baseline began anew
  }

  TEST_CASE("US-12 US-27 SGP40: the data sheet's corrections; its heater, checksums, another chip, unplugged") {
    const auto bytes = [](double temperature, double humidity) {
      return Sgp40::request({.temperature = temperature, .humidity = humidity});
    };
    // Table 10.
    CHECK(bytes(25, 50) == std::array<std::uint8_t, 8>{0x26, 0x0f, 0x80, 0x00, 0xa2, 0x66, 0x66, 0x93});
    CHECK(bytes(-45, 0) == std::array<std::uint8_t, 8>{0x26, 0x0f, 0x00, 0x00, 0x81, 0x00, 0x00, 0x81});
    CHECK(bytes(130, 100) == std::array<std::uint8_t, 8>{0x26, 0x0f, 0xff, 0xff, 0xac, 0xff, 0xff, 0xac});

    AnswersBench<Sgp40> bench;
    bench.chip->set("36 82", "00 00 00 00 00 00 00 00 00");
    bench.open();
    CHECK(bench.told("cannot use the chip as an SGP40"));
    bench.chip->set("36 82", "00 00 81 01 a2 eb 31 c2 e2");
    bench.loop.advance(3s);
    CHECK(bench.sensor.health() == Health::ok);
    REQUIRE(bench.all.size() >= 2);
    CHECK(bench.all[0].signal == 30000);
    const std::size_t before = bench.all.size();
    bench.chip->set("26 0f 80 00 a2 66 66 93", "75 30 09");
    bench.loop.advance(1s);
    CHECK(bench.says("a checksum is wrong"));
    CHECK(bench.all.size() == before);
    bench.chip->set("26 0f 80 00 a2 66 66 93", "75 30 08");
    bench.expect_recovery();
    const std::size_t offs = bench.chip->count("36 15");
    bench.sensor.stop();
    bench.loop.advance(10ms);
    CHECK(bench.chip->count("36 15") == offs + 1);
    CHECK_THROWS_AS(DriverSensor<Sgp40>(bench.loop, {.name = "b", .rate = 1_Hz}, bench.bus, {0x58}, {.humidity = 101}),
                    SetupError);
    CHECK_THROWS_AS(
        DriverSensor<Sgp40>(bench.loop, {.name = "b", .rate = 1_Hz}, bench.bus, {0x58}, {.temperature = -46}),
        SetupError);
  }

  TEST_CASE("US-12 US-27 SPS30: numbers of 32 bits; fan and laser, not ready, checksums, another chip, unplugged") {
    std::array<std::uint16_t, 20> words{};
    words[2] = 0x42f6;  // 123.456
    words[3] = 0xe979;
    CHECK(Sps30::decode(words).or_throw().mass_2_5 == doctest::Approx(123.456));
    CHECK(Sps30::decode(words).or_throw().typical_size == 0);
    for (const int wrong : {0xbf80, 0x7fc0, 0x7f80, 0xff80}) {  // -1, no number, infinities
      words[0] = static_cast<std::uint16_t>(wrong);
      CHECK(Sps30::decode(words).error().code == Errc::bad_data);
    }

    AnswersBench<Sps30> bench;
    bench.chip->set("d1 00", "02 02 3b");
    bench.open();
    CHECK(bench.told("cannot use the chip as an SPS30"));
    bench.chip->set("d1 00", "02 02 3a");
    bench.chip->set("02 02", "00 00 81");
    bench.loop.advance(5s);
    CHECK(bench.sensor.health() == Health::ok);
    CHECK(bench.chip->count("00 10 03 00 ac") == 1);
    CHECK(bench.all.empty());
    CHECK(bench.sensor.counts().repeated >= 4);
    bench.chip->set("02 02", "00 01 b0");
    bench.loop.advance(1s);
    REQUIRE(bench.all.size() == 1);
    const ParticleReading& one = bench.all[0];
    CHECK(one.mass_1_0 == 1);
    CHECK(one.mass_2_5 == 2);
    CHECK(one.mass_4_0 == 3);
    CHECK(one.mass_10 == 4);
    CHECK(one.number_0_5 == 5);
    CHECK(one.number_1_0 == 6);
    CHECK(one.number_2_5 == 7);
    CHECK(one.number_4_0 == 8);
    CHECK(one.number_10 == 9);
    CHECK(one.typical_size == 0.5);
    bench.chip->set("d2 06", "00 00 81 00 10 c2");
    bench.loop.advance(1s);
    CHECK(bench.says("its fan does not turn"));
    bench.chip->set("d2 06", "00 00 81 00 20 07");
    bench.loop.advance(1s);
    CHECK(bench.says("its laser fails"));
    bench.chip->set("d2 06", "00 20 07 00 00 81");
    bench.loop.advance(1s);
    CHECK(bench.says("its fan turns too fast or too slowly"));
    bench.chip->set("d2 06", "00 20 08 00 00 81");
    bench.loop.advance(1s);
    CHECK(bench.says("a checksum is wrong"));
    CHECK(bench.sensor.counts().unreadable == 4);
    CHECK(bench.all.size() == 1);
    bench.chip->set("d2 06", "00 00 81 00 00 81");
    bench.expect_recovery();
    bench.chip->set("02 02", "00 00 81");
    bench.loop.advance(17s);
    CHECK(bench.told("it has stopped measuring"));
    const std::size_t stops = bench.chip->count("01 04");
    bench.chip->set("d1 00", "02 01 69");  // firmware that has no status
    bench.chip->set("02 02", "00 01 b0");
    bench.chip->forget("d2 06");
    bench.expect_recovery();
    bench.sensor.stop();
    bench.loop.advance(10ms);
    CHECK(bench.chip->count("01 04") == stops + 1);
  }

  TEST_CASE("US-12 BME680, BME688: compensation, gas in all ranges, and the heater, by Bosch's formulas for integers") {
    const Bme680Trimming trimming = trimming_of_sample();
    CHECK(trimming.t1 == 26004);
    CHECK(trimming.t2 == 26429);
    CHECK(trimming.p2 == -10560);
    CHECK(trimming.p6 == 30);
    CHECK(trimming.p7 == 33);
    CHECK(trimming.h1 == 748);
    CHECK(trimming.h2 == 1012);
    CHECK(trimming.heater1 == -22);
    CHECK(trimming.heater2 == -9185);
    CHECK(trimming.heater_range == 1);
    CHECK(trimming.switching_error == 1);
    CHECK_FALSE(Bme680Trimming{}.is_usable());
    struct Case {
      const char* bytes;
      double temperature, pressure, humidity;  // by the other formulas, which round
    };
    for (const Case& one : {Case{"80 00 4b 1d 40 75 c8 40 4d 2c 00 00 00 00 00 00 00", 20.91, 105873, 38.531},
                            {"80 00 58 00 00 6a 00 00 50 00 00 00 00 00 00 00 00", 5.71, 94437, 41.251},
                            {"80 00 40 00 00 7d 00 00 60 00 00 00 00 00 00 00 00", 30.23, 115420, 70.428}}) {
      CAPTURE(one.bytes);
      const Bme680Reading reading = trimming.measurement(array_of<17>(one.bytes), true).or_throw();
      CHECK(std::abs(reading.temperature - one.temperature) < 0.01);
      CHECK(std::abs(reading.pressure - one.pressure) < 6);
      CHECK(std::abs(reading.humidity - one.humidity) < 0.02);
      CHECK_FALSE(reading.gas_resistance);  // not valid
    }
    for (const char* skipped :
         {"80 00 80 00 00 75 c8 40 4d 2c 00 00 00 7f b4 00 00", "80 00 4b 1d 40 80 00 00 4d 2c 00 00 00 7f b4 00 00",
          "80 00 4b 1d 40 75 c8 40 80 00 00 00 00 7f b4 00 00"})
      CHECK(trimming.measurement(array_of<17>(skipped), true).error().code == Errc::bad_data);
    CHECK(trimming.gas(510, 4) == doctest::Approx(500244).epsilon(1e-5));
    CHECK(trimming.gas(700, 5) == doctest::Approx(217547).epsilon(1e-5));
    CHECK(trimming.gas(100, 7) == doctest::Approx(91150).epsilon(1e-5));
    CHECK(trimming.gas(1000, 13) == doctest::Approx(714.65).epsilon(1e-5));
    CHECK(trimming.gas(0, 15) == doctest::Approx(394.2).epsilon(1e-4));
    Bme680Trimming other = trimming;
    other.is_bme688 = true;
    CHECK(other.gas(512, 0) == doctest::Approx(64e6));
    CHECK(other.gas(700, 5) == doctest::Approx(1757939.9));
    CHECK(other.gas(0, 15) == doctest::Approx(3125));
    CHECK(std::abs(trimming.heater_code(320, 25) - 119) <= 1);
    CHECK(std::abs(trimming.heater_code(200, 25) - 86) <= 2);
    // BME680, 3.2.1: 0x59 is 100 ms.
    CHECK(Bme680::wait_code(100ms) == 0x59);
    CHECK(Bme680::wait_code(63ms) == 0x3f);
    CHECK(Bme680::wait_code(64ms) == 0x50);
    CHECK(Bme680::wait_code(4032ms) == 0xff);
  }

  TEST_CASE("US-12 US-27 BME680: heater, its settings, a heater that is cold, a BME688, another chip, unplugged") {
    auto wires = std::make_shared<FakeI2c>();
    I2cBus bus("i2c1", wires);
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
    FakeI2cChip& chip = wires->chip(0x77);
    const auto put = [&chip](std::string_view at, std::string_view hexadecimal) {
      std::uint8_t number = bytes_of(at)[0];
      for (const std::uint8_t byte : bytes_of(hexadecimal)) chip.set(number++, {byte});
    };
    for (const ChipBytes& one : Bme680::samples[0].bytes)
      if (!one.at.empty()) put(one.at, one.bytes);
    chip.set(0xd0, {0x60});  // a BME280
    std::vector<Bme680Reading> all;
    const auto heard = loop.subscribe<Bme680Reading>("air", [&](const Event<Bme680Reading>& e) { all.push_back(*e); });
    DriverSensor<Bme680> sensor(loop, {.name = "air", .rate = 1_Hz, .retry_longest = 200ms}, bus, {0x77});
    REQUIRE_FALSE(errors.empty());
    CHECK(errors.back().find("cannot use the chip as a BME680 or BME688") != std::string::npos);
    CHECK(errors.back().find("its identity is 0x60, that of a BME680 or BME688 is 0x61") != std::string::npos);
    chip.set(0xd0, {0x61});
    loop.advance(2500ms);
    CHECK(sensor.health() == Health::ok);
    CHECK(chip.get(0xe0) == 0xb6);
    CHECK(chip.get(0x5a) == trimming_of_sample().heater_code(320, 20.91345));
    CHECK(chip.get(0x64) == 0x65);  // 37 times 4 ms
    CHECK(chip.get(0x71) == 0x10);
    CHECK(chip.get(0x72) == 0x01);
    CHECK(chip.get(0x74) == 0x4d);
    REQUIRE_FALSE(all.empty());
    CHECK(all.back().temperature == doctest::Approx(20.91345));
    CHECK(all.back().gas_resistance == doctest::Approx(500244.36));
    std::size_t before = all.size();
    put("1d", "80 00 4b 1d 40 75 c8 40 4d 2c 00 00 00 7f a4 00 00");  // valid, not stable
    loop.advance(1s);
    CHECK(all.size() == before + 1);
    CHECK_FALSE(all.back().gas_resistance);
    CHECK(sensor.status().reason.find("heater has not reached its temperature") != std::string::npos);
    put("1d", "80 00 80 00 00 80 00 00 80 00 00 00 00 7f b4 00 00");
    loop.advance(1s);
    CHECK(sensor.status().reason.find("a measurement was skipped") != std::string::npos);
    put("1d", field_of_bme680);
    loop.advance(1s);
    CHECK(sensor.health() == Health::ok);
    put("1d", "00 00 4b 1d 40 75 c8 40 4d 2c 00 00 00 7f b4 00 00");
    before = all.size();
    loop.advance(1s);
    CHECK(sensor.status().reason.find("the measurement takes too long") != std::string::npos);
    CHECK(all.size() == before);
    put("1d", field_of_bme680);
    chip.unplug();
    loop.advance(10s);
    CHECK(sensor.health() == Health::faulted);
    CHECK(all.size() == before);
    chip.set(0xf0, {0x02});
    chip.plug_in();
    loop.advance(2s);
    CHECK(sensor.status().reason.find("its variant is 0x02") != std::string::npos);
    chip.set(0xf0, {0x01});
    put("1d", "80 00 4b 1d 40 75 c8 40 4d 2c 00 00 00 00 00 7f b4");
    loop.advance(3s);
    CHECK(sensor.health() == Health::ok);
    CHECK(chip.get(0x71) == 0x20);
    REQUIRE(all.size() > before);
    CHECK(all.back().gas_resistance == doctest::Approx(1e6 * (262144 >> 4) / (4096 + 3 * (510 - 512))));
    chip.on_read(0x71, [] { return std::uint8_t{0}; });  // as after a reset
    before = all.size();
    loop.advance(1s);
    CHECK(sensor.status().reason.find("it has lost its settings") != std::string::npos);
    CHECK(all.size() == before);
    put("8a", "00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00");
    chip.unplug();
    loop.advance(10s);
    chip.plug_in();
    loop.advance(2s);
    CHECK(sensor.status().reason.find("its trimming parameters are all 0x00") != std::string::npos);
    CHECK(loop.runtime().balances());
    for (const Bme680::Config& wrong : {Bme680::Config{.heater_temperature = 401},
                                        {.heater_duration = Duration{4033ms}},
                                        {.pressure_oversampling = 3},
                                        {.humidity_oversampling = 32}})
      CHECK_THROWS_AS(DriverSensor<Bme680>(loop, {.name = "b", .rate = 1_Hz}, bus, {0x76}, wrong), SetupError);

    FakeI2cChip& plain = wires->chip(0x76);  // without gas
    for (const ChipBytes& one : Bme680::samples[0].bytes) {
      if (one.at.empty()) continue;
      std::uint8_t number = bytes_of(one.at)[0];
      for (const std::uint8_t byte : bytes_of(one.bytes)) plain.set(number++, {byte});
    }
    std::vector<Bme680Reading> others;
    const auto heard_too = loop.subscribe<Bme680Reading>("hall",
                                                         [&](const Event<Bme680Reading>& e) { others.push_back(*e); });
    DriverSensor<Bme680> hall(loop, {.name = "hall", .rate = 1_Hz}, bus, {0x76}, {.heater_duration = Duration{0}});
    loop.advance(3500ms);
    CHECK(hall.health() == Health::ok);
    CHECK(plain.get(0x71) == 0);
    CHECK(plain.get(0x5a) == 0);
    REQUIRE(others.size() >= 3);
    CHECK_FALSE(others.back().gas_resistance);
    CHECK(hall.counts().unreadable == 0);
    hall.close();
    const DriverSensor<Barometer> mistaken(loop, {.name = "mistaken", .rate = 1_Hz}, bus, {0x76});
    CHECK(errors.back().find("it seems to be a BME680 or BME688: use the type `bme680`") != std::string::npos);
  }
}
