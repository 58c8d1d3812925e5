// SPI: the bus and the MCP3008/3208 on a fake, faults, and configurations.
#include <doctest/doctest.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <numeric>
#include <string>
#include <vector>

#include "rtdata/app/program.hpp"
#include "rtdata/chips/mcp3x08.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/testing/fake_spi.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

/// As the data sheet's figures 5-1 and 6-1 have it: 24 clocks; after the start bit, single-ended and three bits of the
/// channel the chip needs one and a half clocks, then gives a null bit and its code.
FakeSpi::Chip chip_of(AdcModel model, const std::array<std::uint16_t, 8>& codes) {
  const int bits = model == AdcModel::mcp3008 ? 10 : 12;
  return [bits, codes](std::span<const std::uint8_t> write, std::span<std::uint8_t> read) {
    const auto bit_in = [&](int at) {
      return at < 24 ? write[static_cast<std::size_t>(at / 8)] >> (7 - at % 8) & 1 : 0;
    };
    int start = 0;
    while (start < 24 && bit_in(start) == 0) ++start;
    const int channel = bit_in(start + 2) << 2 | bit_in(start + 3) << 1 | bit_in(start + 4);
    const bool is_single = bit_in(start + 1) == 1;
    std::fill(read.begin(), read.end(), std::uint8_t{0xff});  // its output floats
    const int null_bit = start + 6;
    const auto put = [&](int at, int bit) {
      if (at >= 24) return;
      const auto mask = static_cast<std::uint8_t>(0x80 >> at % 8);
      std::uint8_t& byte = read[static_cast<std::size_t>(at / 8)];
      byte = static_cast<std::uint8_t>(bit != 0 ? byte | mask : byte & ~mask);
    };
    put(null_bit, 0);
    const int code = is_single ? codes[static_cast<std::size_t>(channel)] : 0;
    for (int i = 0; i < bits; ++i) put(null_bit + 1 + i, code >> (bits - 1 - i) & 1);
  };
}

using Adc = DriverSensor<Mcp3x08>;

struct Lever {
  double lever = 0;
  double ain0 = 0;
  double ain4_ain5 = 0;
  friend constexpr auto describe(type_tag<Lever>) {
    return record("adc", field("lever", &Lever::lever, "V"), field("ain0", &Lever::ain0, "V"),
                  field("ain4_ain5", &Lever::ain4_ain5, "V"));
  }
};

struct SpiWireBench {
  std::shared_ptr<FakeSpi> wires = std::make_shared<FakeSpi>();
  SpiBus bus{"spi0", wires, {.timeout = 100ms}};
  Loop loop{Loop::Manual{}};
  std::vector<std::string> errors;
  SpiWireBench() {
    be_quiet(loop);
    loop.on_error([this](const ErrorReport& report) {
      if (report.error.code != Errc::held_too_long) errors.push_back(report.error.text());
    });
  }
};

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-11 MCP3008 and MCP3208: every code of every channel comes back") {
    for (const AdcModel model : {AdcModel::mcp3008, AdcModel::mcp3208}) {
      const int codes = model == AdcModel::mcp3008 ? 1024 : 4096;
      for (int code = 0; code < codes; ++code) {
        std::array<std::uint16_t, 8> all{};
        for (std::size_t i = 0; i < 8; ++i)
          all[i] = static_cast<std::uint16_t>((code + static_cast<int>(i) * 37) % codes);
        const FakeSpi::Chip chip = chip_of(model, all);
        for (unsigned channel = 0; channel < 8; ++channel) {
          std::array<std::uint8_t, 3> answer{};
          chip(Mcp3x08::request(model, std::to_string(channel)), answer);
          REQUIRE(Mcp3x08::decode(model, answer) == all[channel]);
        }
      }
      const std::array<std::uint8_t, 3> nobody{0xff, 0xff, 0xff};
      CHECK_FALSE(Mcp3x08::decode(model, nobody));
    }
    // DS21298E, figure 6-1: channel 6 is 0000 0111, 10XX XXXX; DS21295D: 0000 0001, 1110 XXXX.
    CHECK(Mcp3x08::request(AdcModel::mcp3208, "6") == std::array<std::uint8_t, 3>{0x07, 0x80, 0});
    CHECK(Mcp3x08::request(AdcModel::mcp3008, "6") == std::array<std::uint8_t, 3>{0x01, 0xe0, 0});
    // Tables 5-1 and 5-2: pairs without the bit for single-ended; CH3 less CH2 is 0 1 1.
    CHECK(Mcp3x08::request(AdcModel::mcp3208, "3-2") == std::array<std::uint8_t, 3>{0x04, 0xc0, 0});
    CHECK(Mcp3x08::request(AdcModel::mcp3008, "7-6") == std::array<std::uint8_t, 3>{0x01, 0x70, 0});
  }

  TEST_CASE("US-11 two converters on one controller: volts, one message a tick, one after the other") {
    SpiWireBench bench;
    bench.wires->on_transfer(0, chip_of(AdcModel::mcp3208, {0, 1, 2, 2048, 4, 5, 6, 4095}));
    bench.wires->on_transfer(1, chip_of(AdcModel::mcp3008, {1023, 1, 2, 3, 4, 5, 6, 512}));
    bench.wires->set_duration(0, 1ms);
    std::vector<std::array<double, 8>> first;
    std::vector<Lever> second;
    const auto a = bench.loop.subscribe("a", [&](const EventView& event) {
      REQUIRE(event.payload().size() == sizeof first[0]);
      CHECK(event.description().fields()[3].name == "ain3");
      std::memcpy(&first.emplace_back(), event.payload().data(), sizeof first[0]);
    });
    const auto b = bench.loop.subscribe<Lever>("b", [&](const Event<Lever>& e) { second.push_back(*e); });
    Adc one(bench.loop, {.name = "a", .rate = 100_Hz}, bench.bus, {}, {.reference_voltage = 4.096});
    Adc two(bench.loop, {.name = "b", .rate = 100_Hz}, bench.bus, {.chip_select = 1},
            {.channels = {{"lever", "7"}, {"", "0"}, {"", "4-5"}}, .model = AdcModel::mcp3008, .reference_voltage = 5});
    bench.loop.advance(1s);
    REQUIRE(first.size() >= 99);
    REQUIRE(second.size() >= 99);
    CHECK(first[0][0] == 0);
    CHECK(first[0][3] == doctest::Approx(2.048));
    CHECK(first[0][7] == doctest::Approx(4.095));
    CHECK(second[0].lever == doctest::Approx(2.5));
    CHECK(second[0].ain0 == doctest::Approx(5.0 * 1023 / 1024));
    CHECK(second[0].ain4_ain5 == 0);
    CHECK(bench.bus.counts(0).transfers == bench.wires->transfers(0));
    CHECK(bench.bus.counts(0).busy >= 99ms);
    CHECK(bench.bus.counts(7).transfers == 0);
    CHECK(bench.errors.empty());
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE(
      "US-11 inline: short transfers run on the sensor's loop, which waits for them; faults are told as on a lane") {
    SpiWireBench bench;
    SpiBus bus("spi0", bench.wires, {.reads_on_loop = true});
    bench.wires->on_transfer(0, chip_of(AdcModel::mcp3208, {7}));
    bench.wires->set_duration(0, 300us);
    std::size_t events = 0;
    std::vector<MonotonicTime> ticks;
    const auto heard = bench.loop.subscribe("a", [&](const EventView&) { ++events; });
    Adc adc(bench.loop, {.name = "a", .rate = 1_kHz, .retry_first = 10ms, .retry_longest = 10ms}, bus);
    const Ticker beside(bench.loop, 1ms, [&](const Tick& tick) { ticks.push_back(tick.now); });
    bench.loop.advance(1s);
    CHECK(adc.counts().missed + adc.counts().failed == 0);
    CHECK(adc.counts().taken == events);
    CHECK(events >= 999);
    CHECK(ticks.size() >= 999);
    for (const MonotonicTime tick : ticks) REQUIRE(tick.time_since_epoch() % 1ms >= 300us);  // the loop was held before
    bench.wires->fail(0, 4, EIO);
    bench.loop.advance(100ms);
    CHECK(bus.counts(0).failed == 4);
    CHECK(adc.counts().failed >= 4);
    CHECK(adc.health() == Health::ok);
    CHECK_FALSE(bench.errors.empty());
    adc.stop();
    const auto at_stop = bench.wires->transfers(0);
    bench.loop.advance(100ms);
    CHECK(bench.wires->transfers(0) == at_stop);
    adc.start();
    bench.loop.advance(10ms);
    CHECK(bench.wires->transfers(0) > at_stop);
    adc.close();
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("US-11 US-27 no chip, a failing controller, one that hangs: told at the sensor, and over when it is") {
    SpiWireBench bench;
    bench.wires->on_transfer(1, chip_of(AdcModel::mcp3208, {}));
    Adc none(bench.loop, {.name = "none", .rate = 50_Hz, .retry_first = 10ms, .retry_longest = 20ms}, bench.bus);
    Adc good(bench.loop, {.name = "good", .rate = 50_Hz, .retry_first = 10ms, .retry_longest = 20ms}, bench.bus,
             {.chip_select = 1});
    bench.loop.advance(1s);
    CHECK(none.counts().published == 0);
    CHECK(none.counts().failed > 2);
    CHECK(none.status().reason.find("no chip answers") != std::string::npos);
    CHECK(none.health() == Health::faulted);
    CHECK(good.counts().missed + good.counts().failed + good.counts().late == 0);
    bench.wires->on_transfer(0, chip_of(AdcModel::mcp3208, {}));
    bench.loop.advance(1s);
    CHECK(none.health() == Health::ok);
    bench.wires->fail(0, 5, EIO);
    bench.loop.advance(1s);
    CHECK(none.health() == Health::ok);
    CHECK(bench.bus.counts(0).failed == 5);
    bench.wires->set_duration(0, 1h);
    bench.loop.advance(1s);
    CHECK(none.health() == Health::faulted);
    CHECK(none.status().reason.find("no answer within 100 ms") != std::string::npos);
    bench.wires->set_duration(0, 0ms);
    bench.loop.advance(1min);
    CHECK(none.health() == Health::ok);
    CHECK(good.health() == Health::ok);
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("US-11 what a transfer cannot be is told before it is tried") {
    SpiWireBench bench;
    SpiDevice chip = bench.bus.device({});
    std::vector<std::uint8_t> many(5000);
    const std::array<std::uint8_t, 2> two{};
    CHECK(chip.write(many).error().code == Errc::bad_argument);
    CHECK(chip.transfer(two, std::span(many).first(3)).error().code == Errc::bad_argument);
    CHECK(bench.wires->transfers(0) == 0);
    CHECK(chip.read(std::span(many).first(4)));
    CHECK(std::accumulate(many.begin(), many.begin() + 4, 0) == 4 * 255);
    chip.abandon();
    CHECK(chip.write(two).error().code == Errc::closed);
    CHECK_THROWS_AS(bench.bus.device({.mode = 4}), SetupError);
    SpiBus away({.device = "/dev/spidev-that-is-not-there"});
    SpiDevice nothing = away.device({.chip_select = 3});
    const auto failed = nothing.write(two);
    CHECK(failed.error().code == Errc::not_found);
    CHECK(failed.error().where == "/dev/spidev-that-is-not-there.3");
  }

  TEST_CASE("US-11 NFR-6 chips on SPI in a configuration, and what is wrong with them") {
    const Registry registry = standard_registry();
    const auto problems = [&](const std::string& device, const std::string& sensors) {
      return plan_system(registry, parse_config(R"({"buses": {"spi0": {"type": "spi", "device": ")" + device +
                                                    R"("}}, "sensors": [)" + sensors + "]}",
                                                "f.json"))
          .problems.text();
    };
    const std::string adc = R"({"name": "a", "type": "mcp3x08", "rate": "1 Hz", "bus": "spi0")";
    CHECK(problems("/dev/spidev0", adc + "}") == "");
    CHECK(problems("/dev/spidev0", adc + "}, " + R"({"name": "b", "type": "mcp3x08", "rate": "1 Hz", "bus": "spi0",
      "chip_select": 1, "model": "mcp3008", "clock": 500000})") == "");
    CHECK(problems("/dev/spidev0", adc + "}, " + R"({"name": "b", "type": "mcp3x08", "rate": "1 Hz", "bus": "spi0"})")
              .find("has chip select 0 of the bus \"spi0\" already") != std::string::npos);
    CHECK(problems("/dev/spidev0.1", adc + "}")
              .find("write \"/dev/spidev0\" here, and \"chip_select\": 1 to the sensor") != std::string::npos);
    CHECK(problems("/dev/spidev0", adc + R"(, "mode": 4})").find("mode") != std::string::npos);
    CHECK(problems("/dev/spidev0", adc + R"(, "reference_voltage": 0})").find("reference_voltage") !=
          std::string::npos);
  }
}
