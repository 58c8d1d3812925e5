// A driver of one's own for a chip on I2C: one class of plain blocking code, tried on a bus that is made of memory.
// With `rtdata::I2cBus bus({.device = "/dev/i2c-1"})` it reads the chip.
#include "rtdata/config/system.hpp"
#include "rtdata/sensors/driver.hpp"
#include "rtdata/testing/fake_i2c.hpp"

using namespace rtdata::literals;

struct Light {
  double illuminance = 0;
  RTDATA_FIELDS(Light, (illuminance, "lx"))
};

/// ROHM BH1750FVI, data sheet of 2014: one measurement for each tick. All calls are on the bus's lane.
class Bh1750 {
 public:
  static constexpr std::string_view type = "bh1750";
  static constexpr std::string_view description = "illuminance by a BH1750 on I2C";
  struct Config {
    double window = 1;  ///< what the glass in front of it lets through
    friend constexpr auto parameters(rtdata::type_tag<Config>) {
      return rtdata::parameter_list(rtdata::parameter(
          "window", &Config::window, "share of the light that reaches the chip", rtdata::range(0.01, 1.0)));
    }
  };
  using Value = Light;
  using Device = rtdata::I2cDevice;
  static constexpr Device::Place place{0x23};
  static constexpr rtdata::KnownChip chips[] = {{.name = "BH1750", .addresses = {0x23, 0x5c}}};  // for `rtdata scan`
  // For tests of all drivers: the data sheet's example.
  static constexpr rtdata::ChipSample samples[] = {
      {.wires = rtdata::ChipWires::answers, .bytes = {{{"20", "83 90"}}}, .values = {{{"illuminance", 28066.7}}}}};
  explicit Bh1750(const Config& config) : config_(config) {}

  rtdata::Result<void> start(Device& chip) {
    const std::uint8_t high_resolution_once = 0x20;
    return chip.write({&high_resolution_once, 1});
  }
  rtdata::Duration conversion_time() const { return 180ms; }  // the bus is free for others meanwhile
  rtdata::Result<Light> read(Device& chip) {
    std::array<std::uint8_t, 2> bytes{};
    if (auto done = chip.read(bytes); !done) return done.error();
    return decode(bytes, config_);
  }
  static Light decode(std::array<std::uint8_t, 2> bytes, const Config& config) {
    return {(bytes[0] << 8 | bytes[1]) / 1.2 / config.window};
  }

 private:
  Config config_;
};

int main() {
  rtdata::Registry registry;  // the program `rtdata` with it: examples/06_own_types_in_json.cpp
  registry.add_bus<rtdata::I2cConfig>(
      "i2c", "a bus of memory", [](rtdata::Runtime&, const std::string& name, const rtdata::I2cConfig& config) {
        auto wires = std::make_shared<rtdata::FakeI2c>();
        wires->chip(0x23).set(0x20, {0x83, 0x90});  // the data sheet's example: 28067 lx
        return rtdata::I2cBus(name, wires, config);
      });
  registry.add_driver<Bh1750>();
  rtdata::Loop loop{rtdata::Loop::Manual{}};  // virtual time: an hour in no time
  rtdata::System system(loop, registry, rtdata::parse_config(R"({"buses": {"i2c1": {"type": "i2c", "device": "none"}},
      "sensors": [{"name": "window", "type": "bh1750", "bus": "i2c1", "rate": "1 Hz"}]})"));
  int good = 0;
  const auto check = loop.subscribe<Light>(
      "window", [&](const rtdata::Event<Light>& e) { good += e->illuminance > 28066 && e->illuminance < 28067; });
  loop.advance(1h);
  return good >= 3599 && loop.runtime().balances() ? 0 : 1;
}
