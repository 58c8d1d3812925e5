// Chips that tell which chip they are: another one is refused, a clone is taken by the user's word, and told.
#include <doctest/doctest.h>

#include <memory>
#include <string>
#include <vector>

#include "rtdata/app/program.hpp"
#include "rtdata/chips/accelerometer.hpp"
#include "rtdata/chips/barometer.hpp"
#include "rtdata/chips/bme680.hpp"
#include "rtdata/chips/bno055.hpp"
#include "rtdata/chips/imu.hpp"
#include "rtdata/chips/ina.hpp"
#include "rtdata/chips/ina3221.hpp"
#include "rtdata/chips/magnetometer.hpp"
#include "rtdata/chips/nau7802.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/testing/fake_i2c.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

/// A bus with chips that tell an identity and nothing else.
struct IdentityBench {
  IdentityBench() {
    loop.runtime().on_log([this](const LogRecord& record) {
      if (record.level == LogLevel::warning && record.text.find("takes a chip") != std::string_view::npos)
        log.push_back(std::string(record.object) + ": " + std::string(record.text));
    });
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
  }
  bool told(const std::string& text) const { return !errors.empty() && errors.back().find(text) != std::string::npos; }

  std::shared_ptr<FakeI2c> wires = std::make_shared<FakeI2c>();
  I2cBus bus{"i2c1", wires, {.timeout = 5s}};
  Loop loop{Loop::Manual{}};
  std::vector<std::string> errors, log;
};

/// All chips of a driver that tell their identity: one with other bits, by the user's word, and against it.
template <class D>
void try_identities() {
  std::size_t index = 0;
  for (const KnownChip& known : D::chips) {
    const std::size_t model = index++;
    if (!known.identity) continue;
    CAPTURE(known.name);
    const ChipIdentity& identity = *known.identity;
    const std::uint32_t found = identity.value ^ (identity.mask & 0x56), other = found ^ (identity.mask & 0x38);
    IdentityBench bench;
    FakeI2cChip& chip = bench.wires->chip(known.addresses[0]);
    const auto failure = [&](std::optional<IdentityCode> word) {
      typename D::Config config;
      if constexpr (requires { config.model; }) config.model = static_cast<decltype(config.model)>(model);
      config.identity = word;
      typename D::Device::Place place{};
      place.address = known.addresses[0];
      const DriverSensor<D> sensor(bench.loop, {.name = "s", .rate = 1_Hz}, bench.bus, place, config);
      return sensor.status().reason;
    };
    const auto text = [](std::uint32_t number) { return to_string(I2cAddress(number)); };
    put_code(chip, identity.number, found, identity.size());
    const std::string refusal = failure(std::nullopt);
    const std::string its = "its identity is " + text(found) + ", ";
    const std::string usual = "that of " + with_article(known.name) + " is " + text(identity.value);
    CHECK_MESSAGE(refusal.find(its + usual) != std::string::npos, refusal);
    CHECK_MESSAGE(refusal.find("set `identity` to " + text(found)) != std::string::npos, refusal);
    CHECK(bench.log.empty());
    CHECK(failure(found).find("identity") == std::string::npos);  // it goes on, to what the chip is not
    REQUIRE(bench.log.size() == 1);
    CHECK(bench.log[0] == "sensor s: takes a chip of identity " + text(found) + " by the user's word, in place of " +
                              text(identity.value) + " of " + with_article(known.name));
    put_code(chip, identity.number, found, identity.size());  // settings of another bank may lie there
    const std::string against = failure(other);
    CHECK_MESSAGE(against.find(its + "`identity` says " + text(other) + " (" + usual + ")") != std::string::npos,
                  against);
    CHECK_MESSAGE(against.find(", and `identity`") != std::string::npos, against);
    // The known one is another one, too.
    put_code(chip, identity.number, identity.value, identity.size());
    CHECK(failure(found).find("remove `identity`") != std::string::npos);
    CHECK(failure(std::nullopt).find("its identity is") == std::string::npos);
    for (const unsigned nothing : {0x00u, 0xffu}) {  // what there is without a chip: no clone
      if (identity.is_of(nothing * 0x010101)) continue;
      put_code(chip, identity.number, nothing * 0x010101, identity.size());
      CHECK(failure(std::nullopt).find("its identity is ") != std::string::npos);
      CHECK(failure(std::nullopt).find("set `identity`") == std::string::npos);
    }
  }
}

std::string problems_of(const std::string& members) {
  return plan_system(standard_registry(),
                     parse_config(R"({"buses": {"b": {"type": "i2c", "device": "/dev/i2c-9"}}, "sensors": [
      {"name": "s", "rate": "10 Hz", "bus": "b", )" +
                                      members + "}]}",
                                  "f.json"))
      .problems.text();
}

std::vector<std::string> identities_in(const std::string& path) {
  std::vector<std::string> all;
  const Recording recording = Recording::open(path).or_throw();
  for (const RecordedConfiguration& one : recording.configurations(recording.runs().or_throw().back().run).or_throw())
    if (one.object == "identity of sensor imu") all.push_back(one.text);
  return all;
}

using ImuOnBench = DriverSensor<Imu>;
constexpr const char* by_word = "0x98 by the user's word, in place of 0x68 of an MPU-6050";

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE(
      "US-27 every driver refuses a chip of another identity, and takes it by the user's word and only this one") {
    try_identities<Accelerometer>();
    try_identities<Barometer>();
    try_identities<Bme680>();
    try_identities<Bno055>();
    try_identities<Imu>();
    try_identities<Ina>();
    try_identities<Ina3221>();
    try_identities<Magnetometer>();
    try_identities<Nau7802>();
    // No driver has been left out here that states an identity.
    std::size_t count = 0;
    for (const TypeInfo& type : standard_registry().sensors().types()) {
      const bool states_one = std::any_of(type.page.chips.begin(), type.page.chips.end(),
                                          [](const KnownChip& chip) { return chip.identity.has_value(); });
      const bool has_parameter = std::any_of(type.parameters.begin(), type.parameters.end(),
                                             [](const ParameterInfo& one) { return one.key == "identity"; });
      CHECK_MESSAGE(states_one == has_parameter, type.name);
      count += states_one ? 1 : 0;
    }
    CHECK(count == 9);
  }

  TEST_CASE("US-17 US-27 an identity is a text or a number with the bits of the chip's; others have none") {
    const std::string imu = R"("type": "imu", "identity": )";
    for (const char* good : {"\"0x98\"", "152", "\"152\"", "\"0X98\"", "\"0x0098\"", "0", "255", "\"0xff\"", "null"})
      CHECK_MESSAGE(problems_of(imu + good).empty(), good << problems_of(imu + good));
    const auto refused = [](const std::string& members, const char* why) {
      const std::string problems = problems_of(members);
      CHECK_MESSAGE(problems.find(why) != std::string::npos, members << " -> " << problems);
    };
    for (const char* bad :
         {"\"\"", "\"0x\"", "\"0x9g\"", "\"MPU\"", "\" 0x98\"", "\"-1\"", "\"0x98 \"", "\"98h\"", "\"0x1ffffffff\""})
      refused(imu + bad, "is not an identity: write it as \"0x98\"");
    for (const char* bad : {"-1", "3.5", "true", "[152]", "{}", "1e30"}) refused(imu + bad, "sensors[0].identity");
    refused(imu + "256", "0x100 has bits outside the identity of an MPU-6050, which has the bits 0xff");
    refused(imu + "16777216", "0x1000000 is larger than the identity of any chip");
    refused(R"("type": "nau7802", "identity": "0x1f")", "which has the bits 0x0f");
    refused(R"("type": "ina", "model": "ina226", "identity": "0x2261")", "which has the bits 0xfff0");
    CHECK(problems_of(R"("type": "ina", "model": "ina226", "identity": "0x2270")").empty());
    CHECK(problems_of(R"("type": "magnetometer", "model": "hmc5883l", "identity": "0x483434")").empty());
    refused(R"("type": "ina", "identity": "0x2260")", "the INA219 has no identity register; remove it");
    refused(R"("type": "barometer", "model": "ms5611", "identity": 88)",
            "the MS5611 has no identity register; remove it");
    refused(R"("type": "lm75", "identity": "0x98")", "unknown key");
    IdentityBench bench;
    CHECK_THROWS_WITH_AS(DriverSensor<Barometer>(bench.loop, {.name = "a", .rate = 1_Hz}, bench.bus, {0x77},
                                                 {.model = BarometerModel::ms5611, .identity = 0x58}),
                         doctest::Contains("the MS5611 has no identity register"), SetupError);
  }

  TEST_CASE(
      "US-27 a chip of a maker that is not known is taken by the user's word, and told, with a known identity too") {
    IdentityBench bench;
    FakeI2cChip& chip = bench.wires->chip(0x40);
    chip.set_width(FakeI2cChip::Width::words);
    chip.set_word(0xfe, 0x1234);
    chip.set_word(0xff, 0x2260);
    chip.set_word(6, 0x0008);
    DriverSensor<Ina> a(bench.loop, {.name = "a", .rate = 10_Hz}, bench.bus, {0x40}, {.model = InaModel::ina226});
    REQUIRE_FALSE(bench.errors.empty());
    CHECK(bench.told("its maker is 0x1234, not Texas Instruments (0x5449)"));
    CHECK(bench.told("set `identity` to 0x2260"));
    a.close();
    DriverSensor<Ina> b(bench.loop, {.name = "b", .rate = 10_Hz}, bench.bus, {0x40},
                        {.model = InaModel::ina226, .identity = 0x2260});
    bench.loop.advance(1s);
    CHECK(b.counts().published >= 9);
    REQUIRE(bench.log.size() == 1);
    CHECK(bench.log[0] == "sensor b: takes a chip of identity 0x2260 by the user's word, which is that of an INA226");
  }

  TEST_CASE("US-27 two chips of a model: the word is for one of them; a swapped chip is refused while it runs") {
    IdentityBench bench;
    for (const unsigned address : {0x68u, 0x69u}) bench.wires->chip(address).set(0x75, {0x98});
    const SensorConfig imu{.name = "imu", .rate = 10_Hz, .retry_first = 100ms, .retry_longest = 100ms};
    ImuOnBench first(bench.loop, imu, bench.bus, {0x68}, {.identity = 0x98});
    CHECK(first.health() == Health::ok);
    ImuOnBench second(bench.loop, {.name = "second", .rate = 10_Hz}, bench.bus, {0x69});
    CHECK(second.health() == Health::faulted);
    CHECK(
        bench.told("its identity is 0x98, that of an MPU-6050 is 0x68: check which chip is at this address, and "
                   "`model`; if it is a clone that you trust, set `identity` to 0x98"));
    second.close();
    FakeI2cChip& chip = bench.wires->chip(0x68);
    const auto swap = [&](std::uint8_t identity) {
      chip.unplug();
      bench.loop.advance(500ms);
      CHECK(first.health() == Health::faulted);
      chip.set(0x75, {identity});
      chip.plug_in();
      bench.loop.advance(500ms);
      return first.status().reason;
    };
    CHECK(swap(0x68).find(
              "its identity is 0x68, `identity` says 0x98 (that of an MPU-6050 is 0x68): remove `identity`") !=
          std::string::npos);
    CHECK(swap(0x71).find("it seems to be an MPU-9250: set `model`, and remove `identity`") != std::string::npos);
    CHECK(swap(0x99).find("check which chip is at this address, and `model`, and `identity`") != std::string::npos);
    swap(0x98);
    CHECK(first.health() == Health::ok);
    // Between two reads, without one that fails: the settings are gone, and the chip is looked at before it is set up.
    chip.set(0x75, {0x71});
    chip.set(0x6a, {0});
    bench.loop.advance(500ms);
    CHECK(first.health() == Health::faulted);
    CHECK(first.status().reason.find("its identity is 0x71, `identity` says 0x98") != std::string::npos);
    CHECK(chip.get(0x6a) == 0);
    chip.set(0x75, {0x98});
    bench.loop.advance(500ms);
    CHECK(first.health() == Health::ok);
    CHECK(bench.log.front() == std::string("sensor imu: takes a chip of identity ") + by_word);
    first.stop();
    CHECK(first.counts().balances());
  }

  TEST_CASE("US-26 US-27 a recording says that an identity was taken by the user's word, from when to when") {
    ScratchDirectory folder;
    const std::string path = folder.file("run.db"), later = folder.file("later.db"), tier = folder.file("tier.db");
    {
      IdentityBench bench;
      bench.wires->chip(0x68).set(0x75, {0x98});
      const SensorConfig imu{.name = "imu", .rate = 10_Hz};
      SqliteSink sink(bench.loop, {.path = path});
      ImuOnBench sensor(bench.loop, imu, bench.bus, {0x68}, {.identity = 0x98});
      bench.loop.advance(1s);
      SqliteSink late(bench.loop, {.path = later});
      bench.loop.advance(1s);
      late.close();
      bench.loop.advance(1s);
      sensor.close();
      bench.wires->chip(0x68).set(0x75, {0x68});
      sensor = ImuOnBench(bench.loop, imu, bench.bus, {0x68});
      bench.loop.advance(1s);
      bench.loop.close();
    }
    CHECK(identities_in(path) == std::vector<std::string>{by_word, ""});
    CHECK(identities_in(later) == std::vector<std::string>{by_word});
    {
      IdentityBench bench;
      bench.wires->chip(0x68).set(0x75, {0x98});
      Tier fast(bench.loop, {.name = "fast"});
      ImuOnBench sensor(fast.loop(), {.name = "imu", .rate = 10_Hz}, bench.bus, {0x68}, {.identity = 0x98});
      bench.loop.advance(1s);
      SqliteSink sink(bench.loop, {.path = tier});
      bench.loop.advance(1s);
      bench.loop.close();
      CHECK(bench.log == std::vector<std::string>{std::string("sensor imu: takes a chip of identity ") + by_word});
    }
    CHECK(identities_in(tier) == std::vector<std::string>{by_word});
  }
}
