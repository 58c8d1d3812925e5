// Magnetometers: their scales, and chips of all models on a fake bus, which measure as virtual time passes.
#include <doctest/doctest.h>

#include <array>
#include <memory>
#include <string>
#include <vector>

#include "rtdata/app/program.hpp"
#include "rtdata/chips/magnetometer.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/testing/fake_i2c.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

using Bytes = std::vector<std::uint8_t>;

/// A chip of any model: its registers are what was written and what the test says; a sample is new each `period`.
struct FakeMagnetometer {
  FakeMagnetometer(FakeI2cChip& chip, const magnetometer_models::Model& model_, Duration period_)
      : model(model_), period(period_) {
    const ChipIdentity identity = model.chip.identity.value();
    put_code(chip, identity.number, identity.value, identity.size());
    for (unsigned number = 0; number < 0x80; ++number) {
      chip.on_write(static_cast<std::uint8_t>(number), [this, number](std::uint16_t value) {
        registers[number] = static_cast<std::uint8_t>(value);
        writes.push_back(static_cast<std::uint16_t>(number << 8 | value));
      });
    }
    for (const auto& piece : model.pieces) {
      if (piece.count == 0) continue;
      chip.on_read(static_cast<std::uint8_t>(piece.first | model.addressing.i2c_burst_bit),
                   [this, piece, at = std::size_t{0}]() mutable {
                     if (at == 0) measure();
                     const std::size_t number = (piece.first & 0x7f) + at;
                     at = (at + 1) % piece.count;
                     return number_at(number);
                   });
    }
  }
  void measure() {
    if (model.is_new.mask == 0) return;
    const MonotonicTime now = detail::lane_now();
    const std::int64_t number = now.time_since_epoch() / period;
    has_new = is_measuring && number != newest;
    newest = number;
  }
  std::uint8_t number_at(std::size_t number) const {
    const bool is_status = model.is_new.mask != 0 && number == status_register();
    return static_cast<std::uint8_t>(registers[number] | (is_status && has_new ? model.is_new.mask : 0));
  }
  std::size_t status_register() const { return (model.pieces[0].first & 0x7f) + model.is_new.at; }
  void forget() { registers[model.setting_up.back().number] ^= 0x03; }

  const magnetometer_models::Model& model;
  Duration period;
  std::array<std::uint8_t, 256> registers{};
  std::vector<std::uint16_t> writes;
  std::int64_t newest = -1;
  bool has_new = false, is_measuring = true;
};

struct MagnetometerBench {
  explicit MagnetometerBench(MagnetometerModel model, unsigned address, Duration period = 10ms)
      : chip(wires->chip(address)), fake(chip, Magnetometer::Config{.model = model}.chip(), period) {
    be_quiet(loop);
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
    heard = loop.subscribe<MagnetometerReading>(
        "compass", [this](const Event<MagnetometerReading>& event) { readings.push_back(*event); });
  }
  bool told(const char* words) const {
    for (const std::string& error : errors)
      if (error.find(words) != std::string::npos) return true;
    return false;
  }
  std::shared_ptr<FakeI2c> wires = std::make_shared<FakeI2c>();
  I2cBus bus{"i2c1", wires, {.timeout = 200ms}};
  FakeI2cChip& chip;
  FakeMagnetometer fake;
  Loop loop{Loop::Manual{}};
  std::vector<std::string> errors;
  std::vector<MagnetometerReading> readings;
  Subscription heard;
};

/// 16 bytes, of which some are given from a place on.
Bytes reading(std::size_t at, const Bytes& given) {
  Bytes bytes(16);
  std::copy(given.begin(), given.end(), bytes.begin() + static_cast<std::ptrdiff_t>(at));
  return bytes;
}
Errc refused(const Bytes& bytes, const Magnetometer::Config& config) {
  const auto decoded = Magnetometer::decode(bytes, config);
  return decoded ? Errc{} : static_cast<Errc>(decoded.error().code.value());
}

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-15 magnetometers: the data sheets' scales and orders of bytes, in tesla") {
    // LIS3MDL: 6842 counts are a gauss at 4 gauss, 1711 at 16; 8 counts a degree from 25 on.
    const Bytes lis3mdl = reading(8, {0xba, 0x1a, 0x46, 0xe5, 0x00, 0x00, 0xf8, 0xff});
    const auto four = Magnetometer::decode(lis3mdl, {.model = MagnetometerModel::lis3mdl}).or_throw();
    CHECK(four.magnetic_field_x == doctest::Approx(1e-4));
    CHECK(four.magnetic_field_y == doctest::Approx(-1e-4));
    CHECK(four.magnetic_field_z == 0);
    CHECK(four.temperature.value() == doctest::Approx(24));
    auto sixteen = Magnetometer::decode(lis3mdl, {.model = MagnetometerModel::lis3mdl, .field_range = 16});
    CHECK(sixteen.or_throw().magnetic_field_x == doctest::Approx(6842.0 / 1711 * 1e-4));
    // LSM9DS1: 0.14 mgauss a count at 4 gauss, 0.58 at 16; no temperature.
    const Bytes lsm9ds1 = reading(8, {0xe8, 0x03, 0x18, 0xfc, 0x01, 0x00, 0xf8, 0xff});
    const auto lsm = Magnetometer::decode(lsm9ds1, {.model = MagnetometerModel::lsm9ds1}).or_throw();
    CHECK(lsm.magnetic_field_x == doctest::Approx(0.14e-4));
    CHECK(lsm.magnetic_field_y == doctest::Approx(-0.14e-4));
    CHECK(lsm.magnetic_field_z == doctest::Approx(0.14e-7));
    CHECK_FALSE(lsm.temperature);
    // AK8963: 0.15 uT a count, times what the factory found: 128 is 1, 0 is 0.5, 255 almost 1.5.
    const auto factors = Magnetometer::adjustment_of({128, 0, 255});
    CHECK(factors[0] == 1);
    CHECK(factors[1] == 0.5);
    CHECK(factors[2] == doctest::Approx(1.49609375));
    const Magnetometer::Config ak8963{.model = MagnetometerModel::ak8963};
    const Bytes ak = reading(1, {0x64, 0x00, 0x9c, 0xff, 0x10, 0x27, 0x10});
    const auto adjusted = Magnetometer::decode(ak, ak8963, factors).or_throw();
    CHECK(adjusted.magnetic_field_x == doctest::Approx(15e-6));
    CHECK(adjusted.magnetic_field_y == doctest::Approx(-7.5e-6));
    CHECK(adjusted.magnetic_field_z == doctest::Approx(1500e-6 * 1.49609375));
    CHECK(refused(reading(1, {0, 0, 0, 0, 0, 0, 0x18}), ak8963) == Errc::out_of_range);
    // HMC5883L: 1090 counts a gauss at 1.3; X, Z, Y, the high byte first; -4096 is beyond the range.
    const Magnetometer::Config hmc5883l{.model = MagnetometerModel::hmc5883l};
    const auto hmc = Magnetometer::decode(reading(3, {0x04, 0x42, 0xfb, 0xbe, 0x00, 0x6d}), hmc5883l).or_throw();
    CHECK(hmc.magnetic_field_x == doctest::Approx(1e-4));
    CHECK(hmc.magnetic_field_z == doctest::Approx(-1e-4));
    CHECK(hmc.magnetic_field_y == doctest::Approx(0.1e-4));
    CHECK(refused(reading(3, {0, 0, 0xf0, 0x00, 0, 0}), hmc5883l) == Errc::out_of_range);
    // QMC5883L: 12000 counts a gauss at 2, 3000 at 8; a bit for a field beyond the range.
    const Magnetometer::Config qmc5883l{.model = MagnetometerModel::qmc5883l};
    const Bytes qmc = reading(5, {0xe0, 0x2e, 0x20, 0xd1, 0x01, 0x00});
    const auto two = Magnetometer::decode(qmc, qmc5883l).or_throw();
    CHECK(two.magnetic_field_x == doctest::Approx(1e-4));
    CHECK(two.magnetic_field_y == doctest::Approx(-1e-4));
    const auto eight = Magnetometer::decode(qmc, {.model = MagnetometerModel::qmc5883l, .field_range = 8}).or_throw();
    CHECK(eight.magnetic_field_x == doctest::Approx(4e-4));
    Bytes over = qmc;
    over[0] = 0x02;
    CHECK(refused(over, qmc5883l) == Errc::out_of_range);
  }

  TEST_CASE("US-15 a LIS3MDL is set up, brings each sample once, and sleeps at the end") {
    MagnetometerBench bench(MagnetometerModel::lis3mdl, 0x1c, 25ms);
    DriverSensor<Magnetometer> compass(bench.loop, {.name = "compass", .rate = 100_Hz}, bench.bus, Magnetometer::place,
                                       {.sample_rate = 40, .field_range = 8});
    bench.fake.registers[0x28] = 0x5d;  // 3421: a gauss at 8 gauss
    bench.fake.registers[0x29] = 0x0d;
    bench.loop.advance(1s);
    CHECK(bench.errors.empty());
    CHECK(bench.fake.registers[0x20] == 0xf8);  // temperature, best performance, 40 Hz
    CHECK(bench.fake.registers[0x21] == 0x20);
    CHECK(bench.fake.registers[0x22] == 0x00);
    CHECK(bench.fake.registers[0x23] == 0x0c);
    CHECK(bench.fake.registers[0x24] == 0x40);
    CHECK(bench.readings.size() >= 39);
    CHECK(bench.readings.size() <= 41);
    CHECK(bench.readings.back().magnetic_field_x == doctest::Approx(1e-4));
    CHECK(compass.counts().repeated >= 55);
    compass.close();
    bench.loop.advance(10ms);
    CHECK(bench.fake.registers[0x22] == 0x03);
  }

  TEST_CASE("US-15 an AK8963 is adjusted, an HMC5883L and a QMC5883L are set up as their data sheets say") {
    MagnetometerBench ak(MagnetometerModel::ak8963, 0x0c);
    ak.chip.set(0x10, {128, 0, 255});
    ak.fake.registers[0x03] = ak.fake.registers[0x05] = 100;
    DriverSensor<Magnetometer> adjusted(ak.loop, {.name = "compass", .rate = 50_Hz}, ak.bus, {.address = 0x0c},
                                        {.model = MagnetometerModel::ak8963});
    ak.loop.advance(500ms);
    CHECK(ak.errors.empty());
    REQUIRE(ak.readings.size() >= 24);
    CHECK(ak.readings.back().magnetic_field_x == doctest::Approx(15e-6));
    CHECK(ak.readings.back().magnetic_field_y == doctest::Approx(7.5e-6));
    CHECK(ak.fake.registers[0x0a] == 0x16);
    CHECK(ak.fake.writes == std::vector<std::uint16_t>{0x0a0f, 0x0a00, 0x0b01, 0x0a00, 0x0a16});

    MagnetometerBench hmc(MagnetometerModel::hmc5883l, 0x1e);
    DriverSensor<Magnetometer> honeywell(hmc.loop, {.name = "compass", .rate = 50_Hz}, hmc.bus, {.address = 0x1e},
                                         {.model = MagnetometerModel::hmc5883l, .sample_rate = 30});
    hmc.loop.advance(500ms);
    CHECK(hmc.errors.empty());
    CHECK(hmc.readings.size() >= 24);
    CHECK(hmc.fake.writes == std::vector<std::uint16_t>{0x0074, 0x0120, 0x0200});

    MagnetometerBench qmc(MagnetometerModel::qmc5883l, 0x0d);
    DriverSensor<Magnetometer> qst(qmc.loop, {.name = "compass", .rate = 50_Hz}, qmc.bus, {.address = 0x0d},
                                   {.model = MagnetometerModel::qmc5883l, .field_range = 8});
    qmc.loop.advance(500ms);
    CHECK(qmc.errors.empty());
    CHECK(qmc.readings.size() >= 24);
    CHECK(qmc.fake.writes == std::vector<std::uint16_t>{0x0a80, 0x0a00, 0x0b01, 0x091d});
  }

  TEST_CASE("US-15 US-27 a magnetometer that is another chip, loses its settings, stops, is beyond its range: told") {
    for (const auto& chip : {std::pair{MagnetometerModel::lis3mdl, 0x1cu},
                             {MagnetometerModel::ak8963, 0x0cu},
                             {MagnetometerModel::hmc5883l, 0x1eu},
                             {MagnetometerModel::qmc5883l, 0x0du}}) {
      const MagnetometerModel model = chip.first;
      const unsigned address = chip.second;
      CAPTURE(static_cast<int>(model));
      MagnetometerBench bench(model, address);
      DriverSensor<Magnetometer> compass(bench.loop, {.name = "compass", .rate = 50_Hz, .retry_longest = 1s}, bench.bus,
                                         {.address = address}, {.model = model});
      bench.loop.advance(500ms);
      CHECK(bench.errors.empty());
      bench.fake.forget();
      bench.loop.advance(500ms);
      CHECK(bench.told("it has lost its settings"));
      CHECK(compass.counts().unreadable == 1);
      CHECK(compass.health() == Health::ok);
      if (bench.fake.model.is_new.mask != 0) {
        bench.fake.is_measuring = false;
        const std::size_t before = bench.readings.size();
        bench.loop.advance(5s);
        CHECK(bench.readings.size() <= before + 1);
        CHECK(bench.told("it has given no sample for"));
        CHECK(compass.counts().failed >= 5);
        bench.fake.is_measuring = true;
        bench.loop.advance(3s);
        CHECK(compass.health() == Health::ok);
      }
      const std::size_t x = (bench.fake.model.pieces[0].first & 0x7f) + bench.fake.model.axes[0];
      const bool is_in_second = model == MagnetometerModel::qmc5883l;
      bench.fake.registers[is_in_second ? 0 : x] = model == MagnetometerModel::hmc5883l ? 0xf0 : 0xff;
      bench.fake.registers[is_in_second ? 1 : x + 1] = model == MagnetometerModel::hmc5883l ? 0x00 : 0x7f;
      const std::size_t before = bench.readings.size();
      bench.loop.advance(1s);
      CHECK(bench.readings.size() <= before + 1);
      CHECK(bench.told("the field is outside the range of"));
      bench.chip.set(bench.fake.model.chip.identity->number, {0x12});
      compass.stop();
      compass.start();
      bench.loop.advance(1s);
      CHECK(bench.told("its identity is 0x12"));
      CHECK(compass.health() == Health::faulted);
      CHECK(bench.loop.runtime().balances());
    }
  }

  TEST_CASE("US-15 NFR-6 settings that a magnetometer does not have are told with what there is") {
    const auto problems = [](const std::string& members) {
      const std::string text = R"({"buses": {"i2c1": {"type": "i2c", "device": "/dev/i2c-1"}}, "sensors": [
        {"name": "compass", "type": "magnetometer", "rate": "10 Hz", "bus": "i2c1", )" +
                               members + "}]}";
      return plan_system(standard_registry(), parse_config(text, "compass.json")).problems.text();
    };
    CHECK(problems(R"("model": "lis3mdl", "sample_rate": 80, "field_range": 12)") == "");
    CHECK(problems(R"("model": "ak8963", "sample_rate": 80)").find("80 is not one of 8, 100, which the AK8963 has") !=
          std::string::npos);
    CHECK(problems(R"("model": "qmc5883l", "field_range": 4)").find("4 is not one of 2, 8, which the QMC5883L has") !=
          std::string::npos);
    CHECK(Magnetometer::check({.model = MagnetometerModel::hmc5883l, .sample_rate = 100}).error().where ==
          "sample_rate");
  }
}
