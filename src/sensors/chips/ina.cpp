// Texas Instruments INA219, SBOS448G: 8.6.2 configuration, 8.6.3.1 shunt voltage, 8.6.3.2 bus voltage. INA226,
// SBOS547A: 7.6.1 configuration, 7.6.2 shunt voltage, 7.6.3 bus voltage, 7.6.9 and 7.6.10 identity.
#include "rtdata/sensors/ina.hpp"

#include <cmath>
#include <string>

namespace rtdata {
namespace {

constexpr std::uint8_t configuration_register = 0x00, shunt_register = 0x01, bus_register = 0x02;
constexpr std::uint8_t maker_register = 0xfe, die_register = 0xff;
constexpr const char* what = "cannot read the power monitor";

struct Model {
  const char* name;
  std::uint16_t configuration;
  double shunt_step, bus_step;  // V
  unsigned bus_shift;
  int shunt_range;  // codes beyond it are none
  bool has_identity;
};
constexpr Model models[] = {
    // 32 V, 320 mV, 12 bits in 532 us, both inputs again and again
    {"INA219", 0x399f, 10e-6, 4e-3, 3, 32000, false},
    // no average, 1.1 ms each, both inputs again and again
    {"INA226", 0x4127, 2.5e-6, 1.25e-3, 0, 32767, true},
};
const Model& of(InaModel model) noexcept { return models[static_cast<std::size_t>(model)]; }

}  // namespace

Ina::Ina(const Config& config) : config_(config) {
  if (!(config.shunt_resistance > 0) || !std::isfinite(config.shunt_resistance))
    throw SetupError({Errc::bad_argument, "cannot use this shunt", "shunt_resistance",
                      std::to_string(config.shunt_resistance) + " is not above 0", ""});
}

Result<void> Ina::open(I2cDevice& chip) {
  const Model& model = of(config_.model);
  if (model.has_identity) {
    const Result<std::uint16_t> maker = chip.read_word(maker_register);
    if (!maker) return maker.error();
    const Result<std::uint16_t> die = chip.read_word(die_register);
    if (!die) return die.error();
    if (*maker != 0x5449 || (*die & 0xfff0) != 0x2260)
      return chip.error(Errc::bad_data, std::string("cannot use the chip as an ") + model.name,
                        "it does not have its identity", "look at which chip is at this address, and `model`");
  }
  return chip.write_word(configuration_register, model.configuration);
}

Reading<PowerReading> Ina::read(I2cDevice& chip) {
  const Result<std::uint16_t> configuration = chip.read_word(configuration_register);
  if (!configuration) return configuration.error();
  if (*configuration != of(config_.model).configuration) {
    if (auto done = chip.write_word(configuration_register, of(config_.model).configuration); !done)
      return std::move(done).error();
    return Unreadable{chip.error(Errc::bad_data, what, "it has lost its settings", "look at its supply, and `model`")};
  }
  const Result<std::uint16_t> shunt = chip.read_word(shunt_register);
  if (!shunt) return shunt.error();
  const Result<std::uint16_t> bus = chip.read_word(bus_register);
  if (!bus) return bus.error();
  auto reading = decode(*shunt, *bus, config_);
  if (!reading) return Unreadable{chip.error(Errc::out_of_range, what, reading.error().why, reading.error().advice)};
  return *reading;
}

Result<PowerReading> Ina::decode(std::uint16_t shunt, std::uint16_t bus, const Config& config) {
  const Model& model = of(config.model);
  const int code = static_cast<std::int16_t>(shunt);
  if (std::abs(code) >= model.shunt_range)
    return Error{Errc::out_of_range, what, "", "the current is beyond what it can measure", "a smaller shunt"};
  const double current = code * model.shunt_step / config.shunt_resistance;
  const double voltage = (bus >> model.bus_shift) * model.bus_step;
  return PowerReading{voltage, current, voltage * current};
}

}  // namespace rtdata
