// Barometers: their compensation by the data sheets, the standard atmosphere, and each model on a fake bus.
#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "rtdata/app/program.hpp"
#include "rtdata/chips/barometer.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/testing/fake_i2c.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

using BarometerSensor = DriverSensor<Barometer>;

/// The data sheet's worked example (BST-BMP280-DS001, 3.12).
constexpr std::array<std::uint8_t, 24> bmp280_trimming{0x70, 0x6b, 0x43, 0x67, 0x18, 0xfc, 0x7d, 0x8e,
                                                       0x43, 0xd6, 0xd0, 0x0b, 0x27, 0x0b, 0x8c, 0x00,
                                                       0xf9, 0xff, 0x8c, 0x3c, 0xf8, 0xc6, 0x70, 0x17};
constexpr std::array<std::uint8_t, 8> bmp280_data{0x65, 0x5a, 0xc0, 0x7e, 0xed, 0x00, 0x75, 0x30};  // 30000: humidity
/// H1 75, H2 362, H3 0, H4 317, H5 50, H6 30.
constexpr std::array<std::uint8_t, 7> bme280_humidity{0x6a, 0x01, 0x00, 0x13, 0x2d, 0x03, 0x1e};
/// Such as they are, with values computed by hand from 9.1 to 9.3.
constexpr std::array<std::uint8_t, 21> bmp388_trimming{0xd0, 0x6b, 0x92, 0x4a, 0xf9, 0x3e, 0xfe, 0x04, 0xfc, 0x23, 0x00,
                                                       0x7c, 0x60, 0xc0, 0x76, 0xf9, 0xf9, 0x54, 0x24, 0x1e, 0xc4};
constexpr std::array<std::uint8_t, 6> bmp388_data{0x80, 0xc2, 0x67, 0x80, 0x2c, 0x80};
/// Such as they are, of which the data sheet (BST-BMP581-DS004, 4.5) has no example: -10.5 degrees, 100653.25 Pa.
constexpr std::array<std::uint8_t, 6> bmp581_data{0x00, 0x80, 0xf5, 0x50, 0x4b, 0x62};
/// The data sheet's example (MS5611-01BA03, figure 2); the checksum is set by the tests.
Ms5611Prom ms5611_prom() {
  Ms5611Prom prom{{0, 40127, 36924, 23317, 23282, 33464, 28312, 0}};
  prom.words[7] = prom.checksum();
  return prom;
}

template <std::size_t N>
void put(FakeI2cChip& chip, std::uint8_t first, const std::array<std::uint8_t, N>& bytes) {
  for (std::size_t i = 0; i < N; ++i) chip.set(static_cast<std::uint8_t>(first + i), {bytes[i]});
}

void put_bosch(FakeI2cChip& chip, BarometerModel model) {
  const bool is_new = model == BarometerModel::bmp388 || model == BarometerModel::bmp390;
  if (is_new) {
    chip.set(0x00, {static_cast<std::uint8_t>(model == BarometerModel::bmp388 ? 0x50 : 0x60)});
    put(chip, 0x31, bmp388_trimming);
    chip.set(0x03, {0x70});
    put(chip, 0x04, bmp388_data);
  } else {
    chip.set(0xd0, {static_cast<std::uint8_t>(model == BarometerModel::bmp280 ? 0x58 : 0x60)});
    put(chip, 0x88, bmp280_trimming);
    put(chip, 0xf7, bmp280_data);
    if (model == BarometerModel::bme280) {
      chip.set(0xa1, {75});
      put(chip, 0xe1, bme280_humidity);
    }
  }
}

void put_bmp5(FakeI2cChip& chip, BarometerModel model) {
  chip.set(0x01, {static_cast<std::uint8_t>(model == BarometerModel::bmp581 ? 0x50 : 0x51)});
  chip.set(0x27, {0x11, 0x02});  // data is ready, it was reset; its memory is ready
  put(chip, 0x1d, bmp581_data);
}

/// A bus on which the command of the reset is carried out and not acknowledged.
class WithoutAcknowledgement final : public I2cTransport {
 public:
  int transfer(unsigned address, std::span<const std::uint8_t> write, std::span<std::uint8_t> read) noexcept override {
    const int error = fake.transfer(address, write, read);
    return write.size() == 2 && write[0] == 0x7e ? EREMOTEIO : error;
  }
  FakeI2c fake;
};

/// An MS5611: commands of one byte, conversions that take their time, zeros without one.
class FakeMs5611 final : public I2cTransport {
 public:
  int transfer(unsigned address, std::span<const std::uint8_t> write, std::span<std::uint8_t> read) noexcept override {
    const std::lock_guard lock(mutex);
    if (address != 0x77) return ENXIO;
    if (!write.empty()) command = write[0];
    if (write.size() == 1 && read.empty() && command == 0x1e) ++resets, ready_at.reset();
    if (write.size() == 1 && read.empty() && (command & 0xf0) >= 0x40 && (command & 0xf0) <= 0x50) {
      constexpr int microseconds[] = {600, 1170, 2280, 4540, 9040};
      converts = command;
      ready_at = detail::lane_now() + std::chrono::microseconds{microseconds[(command & 15) / 2]};
    }
    if (read.size() == 3 && command == 0) {
      std::uint32_t code = 0;
      if (ready_at && detail::lane_now() >= *ready_at) code = (converts & 0xf0) == 0x40 ? pressure : temperature;
      ready_at.reset();
      for (std::size_t i = 0; i < 3; ++i) read[i] = static_cast<std::uint8_t>(code >> (16 - 8 * i) & 0xff);
    } else if (read.size() == 2 && command >= 0xa0 && command <= 0xae) {
      const std::uint16_t word = prom.words[static_cast<std::size_t>(command - 0xa0) / 2];
      read[0] = static_cast<std::uint8_t>(word >> 8);
      read[1] = static_cast<std::uint8_t>(word & 0xff);
    }
    return 0;
  }
  /// Loses power: what it converts is lost.
  void reset() {
    const std::lock_guard lock(mutex);
    ready_at.reset();
  }
  bool is_converting() {
    const std::lock_guard lock(mutex);
    return ready_at.has_value();
  }
  std::mutex mutex;
  Ms5611Prom prom = ms5611_prom();
  std::uint32_t pressure = 9085466, temperature = 8569150;
  std::uint8_t command = 0, converts = 0;
  std::optional<MonotonicTime> ready_at;
  int resets = 0;
};

struct BarometerBench {
  std::shared_ptr<FakeI2c> wires = std::make_shared<FakeI2c>();
  I2cBus bus{"i2c1", wires, {.timeout = 200ms}};
  Loop loop{Loop::Manual{}};
  std::vector<std::string> errors;
  std::vector<BarometerReading> readings;
  Subscription heard;
  BarometerBench() {
    be_quiet(loop);
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
    heard = loop.subscribe<BarometerReading>("air",
                                             [this](const Event<BarometerReading>& e) { readings.push_back(*e); });
  }
};

/// Relative humidity by the data sheet's integers (BST-BME280-DS002, 4.2.3): another formula for the same.
double humidity_by_integers(std::int32_t code, std::int32_t fine, const Bmp280Trimming& c) {
  std::int32_t v = fine - 76800;
  v = ((((code << 14) - (c.h4 << 20) - (c.h5 * v)) + 16384) >> 15) *
      (((((((v * c.h6) >> 10) * (((v * c.h3) >> 11) + 32768)) >> 10) + 2097152) * c.h2 + 8192) >> 14);
  v -= ((((v >> 15) * (v >> 15)) >> 7) * c.h1) >> 4;
  return std::clamp(v, 0, 419430400) / 4096 / 1024.0;
}

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-12 BMP280: the data sheet's worked example") {
    const auto trimming = Bmp280Trimming::decode(bmp280_trimming);
    const auto all = std::span(bmp280_data);
    const AirMeasurement air = trimming.measurement(all.first(6)).or_throw();
    CHECK(air.temperature == doctest::Approx(25.08).epsilon(0.0002));
    CHECK(air.pressure == doctest::Approx(100653.27).epsilon(1e-7));
    CHECK(!air.humidity);
    const std::array<std::uint8_t, 6> skipped{0x80, 0, 0, 0x80, 0, 0};  // as after a reset
    CHECK(trimming.measurement(skipped).error().code == Errc::bad_data);
  }

  TEST_CASE("US-12 BME280: pressure as the BMP280, humidity as by the data sheet's integer formula") {
    auto trimming = Bmp280Trimming::decode(bmp280_trimming);
    trimming.decode_humidity(75, bme280_humidity);
    CHECK(trimming.h2 == 362);
    CHECK(trimming.h4 == 317);
    CHECK(trimming.h5 == 50);
    CHECK(trimming.h6 == 30);
    auto data = bmp280_data;
    for (const int code : {22000, 25000, 30000, 35000, 40000}) {
      CAPTURE(code);
      data[6] = static_cast<std::uint8_t>(code >> 8);
      data[7] = static_cast<std::uint8_t>(code & 0xff);
      const AirMeasurement air = trimming.measurement(data).or_throw();
      CHECK(air.pressure == doctest::Approx(100653.27).epsilon(1e-7));
      REQUIRE(air.humidity.has_value());
      CHECK(*air.humidity == doctest::Approx(humidity_by_integers(code, 128422, trimming)).epsilon(1e-3));
    }
    // The registers of H4 and H5 hold signs: 0xfff is -1.
    trimming.decode_humidity(75, std::array<std::uint8_t, 7>{0x6a, 0x01, 0x00, 0xff, 0xff, 0xff, 0xff});
    CHECK(trimming.h4 == -1);
    CHECK(trimming.h5 == -1);
    CHECK(trimming.h6 == -1);
    data[6] = 0x80;
    data[7] = 0;
    CHECK(trimming.measurement(data).error().why == "the measurement of humidity was skipped");
  }

  TEST_CASE("US-12 BMP388, BMP390: scales and compensation as computed by hand") {
    const auto trimming = Bmp388Trimming::decode(bmp388_trimming);
    CHECK(trimming.t1 == 27600 * 256.0);
    CHECK(trimming.p1 == (-450 - 16384) / 1048576.0);
    CHECK(trimming.p11 * 36893488147419103232.0 == -60);  // 2^65
    const AirMeasurement air = trimming.measurement(bmp388_data).or_throw();
    CHECK(air.temperature == doctest::Approx(23.67994582891697).epsilon(1e-12));
    CHECK(air.pressure == doctest::Approx(95605.77574240106).epsilon(1e-12));
    const std::array<std::uint8_t, 6> skipped{0, 0, 0x80, 0, 0, 0x80};
    CHECK(trimming.measurement(skipped).error().code == Errc::bad_data);
  }

  TEST_CASE("US-12 BMP581: pressure in 1/64 Pa, temperature with a sign in 1/65536 degrees; a skipped measurement") {
    const AirMeasurement air = bmp581_measurement(bmp581_data).or_throw();
    CHECK(air.pressure == 100653.25);
    CHECK(air.temperature == -10.5);
    CHECK(!air.humidity);
    const std::array<std::uint8_t, 6> warm{0x01, 0x00, 0x19, 0xff, 0xff, 0xff};
    CHECK(bmp581_measurement(warm).or_throw().temperature == 25 + 1 / 65536.0);
    CHECK(bmp581_measurement(warm).or_throw().pressure == 262144 - 1 / 64.0);
    auto skipped = bmp581_data;  // without `press_en`: the pressure alone
    std::fill(skipped.begin() + 3, skipped.end(), std::uint8_t{0x7f});
    CHECK(bmp581_measurement(skipped).error().code == Errc::bad_data);
    skipped.fill(0x7f);  // as after a reset
    CHECK(bmp581_measurement(skipped).error().code == Errc::bad_data);
  }

  TEST_CASE("US-12 BMP581, BMP585: measured at each tick, with the settings of the configuration") {
    for (const BarometerModel model : {BarometerModel::bmp581, BarometerModel::bmp585}) {
      CAPTURE(static_cast<int>(model));
      BarometerBench bench;
      FakeI2cChip& chip = bench.wires->chip(0x47);
      put_bmp5(chip, model);
      int resets = 0;
      chip.on_write(0x7e, [&](std::uint16_t value) { resets += value == 0xb6; });
      BarometerSensor air(bench.loop, {.name = "air", .rate = 5_Hz}, bench.bus, {.address = 0x47},
                          {.model = model,
                           .pressure_oversampling = 128,
                           .temperature_oversampling = 8,
                           .reference_pressure = 100653.25});
      bench.loop.advance(1s);
      CHECK(resets == 1);
      CHECK(bench.errors.empty());
      REQUIRE(bench.readings.size() >= 4);
      CHECK(bench.readings.back().pressure == 100653.25);
      CHECK(bench.readings.back().temperature == -10.5);
      CHECK(bench.readings.back().altitude == doctest::Approx(0).epsilon(0.01));
      CHECK(!bench.readings.back().humidity);
      CHECK(chip.get(0x15) == 1);
      CHECK(chip.get(0x36) == (0x40 | 7 << 3 | 3));
      CHECK(chip.get(0x37) == 0xf2);
      CHECK(air.counts().published == bench.readings.size());
      CHECK(bench.loop.runtime().balances());
    }
    // Each is longer than the data sheet's time of a whole measurement (table 9): 2.7, 12.5, 23.3 and 88 ms.
    const auto time = [](unsigned pressure, unsigned temperature) {
      return Barometer({.model = BarometerModel::bmp581,
                        .pressure_oversampling = pressure,
                        .temperature_oversampling = temperature})
          .conversion_time();
    };
    CHECK(time(1, 1) == 4600us);
    CHECK(time(16, 1) == 14470us);
    CHECK(time(32, 2) == 25075us);
    CHECK(time(128, 8) == 89125us);
  }

  TEST_CASE("US-27 BMP581: lost settings, no data, a bad memory, no reset, another chip; no answer to the reset") {
    BarometerBench bench;
    FakeI2cChip& chip = bench.wires->chip(0x46);
    put_bmp5(chip, BarometerModel::bmp581);
    const Barometer::Config config{.model = BarometerModel::bmp581, .pressure_oversampling = 128};
    BarometerSensor air(bench.loop, {.name = "air", .rate = 10_Hz, .faulted_after = 10}, bench.bus, {.address = 0x46},
                        config);
    bench.loop.advance(301ms);  // a measurement is under way
    const auto published = air.counts().published;
    chip.set(0x36, {0x00, 0x70});  // it was reset
    bench.loop.advance(99ms);
    CHECK(air.counts().unreadable == 1);
    CHECK(air.counts().published == published);
    REQUIRE(!bench.errors.empty());
    CHECK(bench.errors.back().find("it has lost its settings since the start") != std::string::npos);
    bench.loop.advance(200ms);
    CHECK(air.counts().unreadable == 1);
    CHECK(air.health() == Health::ok);
    chip.set(0x1d, {0x7f, 0x7f, 0x7f, 0x7f, 0x7f, 0x7f});
    bench.loop.advance(200ms);
    CHECK(air.status().reason.find("the measurement was skipped") != std::string::npos);
    chip.set(0x27, {0x10});
    bench.loop.advance(200ms);
    CHECK(air.status().reason.find("the measurement takes too long") != std::string::npos);
    put_bmp5(chip, BarometerModel::bmp581);
    bench.loop.advance(500ms);
    CHECK(air.health() == Health::ok);
    CHECK(bench.loop.runtime().balances());

    const auto reason = [&](std::initializer_list<std::uint8_t> status, BarometerModel there) {
      FakeI2cChip& other = bench.wires->chip(0x47);
      put_bmp5(other, there);
      other.set(0x27, status);
      const BarometerSensor refused(bench.loop, {.name = "other", .rate = 1_Hz}, bench.bus, {.address = 0x47}, config);
      CHECK(refused.health() == Health::faulted);
      return refused.status().reason;
    };
    CHECK(reason({0x10, 0x06}, BarometerModel::bmp581).find("its memory has an error") != std::string::npos);
    CHECK(reason({0x10, 0x00}, BarometerModel::bmp581).find("its memory has an error") != std::string::npos);
    CHECK(reason({0x01, 0x02}, BarometerModel::bmp581).find("it does not reset") != std::string::npos);
    CHECK(reason({0x11, 0x02}, BarometerModel::bmp585).find("it seems to be a BMP585: set `model`") !=
          std::string::npos);

    const auto wires = std::make_shared<WithoutAcknowledgement>();
    put_bmp5(wires->fake.chip(0x46), BarometerModel::bmp581);
    I2cBus bus("i2c2", wires, {.timeout = 200ms});
    BarometerSensor one(bench.loop, {.name = "one", .rate = 10_Hz}, bus, {.address = 0x46}, config);
    bench.loop.advance(1s);
    CHECK(one.health() == Health::ok);
    CHECK(one.counts().published >= 8);
  }

  TEST_CASE("US-12 MS5611: the data sheet's worked example, the cold, and the checksum of AN520") {
    const Ms5611Prom prom = ms5611_prom();
    const AirMeasurement air = prom.measurement(9085466, 8569150).or_throw();
    CHECK(air.temperature == doctest::Approx(20.07).epsilon(0.0005));
    CHECK(air.pressure == doctest::Approx(100009).epsilon(1e-5));
    CHECK(prom.measurement(0, 8569150).error().code == Errc::bad_data);
    CHECK(prom.measurement(9085466, 0).error().code == Errc::bad_data);
    // Figure 3 by hand: dT = 7400000 - 8566784 = -1166784, TEMP = -1937.98..., below -15 degrees.
    const AirMeasurement cold = prom.measurement(9085466, 7400000).or_throw();
    const double dt = -1166784, temp = 2000 + dt * 28312 / 8388608;
    const double t2 = dt * dt / 2147483648.0;
    const double off2 = 5 * (temp - 2000) * (temp - 2000) / 2 + 7 * (temp + 1500) * (temp + 1500);
    const double sens2 = 5 * (temp - 2000) * (temp - 2000) / 4 + 11 * (temp + 1500) * (temp + 1500) / 2;
    const double off = 36924 * 65536.0 + 23282 * dt / 128 - off2, sens = 40127 * 32768.0 + 23317 * dt / 256 - sens2;
    CHECK(cold.temperature == doctest::Approx((temp - t2) / 100).epsilon(1e-9));
    CHECK(cold.pressure == doctest::Approx((9085466 * sens / 2097152 - off) / 32768).epsilon(1e-9));
    CHECK(cold.temperature < -20);

    const Ms5611Prom example{{0x3132, 0x3334, 0x3536, 0x3738, 0x3940, 0x4142, 0x4344, 0x4500}};
    CHECK(example.checksum() == 0xb);
    CHECK(prom.is_usable());
    for (std::size_t word = 0; word < 8; ++word) {
      for (int bit = 0; bit < 16; ++bit) {
        if (word == 7 && bit >= 4 && bit < 8) continue;  // which it does not cover
        Ms5611Prom wrong = prom;
        wrong.words[word] = static_cast<std::uint16_t>(wrong.words[word] ^ 1 << bit);
        CHECK(!wrong.is_usable());
      }
    }
    CHECK(!Ms5611Prom{}.is_usable());
  }

  TEST_CASE("US-12 altitude: the published values of the standard atmosphere, from below the sea to 71 km") {
    // US Standard Atmosphere 1976, table of the layers: pressure in Pa at its geopotential height.
    struct Point {
      double height, pressure, tolerance;
    };
    for (const Point& at : {Point{0, 101325, 0.01},
                            {11000, 22632.10, 0.1},
                            {20000, 5474.89, 0.1},
                            {32000, 868.02, 0.2},
                            {47000, 110.91, 0.5},
                            {51000, 66.94, 0.5},
                            {71000, 3.96, 7}})
      CHECK(std::abs(pressure_altitude(at.pressure) - at.height) <= at.tolerance);
    // Pressure surfaces, in feet.
    for (const Point& at : {Point{4780, 85000, 2},
                            {9882, 70000, 2},
                            {18287, 50000, 3},
                            {30066, 30000, 3},
                            {38661, 20000, 3},
                            {53084, 10000, 3},
                            {67507, 5000, 3}})
      CHECK(std::abs(pressure_altitude(at.pressure) / 0.3048 - at.height) <= at.tolerance);
    CHECK(pressure_altitude(113929.09) == doctest::Approx(-1000).epsilon(1e-5));
    CHECK(pressure_altitude(12044.55) == doctest::Approx(15000).epsilon(1e-6));
    CHECK(std::isnan(pressure_altitude(0)));
    CHECK(std::isnan(pressure_altitude(-1)));
    double before = 1e9;  // it has no step where layers meet
    for (double pressure = 1; pressure < 110000; pressure *= 1.001) {
      const double height = pressure_altitude(pressure);
      CHECK(height < before);
      if (before < 1e8) CHECK(before - height < 10);
      before = height;
    }
    const BarometerReading pad = Barometer::reading({89874.56, 15, {}}, 89874.56).or_throw();
    CHECK(pad.altitude == doctest::Approx(0));
    CHECK(Barometer::reading({79495.2, 15, {}}, 89874.56).or_throw().altitude == doctest::Approx(1000).epsilon(1e-4));
    for (const double none : {0.0, -5.0, 1e6, std::nan("")})
      CHECK(Barometer::reading({none, 15, {}}, 101325).error().code == Errc::out_of_range);
  }

  TEST_CASE("US-12 BMP280, BME280, BMP388, BMP390: measured at each tick, with the settings of the configuration") {
    for (const BarometerModel model :
         {BarometerModel::bmp280, BarometerModel::bme280, BarometerModel::bmp388, BarometerModel::bmp390}) {
      CAPTURE(static_cast<int>(model));
      const bool is_new = model == BarometerModel::bmp388 || model == BarometerModel::bmp390;
      BarometerBench bench;
      FakeI2cChip& chip = bench.wires->chip(0x76);
      put_bosch(chip, model);
      int resets = 0;
      chip.on_write(is_new ? 0x7e : 0xe0, [&](std::uint16_t value) { resets += value == 0xb6; });
      BarometerSensor air(bench.loop, {.name = "air", .rate = 5_Hz}, bench.bus, Barometer::place,
                          {.model = model,
                           .pressure_oversampling = 16,
                           .temperature_oversampling = 2,
                           .reference_pressure = is_new ? 95605.776 : 100653.27});
      bench.loop.advance(1s);
      CHECK(resets == 1);
      CHECK(bench.errors.empty());
      REQUIRE(bench.readings.size() >= 4);
      const BarometerReading& reading = bench.readings.back();
      CHECK(reading.pressure == doctest::Approx(is_new ? 95605.776 : 100653.27).epsilon(1e-7));
      CHECK(reading.altitude == doctest::Approx(0).epsilon(0.01));
      CHECK(reading.humidity.has_value() == (model == BarometerModel::bme280));
      if (is_new) {
        CHECK(chip.get(0x1c) == (1 << 3 | 4));
        CHECK(chip.get(0x1b) == 0x13);
      } else {
        CHECK(chip.get(0xf4) == (2 << 5 | 5 << 2 | 1));
        CHECK(chip.get(0xf2) == (model == BarometerModel::bme280 ? 1 : 0));
      }
      CHECK(air.counts().published == bench.readings.size());
      CHECK(bench.loop.runtime().balances());
    }
  }

  TEST_CASE("US-27 a barometer that loses its settings in the middle, or skips a measurement, is told and goes on") {
    for (const BarometerModel model : {BarometerModel::bmp280, BarometerModel::bme280, BarometerModel::bmp388}) {
      CAPTURE(static_cast<int>(model));
      const bool is_new = model == BarometerModel::bmp388;
      BarometerBench bench;
      FakeI2cChip& chip = bench.wires->chip(0x76);
      put_bosch(chip, model);
      BarometerSensor air(bench.loop, {.name = "air", .rate = 10_Hz, .faulted_after = 10}, bench.bus, Barometer::place,
                          {.model = model, .pressure_oversampling = 8});
      bench.loop.advance(301ms);  // a measurement is under way
      const auto published = air.counts().published;
      chip.set(is_new ? 0x1b : 0xf4, {0});
      bench.loop.advance(99ms);
      CHECK(air.counts().unreadable == 1);
      CHECK(air.counts().published == published);
      REQUIRE(!bench.errors.empty());
      CHECK(bench.errors.back().find("it has lost its settings since the start") != std::string::npos);
      bench.loop.advance(200ms);
      CHECK(air.counts().unreadable == 1);
      CHECK(air.health() == Health::ok);
      if (model == BarometerModel::bme280) {  // of humidity alone
        chip.set(0xf2, {0});
        bench.loop.advance(1ms);
        chip.on_write(0xf4, [](std::uint16_t) {});
        bench.loop.advance(1s);
        CHECK(air.health() == Health::ok);
      }
      const auto good = air.counts().unreadable;
      if (is_new) {
        put(chip, 0x04, std::array<std::uint8_t, 6>{0, 0, 0x80, 0, 0, 0x80});
      } else {
        put(chip, 0xf7, std::array<std::uint8_t, 6>{0x80, 0, 0, 0x80, 0, 0});
      }
      bench.loop.advance(200ms);
      CHECK(air.counts().unreadable > good);
      CHECK(air.status().reason.find("the measurement was skipped") != std::string::npos);
      put_bosch(chip, model);
      bench.loop.advance(500ms);
      CHECK(air.health() == Health::ok);
      if (is_new) {
        chip.set(0x03, {0x10});  // no data is ready
        bench.loop.advance(200ms);
        CHECK(air.status().reason.find("the measurement takes too long") != std::string::npos);
      }
      CHECK(bench.loop.runtime().balances());
    }
  }

  TEST_CASE("US-27 trimming parameters of zeros or ones, and another barometer at the address, are refused") {
    for (const std::uint8_t all : {std::uint8_t{0x00}, std::uint8_t{0xff}}) {
      for (const BarometerModel model : {BarometerModel::bmp280, BarometerModel::bmp388}) {
        BarometerBench bench;
        FakeI2cChip& chip = bench.wires->chip(0x76);
        put_bosch(chip, model);
        std::array<std::uint8_t, 24> none;
        none.fill(all);
        if (model == BarometerModel::bmp280) {
          put(chip, 0x88, none);
        } else {
          put(chip, 0x31, none);
        }
        BarometerSensor air(bench.loop, {.name = "air", .rate = 10_Hz}, bench.bus, Barometer::place, {.model = model});
        CHECK(air.health() == Health::faulted);
        CHECK(air.status().reason.find(all == 0 ? "its trimming parameters are all 0x00"
                                                : "its trimming parameters are all 0xff") != std::string::npos);
      }
    }
    struct Mix {
      BarometerModel there, wanted;
      const char* words;
    };
    for (const Mix& mix : {Mix{BarometerModel::bme280, BarometerModel::bmp280, "it seems to be a BME280: set `model`"},
                           {BarometerModel::bmp280, BarometerModel::bmp390, "it seems to be a BMP280: set `model`"},
                           {BarometerModel::bmp390, BarometerModel::bmp388, "it seems to be a BMP390: set `model`"},
                           {BarometerModel::bmp388, BarometerModel::bme280, "it seems to be a BMP388: set `model`"},
                           {BarometerModel::bmp280, BarometerModel::ms5611, "it seems to be a BMP280: set `model`"}}) {
      BarometerBench bench;
      put_bosch(bench.wires->chip(0x76), mix.there);
      BarometerSensor air(bench.loop, {.name = "air", .rate = 10_Hz}, bench.bus, Barometer::place,
                          {.model = mix.wanted});
      CHECK(air.health() == Health::faulted);
      CHECK_MESSAGE(air.status().reason.find(mix.words) != std::string::npos, air.status().reason);
    }
    BarometerBench bench;
    bench.wires->chip(0x76).set(0xd0, {0x55});
    BarometerSensor air(bench.loop, {.name = "air", .rate = 10_Hz}, bench.bus);
    CHECK(air.status().reason.find("it seems to be a BMP180, which has no driver here") != std::string::npos);
  }

  TEST_CASE("US-12 US-27 MS5611: two conversions at each tick; a reset meanwhile is unreadable, a bad PROM refused") {
    for (const unsigned oversampling : {256u, 1024u, 4096u}) {
      CAPTURE(oversampling);
      auto wires = std::make_shared<FakeMs5611>();
      I2cBus bus("i2c1", wires, {.timeout = 100ms});
      Loop loop{Loop::Manual{}};
      be_quiet(loop);
      std::vector<std::string> errors;
      loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
      std::vector<BarometerReading> readings;
      const auto heard = loop.subscribe<BarometerReading>(
          "air", [&](const Event<BarometerReading>& event) { readings.push_back(*event); });
      BarometerSensor air(loop, {.name = "air", .rate = 20_Hz, .faulted_after = 5, .retry_first = 10ms}, bus, {0x77},
                          {.model = BarometerModel::ms5611,
                           .pressure_oversampling = oversampling,
                           .temperature_oversampling = oversampling});
      loop.advance(500ms);
      CHECK(wires->resets == 1);
      CHECK(errors.empty());
      REQUIRE(readings.size() >= 9);
      CHECK(readings.back().pressure == doctest::Approx(100009).epsilon(1e-5));
      CHECK(readings.back().temperature == doctest::Approx(20.07).epsilon(1e-3));
      CHECK(!readings.back().humidity);
      while (!wires->is_converting()) loop.advance(100us);
      wires->reset();
      loop.advance(45ms);
      CHECK(air.counts().unreadable == 1);
      REQUIRE(!errors.empty());
      CHECK(errors.back().find("it has no measurement: check its supply: it was reset in the meantime") !=
            std::string::npos);
      loop.advance(500ms);
      CHECK(air.health() == Health::ok);
      CHECK(air.counts().unreadable == 1);
      CHECK(loop.runtime().balances());
    }
    for (const bool is_zero : {false, true}) {
      auto wires = std::make_shared<FakeMs5611>();
      I2cBus bus("i2c1", wires, {.timeout = 100ms});
      Loop loop{Loop::Manual{}};
      be_quiet(loop);
      loop.on_error([](const ErrorReport&) {});
      if (is_zero) {
        wires->prom = {};
      } else {
        wires->prom.words[3] ^= 1;
      }
      BarometerSensor air(loop, {.name = "air", .rate = 20_Hz}, bus, {0x77}, {.model = BarometerModel::ms5611});
      CHECK(air.health() == Health::faulted);
      CHECK(air.status().reason.find(is_zero ? "all words of its PROM are the same"
                                             : "the checksum of its PROM is wrong") != std::string::npos);
    }
  }

  TEST_CASE("US-12 NFR-6 a barometer's oversampling is its model's") {
    const auto problems = [&](const std::string& more) {
      return plan_system(standard_registry(),
                         parse_config(R"({"buses": {"i2c1": {"type": "i2c", "device": "/dev/i2c-9"}}, "sensors": [
            {"name": "b", "type": "barometer", "rate": "1 Hz", "bus": "i2c1", )" +
                                          more + "}]}",
                                      "f.json"))
          .problems.text();
    };
    CHECK(problems(R"("model": "ms5611", "pressure_oversampling": 4096)") == "");
    CHECK(problems(R"("model": "bmp390", "pressure_oversampling": 32)") == "");
    CHECK(problems(R"("model": "bmp581", "pressure_oversampling": 128, "temperature_oversampling": 8)") == "");
    CHECK(problems(R"("model": "bmp280", "pressure_oversampling": 32)")
              .find("32 is not one of 1, 2, 4, 8, 16, which the BMP280 has") != std::string::npos);
    CHECK(problems(R"("model": "ms5611", "temperature_oversampling": 16)")
              .find("16 is not one of 256, 512, 1024, 2048, 4096, which the MS5611 has") != std::string::npos);
    CHECK(problems(R"("reference_pressure": 0)").find("reference_pressure") != std::string::npos);
    BarometerBench bench;
    CHECK_THROWS_AS(BarometerSensor(bench.loop, {.name = "b", .rate = 1_Hz}, bench.bus, Barometer::place,
                                    {.model = BarometerModel::bme280, .humidity_oversampling = 3}),
                    SetupError);
  }
}
