/// Ina: voltage, current and power by an INA219 or INA226 of Texas Instruments on I2C.
///
///     rtdata::DriverSensor<rtdata::Ina> battery(loop, {.name = "battery", .rate = 10_Hz}, bus, {.address = 0x40},
///                                               {.model = InaModel::ina219, .shunt_resistance = 0.1});
///
/// The chip measures by itself, some 900 times a second (INA219) or 450 times (INA226, both inputs); a tick reads the
/// last of each. A tick before the next measurement is ready is counted as repeated; no measurement for a second is an
/// error. The current is the shunt voltage divided by `shunt_resistance`, the power is current times bus voltage; the
/// chip's own results, which have fewer bits, are not used. A reading is unreadable if a voltage is out of the chip's
/// range (shunt: INA219 0.32 V, INA226 0.08 V; bus: 32 V and 40.96 V, of which only 26 and 36 V are allowed) or if the
/// chip reports an overflow. Addresses: 0x40 to 0x4f. The INA226 has an identity, which is checked; a chip that has
/// lost its settings is reported as unreadable and set up again. After a reset, the settings are those that are used.
///
/// Sources: Texas Instruments INA219, SBOS448G: 8.6.2 configuration, 8.6.3.1 shunt voltage, 8.6.3.2 bus voltage,
/// conversion ready and overflow. INA226, SBOS547A: 7.6.1 configuration, 7.6.2 shunt voltage, 7.6.3 bus voltage, 7.6.7
/// conversion ready and overflow, 7.6.9 and 7.6.10 identity.
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <cmath>
#include <cstdint>
#include <string>
#include <string_view>

#include "rtdata/data/describe.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

struct PowerReading {
  double voltage = 0;  ///< at the load
  double current = 0;  ///< positive towards the load
  double power = 0;
  friend constexpr auto describe(type_tag<PowerReading>) {
    return record("power", field("voltage", &PowerReading::voltage, "V"), field("current", &PowerReading::current, "A"),
                  field("power", &PowerReading::power, "W"));
  }
};

enum class InaModel { ina219, ina226 };

class Ina {
 public:
  static constexpr std::string_view type = "ina";
  static constexpr std::string_view aliases = "wattmeter";
  static constexpr std::string_view description = "voltage, current and power by an INA219 or INA226 on I2C";
  static constexpr std::string_view notes = R"(
- Addresses 0x40 to 0x4f by the pins A0 and A1.
- The shunt lies between IN+ and IN-. Most boards have one of 0.1 Ohm: to 3.2 A (INA226: 0.8 A). The bus may have up to
  26 V (INA226: 36 V).
- Beyond the range of shunt or bus there is no value: it is counted as unreadable.
- It measures some 900 times a second (INA226: 450). A reading before the chip has measured anew is counted as repeated.
)";
  struct Config {
    InaModel model = InaModel::ina219;
    double shunt_resistance = 0.1;  ///< Ohm
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(parameter("model", &Config::model, "which chip it is",
                                      choices(value("ina219", InaModel::ina219), value("ina226", InaModel::ina226))),
                            parameter("shunt_resistance", &Config::shunt_resistance, "of the shunt: 0.1 on most boards",
                                      unit("Ohm"), range(1e-6, 1e3)));
    }
  };
  using Value = PowerReading;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x40};
  static constexpr KnownChip chips[] = {
      {.name = "INA219", .model = "ina219", .addresses = {0x40, 0x41, 0x42, 0x43, 0x44, 0x45, 0x46, 0x47}},
      {.name = "INA226", .model = "ina226", .addresses = {0x40, 0x41, 0x42, 0x43, 0x44, 0x45, 0x46, 0x47}}};
  // 80 mV at the shunt, 16 V, and a new measurement.
  static constexpr ChipSample samples[] = {{.wires = ChipWires::word_registers,
                                            .bytes = {{{"01", "1f 40"}, {"02", "7d 02"}}},
                                            .values = {{{"voltage", 16}, {"current", 0.8}, {"power", 12.8}}},
                                            .has_proof = true}};

  static Result<void> check(const Config& config) {
    if (config.shunt_resistance > 0 && std::isfinite(config.shunt_resistance)) return {};
    return Error{Errc::bad_argument, "cannot use this shunt", "shunt_resistance",
                 std::to_string(config.shunt_resistance) + " is not above 0", ""};
  }
  explicit Ina(const Config& config) : config_(config) {}

  Result<void> open(I2cDevice& chip) {
    if (config_.model == InaModel::ina226) {
      const Result<std::uint16_t> maker = chip.read_word(maker_register);
      if (!maker) return maker.error();
      const Result<std::uint16_t> die = chip.read_word(die_register);
      if (!die) return die.error();
      if (*maker != 0x5449 || (*die & 0xfff0) != 0x2260)
        return chip.error(Errc::bad_data, "cannot use the chip as an INA226",
                          "it does not answer with the identity of that chip",
                          "check which chip is at this address, and `model`");
    }
    last_ = Samples<PowerReading>::now();
    return chip.write_word(settings_register, of(config_.model).settings);
  }

  Reading<PowerReading> read(I2cDevice& chip) {
    const Result<std::uint16_t> settings = chip.read_word(settings_register);
    if (!settings) return settings.error();
    if (*settings != of(config_.model).settings) {
      if (auto done = open(chip); !done) return std::move(done).error();
      return Unreadable{
          chip.error(Errc::bad_data, what, "it has lost its settings, and is set up again", "check its supply")};
    }
    const bool is_ina219 = config_.model == InaModel::ina219;
    const Result<std::uint16_t> flags = chip.read_word(is_ina219 ? bus_register : mask_register);
    if (!flags) return flags.error();
    const MonotonicTime now = Samples<PowerReading>::now();
    if ((*flags & (is_ina219 ? ina219_ready : ina226_ready)) == 0) {
      if (now - last_ > std::chrono::seconds{1})
        return chip.error(Errc::timed_out, what, "it has stopped measuring", "check its supply, and `model`");
      return nothing_new;
    }
    last_ = now;
    const Result<std::uint16_t> shunt = chip.read_word(shunt_register);
    if (!shunt) return shunt.error();
    const Result<std::uint16_t> bus = is_ina219 ? *flags : chip.read_word(bus_register);
    if (!bus) return bus.error();
    if (is_ina219) {  // reading this register clears the ready flag
      if (const Result<std::uint16_t> power = chip.read_word(power_register); !power) return power.error();
    }
    const bool has_overflowed = (*flags & (is_ina219 ? ina219_overflow : ina226_overflow)) != 0;
    auto reading = has_overflowed ? Error{Errc::out_of_range, what, "", "it reports an overflow", "a smaller shunt"}
                                  : decode(*shunt, *bus, config_);
    if (!reading) return Unreadable{chip.error(Errc::out_of_range, what, reading.error().why, reading.error().advice)};
    return *reading;
  }

  /// `shunt`, `bus`: the registers of shunt voltage and bus voltage. Errors: out-of-range.
  static Result<PowerReading> decode(std::uint16_t shunt, std::uint16_t bus, const Config& config) {
    const Model& model = of(config.model);
    const int code = static_cast<std::int16_t>(shunt);
    if (code >= model.shunt_end || code <= -model.shunt_end)
      return Error{Errc::out_of_range, what, "", "the current is beyond what it can measure", "a smaller shunt"};
    const int bus_code = bus >> model.bus_shift;
    if (bus_code >= model.bus_end)
      return Error{Errc::out_of_range, what, "", "the voltage of the bus is beyond what it can measure",
                   "check its wires"};
    const double current = code * model.shunt_step / config.shunt_resistance;
    const double voltage = bus_code * model.bus_step;
    return PowerReading{voltage, current, voltage * current};
  }

 private:
  struct Model {
    std::uint16_t settings;
    double shunt_step, bus_step;  // V
    unsigned bus_shift;
    int shunt_end, bus_end;  // codes from here on are invalid
  };
  static const Model& of(InaModel model) noexcept {
    static constexpr Model models[] = {
        // 32 V, 320 mV, 12 bits in 532 us, both inputs again and again
        {0x399f, 10e-6, 4e-3, 3, 32000, 8000},
        // no average, 1.1 ms each, both inputs again and again
        {0x4127, 2.5e-6, 1.25e-3, 0, 32767, 32767},
    };
    return models[static_cast<std::size_t>(model)];
  }
  static constexpr std::uint8_t settings_register = 0x00, shunt_register = 0x01, bus_register = 0x02;
  static constexpr std::uint8_t power_register = 0x03, mask_register = 0x06;
  static constexpr std::uint8_t maker_register = 0xfe, die_register = 0xff;
  static constexpr std::uint16_t ina219_ready = 0x0002, ina219_overflow = 0x0001;  // of the bus voltage
  static constexpr std::uint16_t ina226_ready = 0x0008, ina226_overflow = 0x0004;  // of the mask
  static constexpr const char* what = "cannot read the power monitor";

  Config config_;
  MonotonicTime last_{};
};

}  // namespace rtdata
