// Converters and load cells on a fake I2C bus: ADS1015/1115 and NAU7802; and what drivers need for them: payloads that
// their Config decides, readings of several conversions, what outlives an opening.
#include <doctest/doctest.h>

#include <array>
#include <cerrno>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "rtdata/app/program.hpp"
#include "rtdata/chips/ads1x15.hpp"
#include "rtdata/chips/nau7802.hpp"
#include "rtdata/config/system.hpp"
#include "sensors/bus_bench.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

MonotonicTime lane_now() { return Samples<int>::now(); }

/// An ADS1015 or ADS1115: its settings and, when a conversion is over, the code of the input that was chosen.
struct FakeAds {
  explicit FakeAds(FakeI2cChip& chip_, unsigned data_rate) : chip(chip_), period(1'000'000'000 / data_rate) {
    chip.set_width(FakeI2cChip::Width::words);
    chip.on_write(1, [this](std::uint16_t written) {
      settings = written & 0x7fff;
      if ((written & 0x8000) == 0) return;
      ++started;
      done = lane_now() + period;
      if (started == reset_in) settings = 0x0583, result = 0;
    });
    chip.on_read(1, [this] {
      const bool is_ready = lane_now() >= done;
      if (is_ready && started > 0 && started != reset_in) result = codes[settings >> 12 & 7];
      return byte_of(keeps_settings ? settings | (is_ready ? 0x8000 : 0) : 0x1234);
    });
    chip.on_read(0, [this] { return byte_of(result); });
  }
  std::uint8_t byte_of(int word) {
    is_low = !is_low;
    return static_cast<std::uint8_t>(is_low ? word >> 8 : word);
  }
  FakeI2cChip& chip;
  Duration period;
  std::array<std::uint16_t, 8> codes{};  // by the multiplexer's setting
  int settings = 0x0583;
  int result = 0;
  unsigned started = 0, reset_in = 0;
  bool keeps_settings = true;
  MonotonicTime done{};
  bool is_low = false;
};

struct Battery {
  std::optional<double> battery;
  std::optional<double> ain2_ain3;
  friend constexpr auto describe(type_tag<Battery>) {
    return record("adc", field("battery", &Battery::battery, "V"), field("ain2_ain3", &Battery::ain2_ain3, "V"));
  }
};

using Adc = DriverSensor<Ads1x15>;
using Scale = DriverSensor<Nau7802>;
const Ads1x15::Config two_channels{.channels = {{"battery", "0", 4.096}, {"", "2-3", 0.256}}};

/// A NAU7802 with the registers that a driver touches; a sample is ready `period` after the one before was read.
struct FakeNau {
  explicit FakeNau(FakeI2cChip& chip_) : chip(chip_) {
    chip.set(0x1f, {0x0f});
    chip.on_write(0x00, [this](std::uint16_t value) {
      power = value;
      if ((value & 0x01) != 0) gain = rate = 0;
      if ((value & 0x10) != 0) due = lane_now() + period;
    });
    chip.on_write(0x01, [this](std::uint16_t value) { gain = value; });
    chip.on_write(0x02, [this](std::uint16_t value) {
      rate = value;
      if ((value & 0x04) != 0) ++calibrated, calibrated_at = lane_now() + calibration;
    });
    // Registers that are read with functions keep the pointer: three bytes from 0 on are these.
    chip.on_read(0x00, [this]() -> std::uint8_t {
      const unsigned at = next++ % 3;
      if (at == 0)
        return static_cast<std::uint8_t>(power | ((power & 2) != 0 ? 0x08 : 0) |
                                         ((power & 0x10) != 0 && lane_now() >= due ? 0x20 : 0));
      if (at == 1) return static_cast<std::uint8_t>(gain);
      const bool is_calibrating = (rate & 0x04) != 0 && (lane_now() < calibrated_at || never_calibrates);
      if (!is_calibrating) rate = rate & ~0x04 & 0xff;
      return static_cast<std::uint8_t>(rate | (calibration_fails && !is_calibrating ? 0x08 : 0));
    });
    chip.on_read(0x12, [this]() -> std::uint8_t {
      const unsigned at = byte++ % 3;
      if (at == 0) due = lane_now() + period;
      return static_cast<std::uint8_t>(code >> (16 - 8 * at) & 0xff);
    });
  }
  FakeI2cChip& chip;
  int power = 0, gain = 0, rate = 0, code = 0;
  unsigned calibrated = 0, next = 0, byte = 0;
  bool calibration_fails = false, never_calibrates = false;
  Duration period = 100ms, calibration = 300ms;
  MonotonicTime due{}, calibrated_at{};
};

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-12 ADS1115, ADS1015: the data sheet's codes, and the ends of the range") {
    // SBAS444D, table of ideal codes: 1 LSB is the range over 2^15.
    CHECK(Ads1x15::decode(Ads1x15Model::ads1115, 0x0001, 4.096).or_throw() == doctest::Approx(125e-6));
    CHECK(Ads1x15::decode(Ads1x15Model::ads1115, 0x0000, 4.096).or_throw() == 0);
    CHECK(Ads1x15::decode(Ads1x15Model::ads1115, 0xffff, 4.096).or_throw() == doctest::Approx(-125e-6));
    CHECK(Ads1x15::decode(Ads1x15Model::ads1115, 0x7ffe, 4.096).or_throw() == doctest::Approx(4.09575));
    CHECK(Ads1x15::decode(Ads1x15Model::ads1115, 0x8001, 0.256).or_throw() == doctest::Approx(-0.2559921875));
    CHECK(Ads1x15::decode(Ads1x15Model::ads1115, 0x7fff, 4.096).error().code == Errc::out_of_range);
    CHECK(Ads1x15::decode(Ads1x15Model::ads1115, 0x8000, 4.096).error().code == Errc::out_of_range);
    // SBAS473E: 12 bits, left-aligned; 1 LSB of the range of 4.096 V is 2 mV.
    CHECK(Ads1x15::decode(Ads1x15Model::ads1015, 0x0010, 4.096).or_throw() == doctest::Approx(0.002));
    CHECK(Ads1x15::decode(Ads1x15Model::ads1015, 0xfff0, 4.096).or_throw() == doctest::Approx(-0.002));
    CHECK(Ads1x15::decode(Ads1x15Model::ads1015, 0x7fe0, 6.144).or_throw() == doctest::Approx(2046 * 0.003));
    CHECK(Ads1x15::decode(Ads1x15Model::ads1015, 0x7ff0, 4.096).error().code == Errc::out_of_range);
    CHECK(Ads1x15::decode(Ads1x15Model::ads1015, 0x8000, 4.096).error().code == Errc::out_of_range);
    CHECK(Ads1x15::decode(Ads1x15Model::ads1015, 0x1234, 4.096).error().code == Errc::bad_data);
    // 8.1.3: multiplexer 14:12, range 11:9, single shot 8, rate 7:5.
    CHECK(Ads1x15::settings_of({}, {.input = "0"}) == 0x4387);
    CHECK(Ads1x15::settings_of({}, two_channels.channels[1]) == (3 << 12 | 5 << 9 | 0x187));
    CHECK(Ads1x15::settings_of({.model = Ads1x15Model::ads1015, .data_rate = 3300}, {.input = "3"}) ==
          (7 << 12 | 0x300 | 6 << 5 | 7));
  }

  TEST_CASE("US-12 ADS1115: the chosen channels are the payload, each with its range, in one event") {
    I2cBench bench;
    FakeAds chip(bench.wires->chip(0x48), 128);
    chip.codes[4] = 0x4000;
    chip.codes[3] = 0xc000;
    std::vector<Battery> all;
    std::vector<Duration> times, heard_at;
    const auto begin = bench.loop.now();
    const auto heard = bench.loop.subscribe<Battery>("adc", [&](const Event<Battery>& event) {
      all.push_back(*event);
      times.push_back(event.time - Time{std::chrono::seconds{1'700'000'000}});
      heard_at.push_back(bench.loop.now() - begin);
    });
    Adc adc(bench.loop, {.name = "adc", .rate = 10_Hz}, bench.bus, {0x48}, two_channels);
    bench.loop.advance(199ms);
    REQUIRE(all.size() == 2);
    CHECK(all[0].battery == doctest::Approx(2.048));
    CHECK(all[0].ain2_ain3 == doctest::Approx(-0.128));
    CHECK(times == std::vector<Duration>{0ms, 100ms});
    CHECK(heard_at[0] >= 2 * 1'000'000'000ns / 128);
    CHECK(heard_at[0] < 18ms);
    CHECK(chip.started == 4);
    CHECK(adc.counts().received == 2);
    CHECK(adc.counts().late == 0);
    CHECK(bench.errors.empty());
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("US-12 NFR-1 four ADS1115 on one bus convert four channels each side by side") {
    I2cBench bench;
    std::vector<std::unique_ptr<FakeAds>> chips;
    std::vector<Adc> all;
    for (unsigned i = 0; i < 4; ++i) {
      chips.push_back(std::make_unique<FakeAds>(bench.wires->chip(0x48 + i), 128));
      bench.wires->chip(0x48 + i).set_duration(100us);
      // each needs 36 ms of every 50: in turns they could not
      all.emplace_back(bench.loop, SensorConfig{.name = "a" + std::to_string(i), .rate = 20_Hz}, bench.bus,
                       I2cDevice::Place{0x48 + i});
    }
    bench.loop.advance(2s);
    for (Adc& one : all) {
      CHECK(one.counts().missed + one.counts().failed == 0);
      CHECK(one.counts().published >= 39);
    }
    const auto log = bench.wires->log();
    for (std::size_t i = 1; i < log.size(); ++i) CHECK(log[i].began >= log[i - 1].began + log[i - 1].took);
  }

  TEST_CASE("US-27 ADS1115: a channel at the end of its range has no value and is counted; the others go on") {
    I2cBench bench;
    FakeAds chip(bench.wires->chip(0x48), 128);
    chip.codes[4] = 0x7fff;
    chip.codes[3] = 0x1000;
    std::vector<Battery> all;
    const auto heard = bench.loop.subscribe<Battery>("adc",
                                                     [&](const Event<Battery>& event) { all.push_back(*event); });
    Adc adc(bench.loop, {.name = "adc", .rate = 10_Hz}, bench.bus, {0x48}, two_channels);
    bench.loop.advance(950ms);
    REQUIRE(all.size() == 10);
    CHECK_FALSE(all[0].battery);
    CHECK(all[0].ain2_ain3 == doctest::Approx(0.032));
    CHECK(adc.counts().unreadable == 10);
    CHECK(adc.counts().published == 10);
    CHECK(adc.counts().failed == 0);
    CHECK(bench.told("battery: the voltage is at the end of its range: choose a larger `range`"));
    chip.codes[3] = 0x8000;  // now there is nothing to publish
    bench.loop.advance(100ms);
    CHECK(adc.counts().published == 10);
    CHECK(adc.counts().failed == 1);
    chip.codes[3] = chip.codes[4] = 0x0100;
    bench.loop.advance(1s);
    CHECK(all.back().battery == doctest::Approx(0.032));
    CHECK(adc.health() == Health::ok);
    adc.stop();
    CHECK(adc.counts().balances());
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE(
      "US-27 ADS1115: absent, another chip, reset in a conversion, unplugged: told, counted, and over when it is") {
    I2cBench bench;
    FakeI2cChip& socket = bench.wires->chip(0x48);
    FakeAds chip(socket, 128);
    chip.codes[0] = chip.codes[3] = 0x1000;
    chip.keeps_settings = false;
    socket.unplug();
    // Those of the first channel are the settings after a reset, too.
    Adc adc(bench.loop, {.name = "adc", .rate = 10_Hz, .retry_first = 10ms, .retry_longest = 20ms}, bench.bus, {0x48},
            {.channels = {{"battery", "0-1", 2.048}, {"", "2-3", 0.256}}});
    CHECK(adc.health() == Health::faulted);
    CHECK(bench.told("nothing acknowledges this address"));
    socket.plug_in();
    bench.loop.advance(500ms);
    CHECK(adc.status().reason.find("it does not keep its settings") != std::string::npos);
    CHECK(adc.counts().published == 0);
    chip.keeps_settings = true;
    bench.loop.advance(500ms);
    CHECK(adc.health() == Health::ok);
    // A reset while a channel with the settings of a reset is converted gives code 0: nothing of it is published.
    bench.loop.advance(50ms);  // between two ticks
    for (const unsigned in : {1u, 2u}) {
      const auto before = adc.counts();
      chip.reset_in = chip.started + in;
      bench.loop.advance(100ms);
      CHECK(adc.counts().unreadable == before.unreadable + 1);
      CHECK(adc.counts().published == before.published);
      CHECK(adc.status().reason.find("it has lost its settings since the start") != std::string::npos);
      bench.loop.advance(300ms);
      CHECK(adc.counts().published == before.published + 3);
    }
    const auto published = adc.counts().published;
    socket.fail(1, EIO);  // the first transfer of the next tick; the one after begins with the first channel
    bench.loop.advance(200ms);
    CHECK(adc.counts().published == published + 1);
    socket.unplug();
    bench.loop.advance(1s);
    CHECK(adc.health() == Health::faulted);
    socket.plug_in();
    bench.loop.advance(1s);
    CHECK(adc.health() == Health::ok);
    chip.period = 1s;  // its clock has slowed down
    bench.loop.advance(200ms);
    CHECK(adc.status().reason.find("the conversion takes too long") != std::string::npos);
    adc.stop();
    CHECK(adc.counts().balances());
  }

  TEST_CASE("US-12 NFR-5 channels in a configuration, and what is wrong with them") {
    const Registry registry = standard_registry();
    const auto problems = [&](const std::string& more) {
      const auto plan = plan_system(
          registry, parse_config(R"({"buses": {"i2c1": {"type": "i2c", "device": "/dev/i2c-9"}}, "sensors": [
        {"name": "a", "type": "ads1x15", "rate": "1 Hz", "bus": "i2c1")" +
                                     more + "}]}",
                                 "f.json"));
      return plan.problems.text();
    };
    const auto has = [](const std::string& text, const char* part) { return text.find(part) != std::string::npos; };
    CHECK(problems("") == "");
    CHECK(problems(R"(, "channels": [{"input": "0-1", "range": 0.256}, {"name": "x", "input": "3"}])") == "");
    CHECK(problems(R"(, "channels": [])") == "");  // all
    CHECK(has(problems(R"(, "channels": [{"name": "a"}, {"name": "b"}, {"name": "c"}, {"name": "d"}, {"name": "e"},
                                         {"name": "f"}, {"name": "g"}, {"name": "h"}, {"name": "i"}])"),
              "there are more than 8 channels"));
    CHECK(has(problems(R"(, "channels": [{"input": "4"}])"), "channels[0].input"));
    CHECK(has(problems(R"(, "channels": [{"input": "0"}, {"range": 5}])"),
              "channels[1].range: 5.000000 is not one of its values"));
    CHECK(has(problems(R"(, "channels": [{"input": "0"}, {"input": "0", "range": 0.256}])"),
              "give each channel a `name`"));
    CHECK(problems(R"(, "data_rate": 250, "model": "ads1015")") == "");
    CHECK(has(problems(R"(, "data_rate": 860, "model": "ads1015")"), "take 128, 250, 490, 920, 1600, 2400 or 3300"));
    CHECK(has(problems(R"(, "data_rate": 3300)"), "take 8, 16, 32, 64, 128, 250, 475 or 860"));
    I2cBench bench;
    CHECK_THROWS_WITH_AS(
        Adc(bench.loop, {.name = "a", .rate = 1_Hz}, bench.bus, {0x48}, {.channels = {{"", "5"}}}),
        doctest::Contains(
            "channels[0].input: it has no input \"5\": choose one of its inputs: 0, 1, 2, 3, 0-1, 0-3, 1-3 and 2-3"),
        SetupError);
    CHECK_THROWS_AS(Adc(bench.loop, {.name = "a", .rate = 1_Hz}, bench.bus, {0x48}, {.data_rate = 100}), SetupError);
    Adc good(bench.loop, {.name = "a", .rate = 1_Hz}, bench.bus);  // the name is free still
    CHECK(good.is_running());
  }

  TEST_CASE("US-12 NAU7802: codes, and what they are of the bridge's supply") {
    const auto code = [](unsigned word) {
      const std::array<std::uint8_t, 3> bytes{static_cast<std::uint8_t>(word >> 16 & 0xff),
                                              static_cast<std::uint8_t>(word >> 8 & 0xff),
                                              static_cast<std::uint8_t>(word & 0xff)};
      return Nau7802::decode(bytes);
    };
    CHECK(code(0x000000) == 0);
    CHECK(code(0x000001) == 1);
    CHECK(code(0x7fffff) == 8388607);
    CHECK(code(0x800000) == -8388608);
    CHECK(code(0xffffff) == -1);
    CHECK(Nau7802::ratio_of(0x400000, 1) == doctest::Approx(250));
    CHECK(Nau7802::ratio_of(-0x400000, 128) == doctest::Approx(-1.953125));
  }

  TEST_CASE("US-12 NAU7802: calibrated, then each sample once; the tare is taken off, shown, and kept over a fault") {
    I2cBench bench;
    FakeNau chip(bench.wires->chip(0x2a));
    chip.code = 0x010000;
    std::vector<BridgeReading> all;
    const auto heard = bench.loop.subscribe<BridgeReading>("scale",
                                                           [&](const Event<BridgeReading>& e) { all.push_back(*e); });
    Scale scale(bench.loop, {.name = "scale", .rate = 20_Hz, .retry_first = 10ms, .retry_longest = 20ms}, bench.bus,
                {0x2a}, {.gain = 64, .tare_samples = 4});
    bench.loop.advance(2s);
    CHECK(chip.calibrated == 1);
    CHECK(chip.gain == (5 << 3 | 6));
    CHECK(chip.power == 0x96);
    REQUIRE(all.size() >= 4);
    for (std::size_t i = 0; i < 4; ++i) {
      CHECK_FALSE(all[i].value);
      CHECK_FALSE(all[i].tare);
      CHECK(all[i].raw == 0x010000);
    }
    const double tare = Nau7802::ratio_of(0x010000, 64);
    chip.code = -0x030000;
    bench.loop.advance(1s);
    CHECK(all.back().tare == doctest::Approx(tare));
    CHECK(all.back().value == doctest::Approx(-4 * tare));
    CHECK(all.back().raw == -0x030000);
    CHECK(scale.counts().repeated > 10);  // twice as many ticks as samples
    CHECK(scale.counts().failed == 0);
    bench.wires->chip(0x2a).unplug();
    bench.loop.advance(1s);
    CHECK(scale.health() == Health::faulted);
    bench.wires->chip(0x2a).plug_in();
    const std::size_t before = all.size();
    bench.loop.advance(2s);
    CHECK(scale.health() == Health::ok);
    CHECK(chip.calibrated == 2);
    REQUIRE(all.size() > before);
    for (std::size_t i = before; i < all.size(); ++i) CHECK(all[i].value == doctest::Approx(-4 * tare));
    scale.stop();
    CHECK(scale.counts().balances());
  }

  TEST_CASE("US-27 NAU7802: another chip, a calibration that fails, a reset, a full bridge, silence: told, then over") {
    I2cBench bench;
    FakeI2cChip& socket = bench.wires->chip(0x2a);
    FakeNau chip(socket);
    socket.set(0x1f, {0x00});
    Scale scale(bench.loop, {.name = "scale", .rate = 10_Hz, .retry_first = 10ms, .retry_longest = 20ms}, bench.bus);
    CHECK(scale.health() == Health::faulted);
    CHECK(bench.told("its identity is 0x00, that of an NAU7802 is 0x0f"));
    socket.set(0x1f, {0x0f});
    chip.calibration_fails = true;
    bench.loop.advance(3s);
    CHECK(scale.counts().published == 0);
    CHECK(bench.told("its calibration has failed"));
    chip.calibration_fails = false;
    chip.never_calibrates = true;
    bench.loop.advance(5s);
    CHECK(bench.told("its calibration does not end"));
    CHECK(scale.counts().published == 0);
    chip.never_calibrates = false;
    bench.loop.advance(3s);
    CHECK(scale.health() == Health::ok);
    chip.power = chip.gain = chip.rate = 0;
    const auto published = scale.counts().published;
    bench.loop.advance(110ms);
    CHECK(scale.counts().unreadable == 1);
    CHECK(scale.counts().published == published);
    bench.loop.advance(2s);
    CHECK(scale.health() == Health::ok);
    CHECK(scale.counts().published > published);
    chip.code = 0x7fffff;
    bench.loop.advance(200ms);
    CHECK(scale.status().reason.find("the signal of the bridge is at the end of the range") != std::string::npos);
    chip.code = 5;
    chip.period = 1h;  // after the next sample
    bench.loop.advance(3s);
    CHECK(bench.told("it has stopped measuring"));
    chip.period = 100ms;
    bench.loop.advance(5s);
    CHECK(scale.health() == Health::ok);
    scale.stop();
    CHECK(scale.counts().balances());
    CHECK_THROWS_AS(Scale(bench.loop, {.name = "b", .rate = 1_Hz}, bench.bus, {0x2b}, {.gain = 3}), SetupError);
    CHECK_THROWS_AS(Scale(bench.loop, {.name = "b", .rate = 1_Hz}, bench.bus, {0x2b}, {.data_rate = 0}), SetupError);
    CHECK_THROWS_AS(Scale(bench.loop, {.name = "b", .rate = 1_Hz}, bench.bus, {0x2b}, {.supply_voltage = 5}),
                    SetupError);
  }
}
