// Drivers on buses: the chips that are shipped, by their data sheets and on a fake bus; and what all drivers inherit.
#include <doctest/doctest.h>

#include <array>
#include <cerrno>
#include <set>
#include <string>
#include <vector>

#include "rtdata/app/program.hpp"
#include "rtdata/chips/barometer.hpp"
#include "rtdata/chips/ina.hpp"
#include "rtdata/chips/lm75.hpp"
#include "rtdata/chips/sht.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/recording/verify.hpp"
#include "rtdata/testing/fake_i2c.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

/// The data sheet's worked example (BST-BMP280-DS001, 3.12).
void put_example(FakeI2cChip& chip) {
  chip.set(0xd0, {0x58});
  std::array<int, 12> trimming{27504, 26435, -1000, 36477, -10685, 3024, 2855, 140, -7, 15500, -14600, 6000};
  for (std::size_t i = 0; i < trimming.size(); ++i) {
    const auto word = static_cast<std::uint16_t>(trimming[i]);
    chip.set(static_cast<std::uint8_t>(0x88 + 2 * i),
             {static_cast<std::uint8_t>(word & 0xff), static_cast<std::uint8_t>(word >> 8)});
  }
  constexpr unsigned pressure = 415148, temperature = 519888;
  const auto part = [](unsigned code, unsigned shift) { return static_cast<std::uint8_t>(code << 4 >> shift & 0xff); };
  chip.set(0xf7, {part(pressure, 16), part(pressure, 8), part(pressure, 0), part(temperature, 16), part(temperature, 8),
                  part(temperature, 0)});
}

FakeI2cChip& put_lm75(FakeI2c& wires, unsigned address, double degrees) {
  FakeI2cChip& chip = wires.chip(address);
  chip.set_width(FakeI2cChip::Width::words);
  chip.set_word(0, static_cast<std::uint16_t>(static_cast<std::int16_t>(degrees * 256)));
  return chip;
}

/// It has no open(), and needs some time for a conversion.
class Converting {
 public:
  using Config = NoParameters;
  using Value = TemperatureReading;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x4a};
  explicit Converting(const Config&) {}
  Result<void> start(I2cDevice&) { return {}; }
  Duration conversion_time() const { return 50ms; }
  Result<TemperatureReading> read(I2cDevice&) { return TemperatureReading{20}; }
};

struct DriverBench {
  std::shared_ptr<FakeI2c> wires = std::make_shared<FakeI2c>();
  I2cBus bus{"i2c1", wires, {.timeout = 100ms}};
  Loop loop{Loop::Manual{}};
  std::vector<std::string> errors;
  DriverBench() {
    be_quiet(loop);
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
  }
};

/// A converter that needs as long as there is between two ticks at 125 Hz.
struct SlowCode {
  double code = 0;
  friend constexpr auto describe(type_tag<SlowCode>) { return record("slow_code", field("code", &SlowCode::code)); }
};
class SlowAdc {
 public:
  struct Config {};
  using Value = SlowCode;
  using Device = I2cDevice;
  explicit SlowAdc(const Config&) {}
  Result<void> start(Device& chip) { return chip.write_register(1, 1); }
  Duration conversion_time() const { return 8ms; }
  Result<SlowCode> read(Device& chip) {
    const auto code = chip.read_word(0);
    if (!code) return code.error();
    return SlowCode{static_cast<double>(*code)};
  }
};

using BarometerSensor = DriverSensor<Barometer>;
using Thermometer = DriverSensor<Lm75>;

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE(
      "US-11 a bus that gives up before the chip is ready, and a setting that the chip does not have, are refused") {
    DriverBench bench;
    const auto refusal = [&](Duration timeout, Barometer::Config config) -> std::string {
      I2cBus bus("quick", bench.wires, {.timeout = timeout});
      try {
        const BarometerSensor made(bench.loop, {.name = "air", .rate = 1_Hz}, bus, {0x76}, config);
      } catch (const SetupError& error) {
        return error.what();
      }
      return "";
    };
    CHECK(refusal(2ms, {}).find("gives up after 2 ms, and this chip needs more than 3 ms at a time") !=
          std::string::npos);
    CHECK(refusal(100ms, {}).empty());
    CHECK(refusal(100ms, {.humidity_oversampling = 2}).find("the BMP280 measures no humidity") != std::string::npos);
    // One reading is the opening of a driver that has none of its own: it waits for the conversion.
    I2cBus quick("quick", bench.wires, {.timeout = 40ms});
    CHECK_THROWS_AS((DriverSensor<Converting>(bench.loop, {.name = "room", .rate = 1_Hz}, quick)), SetupError);
    CHECK(DriverSensor<Converting>(bench.loop, {.name = "room", .rate = 1_Hz}, bench.bus).is_open());
  }

  TEST_CASE("US-12 LM75: the data sheet's table of temperatures") {
    CHECK(Lm75::decode(0x7d00) == 125);
    CHECK(Lm75::decode(0x1900) == 25);
    CHECK(Lm75::decode(0x0080) == 0.5);
    CHECK(Lm75::decode(0x0000) == 0);
    CHECK(Lm75::decode(0xff80) == -0.5);
    CHECK(Lm75::decode(0xe700) == -25);
    CHECK(Lm75::decode(0xc900) == -55);
  }

  TEST_CASE("US-12 SHT3x, SHT4x: checksums, and the ends and the middle of their ranges") {
    const std::array<std::uint8_t, 2> example{0xbe, 0xef};  // data sheet, 4.12
    CHECK(Sht::checksum(example) == 0x92);
    const auto bytes = [](unsigned temperature, unsigned humidity) {
      std::array<std::uint8_t, 6> all{};
      const unsigned words[] = {temperature, humidity};
      for (std::size_t i = 0; i < 2; ++i) {
        const std::array<std::uint8_t, 2> word{static_cast<std::uint8_t>(words[i] >> 8),
                                               static_cast<std::uint8_t>(words[i] & 0xff)};
        all[3 * i] = word[0];
        all[3 * i + 1] = word[1];
        all[3 * i + 2] = Sht::checksum(word);
      }
      return all;
    };
    CHECK(Sht::decode(bytes(0, 0), ShtModel::sht3x).or_throw().temperature == doctest::Approx(-45));
    CHECK(Sht::decode(bytes(65535, 65535), ShtModel::sht3x).or_throw().temperature == doctest::Approx(130));
    CHECK(Sht::decode(bytes(26214, 32768), ShtModel::sht3x).or_throw().temperature == doctest::Approx(25));
    CHECK(Sht::decode(bytes(26214, 32768), ShtModel::sht3x).or_throw().humidity == doctest::Approx(50).epsilon(1e-4));
    CHECK(Sht::decode(bytes(0, 32768), ShtModel::sht4x).or_throw().humidity == doctest::Approx(56.5).epsilon(1e-4));
    CHECK(Sht::decode(bytes(0, 0), ShtModel::sht4x).or_throw().humidity == 0);
    CHECK(Sht::decode(bytes(0, 65535), ShtModel::sht4x).or_throw().humidity == 100);
    const auto good = bytes(0x1234, 0x5678);
    for (std::size_t byte = 0; byte < 6; ++byte) {
      for (int bit = 0; bit < 8; ++bit) {
        auto wrong = good;
        wrong[byte] = static_cast<std::uint8_t>(wrong[byte] ^ 1 << bit);
        CHECK(Sht::decode(wrong, ShtModel::sht3x).error().code == Errc::bad_data);
      }
    }
  }

  TEST_CASE("US-12 an SHT3x is started, waited for, read; one with wrong checksums is unreadable") {
    DriverBench bench;
    FakeI2cChip& chip = bench.wires->chip(0x44);
    const std::array<std::uint8_t, 2> word{0x66, 0x66};  // 25 degrees, 40 %
    chip.set(0x25, {0x66, 0x66, Sht::checksum(word), 0x66, 0x66, Sht::checksum(word)});
    const std::array<std::uint8_t, 2> status{0x80, 0x10};
    chip.set(0xf4, {status[0], status[1], 0x77});  // as another chip
    int started = 0;
    chip.on_write(0x24, [&](std::uint16_t value) { started += value == 0; });
    DriverSensor<Sht> room(bench.loop, {.name = "room", .rate = 10_Hz}, bench.bus);
    CHECK(room.health() == Health::faulted);
    CHECK(bench.errors.back().find("the answer with its identity has a wrong checksum") != std::string::npos);
    chip.set(0xf6, {Sht::checksum(status)});
    bench.loop.advance(100ms);
    started = 0;
    std::vector<HumidityReading> all;
    const auto heard = bench.loop.subscribe<HumidityReading>(
        "room", [&](const Event<HumidityReading>& e) { all.push_back(*e); });
    bench.loop.advance(950ms);
    CHECK(started == 10);
    REQUIRE(all.size() >= 9);
    CHECK(all[0].temperature == doctest::Approx(25));
    CHECK(all[0].humidity == doctest::Approx(40));
    chip.set(0x27, {0});
    bench.loop.advance(1s);
    CHECK(room.counts().unreadable > 0);
    CHECK(room.status().reason.find("a checksum is wrong") != std::string::npos);
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("US-12 US-27 an SHT4x, taken for an SHT3x, then as it is; unplugged and plugged in again") {
    DriverBench bench;
    FakeI2cChip& chip = bench.wires->chip(0x44);
    const std::array<std::uint8_t, 2> serial{0x12, 0x34}, temperature{0x66, 0x66}, humidity{0x72, 0xb0};
    chip.set(0x89, {serial[0], serial[1], Sht::checksum(serial)});
    chip.set(0xfd, {temperature[0], temperature[1], Sht::checksum(temperature), humidity[0], humidity[1],
                    Sht::checksum(humidity)});
    {
      DriverSensor<Sht> wrong(bench.loop, {.name = "wrong", .rate = 10_Hz}, bench.bus);
      CHECK(wrong.health() == Health::faulted);
    }
    DriverSensor<Sht> room(bench.loop, {.name = "room", .rate = 10_Hz, .retry_first = 10ms, .retry_longest = 20ms},
                           bench.bus, {0x44}, {.model = ShtModel::sht4x});
    CHECK(room.health() == Health::ok);
    std::vector<HumidityReading> all;
    const auto heard = bench.loop.subscribe<HumidityReading>(
        "room", [&](const Event<HumidityReading>& e) { all.push_back(*e); });
    bench.loop.advance(1s);
    REQUIRE(all.size() >= 9);
    CHECK(all[0].temperature == doctest::Approx(25));
    CHECK(all[0].humidity == doctest::Approx(50).epsilon(1e-3));
    chip.unplug();
    bench.loop.advance(1s);
    CHECK(room.health() == Health::faulted);
    const std::size_t before = all.size();
    chip.plug_in();
    bench.loop.advance(1s);
    CHECK(room.health() == Health::ok);
    CHECK(all.size() >= before + 8);
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("US-12 INA219, INA226: volts, amperes, watts; ranges, identity, lost settings") {
    // INA219, 8.6.3.1: 80 mV is 0x1f40, -80 mV 0xe0c0; bus of 16 V: 4000 << 3.
    const PowerReading reading = Ina::decode(0x1f40, 4000 << 3, {}).or_throw();
    CHECK(reading.voltage == doctest::Approx(16));
    CHECK(reading.current == doctest::Approx(0.8));
    CHECK(reading.power == doctest::Approx(12.8));
    CHECK(Ina::decode(0xe0c0, 0, {}).or_throw().current == doctest::Approx(-0.8));
    CHECK(Ina::decode(32000, 0, {}).error().code == Errc::out_of_range);
    CHECK(Ina::decode(static_cast<std::uint16_t>(-32000), 0, {}).error().code == Errc::out_of_range);
    // INA226, 7.6.2: -80 mV is 0x8300; 7.6.3: 1.25 mV a code.
    const Ina::Config config{InaModel::ina226, 0.01};
    CHECK(Ina::decode(0x8300, 9600, config).or_throw().current == doctest::Approx(-8));
    CHECK(Ina::decode(0x8300, 9600, config).or_throw().voltage == doctest::Approx(12));
    CHECK(Ina::decode(0x7fff, 9600, config).error().code == Errc::out_of_range);
    CHECK(Ina::decode(0, 0x7fff, config).error().code == Errc::out_of_range);
    CHECK(Ina::decode(0, 8000 << 3, {}).error().code == Errc::out_of_range);

    DriverBench bench;
    FakeI2cChip& chip = bench.wires->chip(0x40);
    chip.set_width(FakeI2cChip::Width::words);
    chip.set_word(1, 0x1f40);
    chip.set_word(2, 4000 << 3 | 2);
    DriverSensor<Ina> battery(bench.loop, {.name = "battery", .rate = 10_Hz}, bench.bus);
    bench.loop.advance(1s);
    CHECK(chip.word(0) == 0x399f);
    CHECK(battery.counts().published >= 9);
    chip.set_word(0, 0);
    bench.loop.advance(1s);
    CHECK(battery.counts().unreadable == 1);
    CHECK(chip.word(0) == 0x399f);
    CHECK(battery.health() == Health::ok);
    const auto published = battery.counts().published;
    chip.set_word(2, 4000 << 3);  // no new conversion
    bench.loop.advance(500ms);
    CHECK(battery.counts().repeated == 5);
    CHECK(battery.counts().published == published);
    bench.loop.advance(700ms);
    CHECK(battery.status().reason.find("it has stopped measuring") != std::string::npos);
    chip.set_word(2, 4000 << 3 | 3);
    bench.loop.advance(1s);
    CHECK(battery.status().reason.find("it reports an overflow") != std::string::npos);
    CHECK(battery.counts().published == published);
    chip.set_word(2, 4000 << 3 | 2);
    bench.loop.advance(1s);
    CHECK(battery.health() == Health::ok);
    CHECK(battery.counts().published > published);
    FakeI2cChip& other = bench.wires->chip(0x41);
    other.set_width(FakeI2cChip::Width::words);
    DriverSensor<Ina> motor(bench.loop, {.name = "motor", .rate = 10_Hz, .retry_longest = 1s}, bench.bus, {0x41},
                            config);
    CHECK(motor.health() == Health::faulted);
    CHECK(bench.errors.back().find("its identity is 0x00, that of an INA226 is 0x2260") != std::string::npos);
    other.set_word(0xff, 0x2261);
    bench.loop.advance(2s);
    CHECK(bench.errors.back().find("its maker is 0x00, not Texas Instruments (0x5449)") != std::string::npos);
    other.set_word(0xfe, 0x5449);
    other.set_word(6, 0x0008);
    bench.loop.advance(5s);
    CHECK(motor.health() == Health::ok);
    CHECK(motor.counts().published > 0);
    other.set_word(6, 0x000c);
    bench.loop.advance(1s);
    CHECK(motor.status().reason.find("it reports an overflow") != std::string::npos);
    CHECK_THROWS_AS(
        DriverSensor<Ina>(bench.loop, {.name = "b", .rate = 1_Hz}, bench.bus, {0x42}, {.shunt_resistance = 0}),
        SetupError);
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("a barometer's event has the time of the start, and comes when the conversion is over") {
    DriverBench bench;
    put_example(bench.wires->chip(0x76));
    std::vector<Duration> heard_at, times;
    const auto begin = bench.loop.now();
    const auto heard = bench.loop.subscribe<BarometerReading>("air", [&](const Event<BarometerReading>& event) {
      CHECK(event->pressure == doctest::Approx(100653.27).epsilon(1e-7));
      heard_at.push_back(bench.loop.now() - begin);
      times.push_back(event.time - Time{std::chrono::seconds{1'700'000'000}});
    });
    BarometerSensor air(bench.loop, {.name = "air", .rate = 10_Hz}, bench.bus, {.address = 0x76},
                        {.pressure_oversampling = 16, .temperature_oversampling = 2});
    bench.loop.advance(199ms);
    const Duration conversion = 1250us + 2 * 2300us + 16 * 2300us + 575us;
    const Duration opening = 3ms;  // after its reset
    CHECK(times == std::vector<Duration>{opening, opening + 100ms});
    CHECK(heard_at == std::vector<Duration>{opening + conversion, opening + 100ms + conversion});
    CHECK(bench.wires->chip(0x76).get(0xf4) == (2 << 5 | 5 << 2 | 1));
    CHECK(air.counts().taken == 2);
    CHECK(air.counts().late == 0);
    CHECK(bench.loop.runtime().balances());
    CHECK(bench.errors.empty());
  }

  TEST_CASE("US-27 a chip of another identity, without settings, without an answer is told, and comes back") {
    DriverBench bench;
    FakeI2cChip& chip = bench.wires->chip(0x76);
    put_example(chip);
    chip.set(0xd0, {0x60});
    BarometerSensor air(bench.loop, {.name = "air", .rate = 100_Hz, .retry_first = 10ms, .retry_longest = 20ms},
                        bench.bus);
    CHECK(air.health() == Health::faulted);
    REQUIRE(bench.errors.size() == 1);
    CHECK(bench.errors[0] ==
          "cannot use the chip as a BMP280: bus i2c1, 0x76: its identity is 0x60, that of a BMP280 is 0x58: it seems "
          "to be a BME280: set `model`");
    chip.set(0xd0, {0x58});
    bench.loop.advance(100ms);
    CHECK(air.health() == Health::ok);
    CHECK(air.counts().published > 0);
    chip.on_write(0xf4, [&](std::uint16_t) {});
    chip.set(0xf7, {0x80, 0, 0, 0x80, 0, 0});
    bench.loop.advance(50ms);
    CHECK(air.counts().unreadable > 0);
    put_example(chip);
    chip.unplug();
    bench.loop.advance(100ms);
    CHECK(air.health() == Health::faulted);
    CHECK(air.status().reason.find("nothing acknowledges this address") != std::string::npos);
    chip.plug_in();
    bench.loop.advance(100ms);
    CHECK(air.health() == Health::ok);
    air.stop();
    CHECK(air.counts().balances());
    CHECK(bench.bus.counts(0x76).failed > 0);
    CHECK(bench.bus.counts(0x77).transfers == 0);
  }

  TEST_CASE("NFR-1 four barometers convert side by side on one bus") {
    DriverBench bench;
    std::vector<BarometerSensor> all;
    for (unsigned i = 0; i < 4; ++i) {
      put_example(bench.wires->chip(0x70 + i));
      bench.wires->chip(0x70 + i).set_duration(1ms);
    }
    for (unsigned i = 0; i < 4; ++i) {  // each needs 76 ms of every 100
      all.emplace_back(bench.loop, SensorConfig{.name = "b" + std::to_string(i), .rate = 10_Hz}, bench.bus,
                       RegisterPlace{.address = 0x70 + i},
                       Barometer::Config{.pressure_oversampling = 16, .temperature_oversampling = 16});
    }
    bench.loop.advance(2s);
    for (BarometerSensor& one : all) {
      CHECK(one.counts().missed + one.counts().failed == 0);
      CHECK(one.counts().published >= 19);
    }
    const auto log = bench.wires->log();
    for (std::size_t i = 1; i < log.size(); ++i) CHECK(log[i].began >= log[i - 1].began + log[i - 1].took);
  }

  TEST_CASE("NFR-4 a tick that comes while a converter converts is begun late, not missed, and the recording says so") {
    ScratchDirectory folder;
    const std::string path = folder.file("run.db");
    {
      DriverBench bench;
      SqliteSink sink(bench.loop, {.path = path, .sink = {.batch_time = 3ms}});  // accounts while ticks are kept, too
      std::vector<DriverSensor<SlowAdc>> all;
      for (unsigned i = 0; i < 4; ++i) {
        bench.wires->chip(0x48 + i).set_duration(75us);
        all.emplace_back(bench.loop, SensorConfig{.name = "adc" + std::to_string(i), .rate = 125_Hz}, bench.bus,
                         I2cDevice::Place{0x48 + i});
      }
      bench.loop.advance(4s);
      for (DriverSensor<SlowAdc>& one : all) {
        const SensorCounts counts = one.counts();
        CHECK(counts.published >= 475);
        CHECK(counts.missed <= 25);
        CHECK(counts.late > counts.taken / 2);
        CHECK(counts.failed == 0);
        CHECK(counts.in_flight <= 1);
      }
      all[0].stop();  // with a tick that is kept, as are the next two
      all[1].set_rate(100_Hz);
      all[2].close();
      all[0].start();
      bench.loop.advance(100ms);
      CHECK(all[1].counts().scheduled == all[1].counts().taken + all[1].counts().missed + all[1].counts().in_flight);
      bench.loop.close();
      CHECK(bench.loop.runtime().balances());
      CHECK(bench.errors.empty());
    }
    const VerifyReport report = verify(Recording::open(path).or_throw()).or_throw();
    CHECK(report.problems.empty());
    CHECK(report.verdict() == Verdict::balanced);
  }

  TEST_CASE("a tick that was kept is failed where the read before it makes the device faulted") {
    DriverBench bench;
    FakeI2cChip& chip = bench.wires->chip(0x48);
    DriverSensor<SlowAdc> adc(bench.loop, {.name = "adc", .rate = 125_Hz, .faulted_after = 1}, bench.bus,
                              I2cDevice::Place{0x48});
    bench.loop.advance(4ms);
    chip.unplug();
    bench.loop.advance(20ms);
    const SensorCounts counts = adc.counts();
    CHECK(adc.health() == Health::faulted);
    CHECK(counts.scheduled == counts.failed + counts.taken);
    CHECK(counts.missed == 0);
    chip.plug_in();
    bench.loop.advance(10s);
    CHECK(adc.health() == Health::ok);
    bench.loop.close();
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("NFR-1 a chip that hangs is given up, its readings alone; a dead one does not starve the bus") {
    DriverBench bench;
    put_lm75(*bench.wires, 0x48, 20.5);
    FakeI2cChip& slow = put_lm75(*bench.wires, 0x49, 21);
    auto other_wires = std::make_shared<FakeI2c>();
    I2cBus other_bus("i2c2", other_wires, {.timeout = 100ms});
    put_lm75(*other_wires, 0x48, 22);
    Thermometer good(bench.loop, {.name = "good", .rate = 10_Hz}, bench.bus);
    Thermometer bad(bench.loop, {.name = "bad", .rate = 10_Hz}, bench.bus, {.address = 0x49});
    Thermometer other(bench.loop, {.name = "other", .rate = 100_Hz}, other_bus);
    bench.loop.advance(1s);
    CHECK(bad.health() == Health::ok);
    slow.set_duration(1h);
    bench.loop.advance(10s);
    CHECK(bad.health() == Health::faulted);
    CHECK(bad.status().reason.find("no answer within 100 ms") != std::string::npos);
    CHECK(good.counts().published > 80);  // it waits for 100 ms each time that the other one is tried
    CHECK(good.counts().failed == 0);
    CHECK(other.counts().taken == other.counts().scheduled);
    CHECK(other.counts().late == 0);
    slow.set_duration(0ms);
    bench.loop.advance(40s);
    CHECK(bad.health() == Health::ok);
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("two tiers on one bus: one transfer at a time, in the order in which they were asked for") {
    for (const std::uint64_t seed : {0u, 1u, 2u, 3u}) {
      CAPTURE(seed);
      auto wires = std::make_shared<FakeI2c>();
      I2cBus bus("i2c1", wires);
      put_lm75(*wires, 0x48, 20).set_duration(3ms);
      put_lm75(*wires, 0x49, 21).set_duration(4ms);
      std::vector<FakeI2c::Transfer> log;
      {
        Loop loop{Loop::Manual{.seed = seed}};
        be_quiet(loop);
        Tier fast(loop, {.name = "fast"});
        Thermometer here(loop, {.name = "here", .rate = 100_Hz}, bus, {.address = 0x48});
        Thermometer there(fast.loop(), {.name = "there", .rate = 100_Hz}, bus, {.address = 0x49});
        fast.start();
        loop.advance(1s);
        CHECK(there.counts().published > 90);
        CHECK(here.counts().published > 90);
        there.close();
        here.close();
        log = wires->log();
      }
      REQUIRE(log.size() > 180);
      std::size_t overlaps = 0;
      for (std::size_t i = 1; i < log.size(); ++i)
        if (log[i].began < log[i - 1].began + log[i - 1].took) ++overlaps;
      CHECK(overlaps == 0);
    }
  }

  TEST_CASE("on threads: two loops on one bus share its one thread") {
    auto wires = std::make_shared<FakeI2c>();
    I2cBus bus("i2c1", wires);
    put_lm75(*wires, 0x48, 20);
    put_lm75(*wires, 0x49, 21);
    Loop loop;
    be_quiet(loop);
    Tier fast(loop, {.name = "fast"});
    std::uint64_t heard = 0;
    const auto subscription = loop.subscribe("#", [&](const EventView&) {
      if (++heard == 400) loop.stop();
    });
    Thermometer here(loop, {.name = "here", .rate = 1_kHz}, bus, {.address = 0x48});
    Thermometer there(fast.loop(), {.name = "there", .rate = 1_kHz}, bus, {.address = 0x49});
    loop.run();
    CHECK(bus.counts(0x48).transfers > 0);
    CHECK(bus.counts(0x49).transfers > 0);
    there.close();
    here.close();
    fast.stop();
    CHECK(loop.close() == 0);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("US-12 a place on a bus is one sensor's, and an address has seven bits") {
    DriverBench bench;
    put_lm75(*bench.wires, 0x48, 20);
    Thermometer first(bench.loop, {.name = "a", .rate = 10_Hz}, bench.bus);
    CHECK_THROWS_WITH_AS(Thermometer(bench.loop, {.name = "b", .rate = 10_Hz}, bench.bus),
                         doctest::Contains("address 0x48: another sensor has it"), SetupError);
    first.close();
    Thermometer second(bench.loop, {.name = "b", .rate = 10_Hz}, bench.bus);
    CHECK_THROWS_WITH_AS(bench.bus.device({0x90}),
                         doctest::Contains("8-bit address, with the read/write bit; the 7-bit address is 0x48"),
                         SetupError);
    CHECK_THROWS_AS(bench.bus.device({0x03}), SetupError);
    CHECK_THROWS_AS(
        BarometerSensor(bench.loop, {.name = "c", .rate = 10_Hz}, bench.bus, {0x76}, {.pressure_oversampling = 3}),
        SetupError);
  }

  TEST_CASE("a bus retries as often as it is told, and counts for each address") {
    auto wires = std::make_shared<FakeI2c>();
    I2cBus bus("i2c1", wires, {.retries = 2});
    FakeI2cChip& chip = wires->chip(0x50);
    chip.set(7, {42});
    I2cDevice device = bus.device({0x50});
    chip.fail(2, EIO);
    CHECK(device.read_register(7).or_throw() == 42);
    chip.fail(3, ETIMEDOUT);
    CHECK(device.read_register(7).error().code == Errc::timed_out);
    CHECK(bus.counts(0x50).transfers == 2);
    CHECK(bus.counts(0x50).failed == 1);
    CHECK(bus.counts(0x50).retried == 4);
    device.abandon();
    CHECK(device.read_register(7).error().code == Errc::closed);
    I2cBus none({.device = "/dev/i2c-that-is-not-there"});
    CHECK(none.device({0x50}).read_register(0).error().code == Errc::not_found);
  }

  TEST_CASE("US-12 NFR-6 chips in a configuration: buses, addresses, and what is wrong with them") {
    const Registry registry = standard_registry();
    const auto problems = [&](const std::string& sensors) {
      return plan_system(registry,
                         parse_config(R"({"buses": {"i2c1": {"type": "i2c", "device": "/dev/i2c-9"}}, "sensors": [)" +
                                          sensors + "]}",
                                      "f.json"))
          .problems.text();
    };
    const std::string first = R"({"name": "a", "type": "lm75", "rate": "1 Hz", "bus": "i2c1", "address": "0x48"})";
    CHECK(problems(first) == "");
    CHECK(problems(first + R"(, {"name": "b", "type": "barometer", "rate": "1 Hz", "bus": "i2c1", "address": 118})") ==
          "");
    CHECK(problems(first + R"(, {"name": "b", "type": "lm75", "rate": "1 Hz", "bus": "i2c1"})")
              .find("has address 0x48 of the bus \"i2c1\" already; give each chip its own") != std::string::npos);
    CHECK(problems(R"({"name": "b", "type": "lm75", "rate": "1 Hz", "bus": "i2c1", "address": "0x90"})")
              .find("0x90 is an 8-bit address, with the read/write bit; the 7-bit address is 0x48") !=
          std::string::npos);
    CHECK(problems(R"({"name": "b", "type": "lm75", "rate": "1 Hz", "address": "high"})")
              .find("\"high\" is not an address") != std::string::npos);
    CHECK(problems(R"({"name": "b", "type": "barometer", "rate": "1 Hz", "bus": "i2c1", "pressure_oversampling": 3})")
              .find("3 is not one of 1, 2, 4, 8, 16") != std::string::npos);
    CHECK(
        problems(R"({"name": "b", "type": "lm75", "rate": "1 Hz", "bus": "i2c2"})").find("there is no bus \"i2c2\"") !=
        std::string::npos);
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    loop.on_error([](const ErrorReport&) {});
    System system(loop, registry,
                  parse_config(R"({"buses": {"i2c1": {"type": "i2c", "device": "/dev/i2c-that-is-not-there"}},
                                   "sensors": [)" +
                                   first + "]}",
                               "f.json"));
    loop.advance(1s);
    CHECK(loop.runtime().balances());
  }
}
