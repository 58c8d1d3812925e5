/// Ina: voltage, current and power by an INA219, INA226 or INA228 of Texas Instruments on I2C.
///
///     rtdata::DriverSensor<rtdata::Ina> battery(loop, {.name = "battery", .rate = 10_Hz}, bus, {.address = 0x40},
///                                               {.model = rtdata::InaModel::ina219, .shunt_resistance = 0.1});
///
/// The chip measures by itself, some 900 times a second (INA219) or 450 times (INA226, INA228, both inputs); a tick
/// reads the last of each. A tick before the next measurement is ready is counted as repeated; no measurement for a
/// second is an error. The current is the shunt voltage divided by `shunt_resistance`, the power is current times bus
/// voltage; the chip's own results are not used. A reading is unreadable if a voltage is out of the chip's range
/// (shunt: INA219 0.32 V, INA226 0.08 V, INA228 0.16 V; bus: 32 V, 40.96 V and 102.4 V, of which only 26, 36 and 85 V
/// are allowed) or if the chip reports an overflow, an INA228 damage of its own trimming. Addresses: 0x40 to 0x4f.
/// INA226 and INA228 have an identity, which is checked; a chip that has lost its settings is reported as unreadable
/// and set up again. After a reset, the settings of an INA219 and an INA226 are those that are used.
///
/// Sources: Texas Instruments INA219, SBOS448G: 8.6.2 configuration, 8.6.3.1 shunt voltage, 8.6.3.2 bus voltage,
/// conversion ready and overflow. INA226, SBOS547A: 7.6.1 configuration, 7.6.2 shunt voltage, 7.6.3 bus voltage, 7.6.7
/// conversion ready and overflow, 7.6.9 and 7.6.10 identity. INA228, SLYS021A: 7.6.1.1 and 7.6.1.2 configuration,
/// 7.6.1.5 shunt voltage, 7.6.1.6 bus voltage, 7.6.1.12 conversion complete and state of the memory, 7.6.1.19 and
/// 7.6.1.20 identity.
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <span>
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

enum class InaModel { ina219, ina226, ina228 };

class Ina {
 public:
  static constexpr std::string_view type = "ina";
  static constexpr std::string_view aliases = "wattmeter";
  static constexpr std::string_view description = "voltage, current and power by an INA219, INA226 or INA228 on I2C";
  static constexpr std::string_view notes = R"(
- Addresses 0x40 to 0x4f by the pins A0 and A1.
- The shunt lies between IN+ and IN-. Most boards with an INA219 or INA226 have one of 0.1 Ohm: to 3.2 A (INA226: 0.8 A);
  those with an INA228 mostly 0.015 Ohm: to 10.9 A. The bus may have up to 26 V (INA226: 36 V; INA228: 85 V).
- Beyond the range of shunt or bus there is no value: it is counted as unreadable.
- It measures some 900 times a second (INA226, INA228: 450). A reading before the next measurement is counted as
  repeated.
)";
  struct Config {
    InaModel model = InaModel::ina219;
    double shunt_resistance = 0.1;           ///< Ohm
    std::optional<IdentityCode> identity{};  ///< of a clone of an INA226 or INA228
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(parameter("model", &Config::model, "which chip it is",
                                      choices(value("ina219", InaModel::ina219), value("ina226", InaModel::ina226),
                                              value("ina228", InaModel::ina228))),
                            parameter("shunt_resistance", &Config::shunt_resistance,
                                      "resistance of the shunt: 0.1 on most boards", unit("Ohm"), range(1e-6, 1e3)),
                            identity_parameter(&Config::identity));
    }
  };
  using Value = PowerReading;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x40};
  static constexpr KnownChip chips[] = {
      {.name = "INA219", .model = "ina219", .addresses = {0x40, 0x41, 0x42, 0x43, 0x44, 0x45, 0x46, 0x47}},
      {.name = "INA226",
       .model = "ina226",
       .addresses = {0x40, 0x41, 0x42, 0x43, 0x44, 0x45, 0x46, 0x47},
       .identity = {{0xff, 0x2260, 0xfff0}}},
      {.name = "INA228",
       .model = "ina228",
       .addresses = {0x40, 0x41, 0x42, 0x43, 0x44, 0x45, 0x46, 0x47},
       .identity = {{0x3f, 0x2280, 0xfff0}}}};  // without the revision
  // 80 mV at the shunt, 16 V, and a new measurement; of an INA228 100 mV and 48 V.
  static constexpr ChipSample samples[] = {{.wires = ChipWires::word_registers,
                                            .bytes = {{{"01", "1f 40"}, {"02", "7d 02"}}},
                                            .values = {{{"voltage", 16}, {"current", 0.8}, {"power", 12.8}}},
                                            .has_proof = true},
                                           {.members = R"("model": "ina228", "shunt_resistance": 0.01)",
                                            .wires = ChipWires::word_registers,
                                            .bytes = {{{"04", "4e 20 00", 0, true},
                                                       {"05", "3c 00 00", 0, true},
                                                       {"0b", "80 03", 0, true},
                                                       {"3e", "54 49"},
                                                       {"3f", "22 81"}}},
                                            .values = {{{"voltage", 48}, {"current", 10}, {"power", 480}}},
                                            .has_proof = true}};

  static Result<void> check(const Config& config) {
    if (config.shunt_resistance > 0 && std::isfinite(config.shunt_resistance)) return {};
    return Error{Errc::bad_argument, "cannot use this shunt", "shunt_resistance",
                 std::to_string(config.shunt_resistance) + " is not above 0", ""};
  }
  explicit Ina(const Config& config) : config_(config) {}

  Result<void> open(I2cDevice& chip) {
    const Model& model = of(config_.model);
    if (auto same = check_identity(chip, known_chip<Ina>(config_), config_.identity, chips,
                                   "check which chip is at this address, and `model`");
        !same)
      return same;
    if (model.maker_register != 0 && !config_.identity) {
      if (auto made = check_maker(chip, model.maker_register, known_chip<Ina>(config_)); !made) return made;
    }
    last_ = Samples<PowerReading>::now();
    for (const Setting& one : model.before)
      if (auto done = chip.write_word(one.number, one.value); !done) return done;
    return chip.write_word(model.settings.number, model.settings.value);
  }

  Reading<PowerReading> read(I2cDevice& chip) {
    const Model& model = of(config_.model);
    const Result<std::uint16_t> settings = chip.read_word(model.settings.number);
    if (!settings) return settings.error();
    if (*settings != model.settings.value) {
      if (auto done = open(chip); !done) return std::move(done).error();
      return Unreadable{
          chip.error(Errc::bad_data, what, "it has lost its settings, and is set up again", "check its supply")};
    }
    const Result<std::uint16_t> flags = chip.read_word(model.flags_register);
    if (!flags) return flags.error();
    if ((*flags & model.intact) != model.intact)
      return Unreadable{
          chip.error(Errc::bad_data, what, "the checksum of its trimming values is wrong", "use another chip")};
    const MonotonicTime now = Samples<PowerReading>::now();
    if ((*flags & model.ready) == 0) {
      if (now - last_ > std::chrono::seconds{1})
        return chip.error(Errc::timed_out, what, "it has stopped measuring", "check its supply, and `model`");
      return nothing_new;
    }
    last_ = now;
    const Result<std::uint32_t> shunt = result(chip, model.shunt_register);
    if (!shunt) return shunt.error();
    const Result<std::uint32_t> bus = model.flags_register == model.bus_register ? Result<std::uint32_t>(*flags)
                                                                                 : result(chip, model.bus_register);
    if (!bus) return bus.error();
    if (config_.model == InaModel::ina219) {  // reading this register clears the ready flag
      if (const Result<std::uint16_t> power = chip.read_word(power_register); !power) return power.error();
    }
    auto reading = (*flags & model.overflow) != 0
                       ? Error{Errc::out_of_range, what, "", "it reports an overflow", "use a smaller shunt"}
                       : decode(*shunt, *bus, config_);
    if (!reading) return Unreadable{chip.error(Errc::out_of_range, what, reading.error().why, reading.error().advice)};
    return *reading;
  }

  /// Refuses a chip that Texas Instruments has not made. A clone that the user trusts may have any maker.
  static Result<void> check_maker(I2cDevice& chip, std::uint8_t maker_register, const KnownChip& known) {
    constexpr std::uint16_t texas_instruments = 0x5449;
    const Result<std::uint16_t> maker = chip.read_word(maker_register);
    if (!maker) return maker.error();
    if (*maker == texas_instruments) return {};
    return chip.error(Errc::bad_data, "cannot use the chip as " + with_article(known.name),
                      "its maker is " + to_string(I2cAddress(*maker)) + ", not Texas Instruments (0x5449)",
                      "check which chip is at this address; if it is a clone that you trust, set `identity` to " +
                          to_string(I2cAddress(known.identity->value)));
  }

  /// `shunt`, `bus`: the registers of shunt voltage and bus voltage. Errors: out-of-range.
  static Result<PowerReading> decode(std::uint32_t shunt, std::uint32_t bus, const Config& config) {
    const Model& model = of(config.model);
    const int code = static_cast<std::int32_t>(shunt << (32 - model.bits)) >> (32 - model.bits + model.shunt_shift);
    if (code >= model.shunt_end || code <= -model.shunt_end)
      return Error{Errc::out_of_range, what, "", "the current is larger than the chip can measure",
                   "use a smaller shunt"};
    const int bus_code = static_cast<int>(bus >> model.bus_shift);
    if (bus_code >= model.bus_end)
      return Error{Errc::out_of_range, what, "", "the bus voltage is higher than the chip can measure",
                   "check its wires"};
    const double current = code * model.shunt_step / config.shunt_resistance;
    const double voltage = bus_code * model.bus_step;
    return PowerReading{voltage, current, voltage * current};
  }

 private:
  struct Setting {
    std::uint8_t number;
    std::uint16_t value;
  };
  struct Model {
    std::span<const Setting> before;  // that are written before `settings`, and not read back
    Setting settings;
    std::uint8_t shunt_register, bus_register, flags_register;
    std::uint16_t ready, overflow, intact;  // flags
    unsigned bits;                          // of the registers of results
    unsigned shunt_shift, bus_shift;
    double shunt_step, bus_step;  // V
    int shunt_end, bus_end;       // codes from here on are invalid
    std::uint8_t maker_register = 0;
  };
  static const Model& of(InaModel model) noexcept {
    // The widest range at the shunt. A flag is kept until it is read.
    static constexpr Setting before_ina228[] = {{0x00, 0x0000}, {0x0b, 0x8001}};
    static constexpr Model models[] = {
        // 32 V, 320 mV, 12 bits in 532 us, both inputs again and again
        {{}, {0x00, 0x399f}, 0x01, 0x02, 0x02, 0x0002, 0x0001, 0, 16, 0, 3, 10e-6, 4e-3, 32000, 8000},
        // no average, 1.1 ms each, both inputs again and again
        {{}, {0x00, 0x4127}, 0x01, 0x02, 0x06, 0x0008, 0x0004, 0, 16, 0, 0, 2.5e-6, 1.25e-3, 32767, 32767, 0xfe},
        // the same
        {before_ina228,
         {0x01, 0xbb68},
         0x04,
         0x05,
         0x0b,
         0x0002,
         0,
         0x0001,
         24,
         4,
         4,
         312.5e-9,
         195.3125e-6,
         0x7ffff,
         0x7ffff,
         0x3e},
    };
    return models[static_cast<std::size_t>(model)];
  }
  Result<std::uint32_t> result(I2cDevice& chip, std::uint8_t number) const {
    std::array<std::uint8_t, 3> bytes{};
    const auto used = std::span(bytes).first(of(config_.model).bits / 8);
    if (auto done = chip.read_registers(number, used); !done) return std::move(done).error();
    std::uint32_t value = 0;
    for (const std::uint8_t byte : used) value = value << 8 | byte;
    return value;
  }
  static constexpr std::uint8_t power_register = 0x03;
  static constexpr const char* what = "cannot read the power monitor";

  Config config_;
  MonotonicTime last_{};
};

}  // namespace rtdata
