/// Ina3221: voltage, current and power at three places by an INA3221 of Texas Instruments on I2C.
///
///     rtdata::DriverSensor<rtdata::Ina3221> rails(loop, {.name = "rails", .rate = 10_Hz}, bus, {.address = 0x40},
///                                                 {.shunt_resistance_3 = 0.01});
///
/// The chip measures by itself, all six inputs some 150 times a second; a tick reads the last of each. A tick before
/// the next measurement is ready is counted as repeated; no measurement for a second is an error. Each current is the
/// shunt voltage divided by the resistance of its shunt, each power is current times bus voltage. A channel whose
/// voltages are out of the chip's range (shunt 0.1638 V, bus 32.76 V, of which only 26 V are allowed) has no value in
/// the event, and the reading is counted as unreadable. Addresses: 0x40 to 0x43. The identity is checked; a chip that
/// has lost its settings is reported as unreadable and set up again.
///
/// Source: Texas Instruments INA3221, SBOS576B: 8.6.2.1 configuration, 8.6.2.2 to 8.6.2.7 shunt and bus voltages,
/// 8.6.2.16 conversion ready, 8.6.2.19 and 8.6.2.20 identity.
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "rtdata/chips/ina.hpp"
#include "rtdata/data/describe.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

struct ThreePowersReading {
  std::optional<double> voltage_1{}, current_1{}, power_1{};  ///< at the load; positive towards it
  std::optional<double> voltage_2{}, current_2{}, power_2{};
  std::optional<double> voltage_3{}, current_3{}, power_3{};
  friend constexpr auto describe(type_tag<ThreePowersReading>) {
    using R = ThreePowersReading;
    return record("three_powers", field("voltage_1", &R::voltage_1, "V"), field("current_1", &R::current_1, "A"),
                  field("power_1", &R::power_1, "W"), field("voltage_2", &R::voltage_2, "V"),
                  field("current_2", &R::current_2, "A"), field("power_2", &R::power_2, "W"),
                  field("voltage_3", &R::voltage_3, "V"), field("current_3", &R::current_3, "A"),
                  field("power_3", &R::power_3, "W"));
  }
};

class Ina3221 {
 public:
  static constexpr std::string_view type = "ina3221";
  static constexpr std::string_view aliases = "wattmeter";
  static constexpr std::string_view description = "voltage, current and power at three places by an INA3221 on I2C";
  static constexpr std::string_view notes = R"(
- Address by the pin A0: to GND 0x40, supply 0x41, SDA 0x42, SCL 0x43.
- Each shunt lies between IN+ and IN- of its channel. Most boards have 0.1 Ohm: to 1.6 A. The buses may have up to 26 V.
- A channel beyond its range has no value, and the reading is counted as unreadable. An open channel reads as about 0.
- It measures all channels some 150 times a second. A reading before the next measurement is counted as repeated.
)";
  struct Config {
    double shunt_resistance_1 = 0.1, shunt_resistance_2 = 0.1, shunt_resistance_3 = 0.1;  ///< Ohm
    std::optional<IdentityCode> identity{};                                               ///< of a clone
    std::array<double, 3> shunt_resistances() const noexcept {
      return {shunt_resistance_1, shunt_resistance_2, shunt_resistance_3};
    }
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(
          parameter("shunt_resistance_1", &Config::shunt_resistance_1,
                    "resistance of the shunt of channel 1: 0.1 on most boards", unit("Ohm"), range(1e-6, 1e3)),
          parameter("shunt_resistance_2", &Config::shunt_resistance_2, "resistance of the shunt of channel 2",
                    unit("Ohm"), range(1e-6, 1e3)),
          parameter("shunt_resistance_3", &Config::shunt_resistance_3, "resistance of the shunt of channel 3",
                    unit("Ohm"), range(1e-6, 1e3)),
          identity_parameter(&Config::identity));
    }
  };
  using Value = ThreePowersReading;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x40};
  static constexpr KnownChip chips[] = {
      {.name = "INA3221", .addresses = {0x40, 0x41, 0x42, 0x43}, .identity = {{0xff, 0x3220, 0xffff}}}};
  // 80 mV and 12 V, -80 mV and 16 V, 40 uV and 8 mV; ready.
  static constexpr ChipSample samples[] = {
      {.members = R"("shunt_resistance_2": 0.01)",
       .wires = ChipWires::word_registers,
       .bytes = {{{"01", "3e 80 2e e0"},
                  {"03", "c1 80 3e 80"},
                  {"05", "00 08 00 08"},
                  {"0f", "00 01"},
                  {"fe", "54 49 32 20"}}},
       .values = {{{"voltage_1", 12}, {"current_1", 0.8}, {"power_2", -128}, {"current_3", 0.0004}}},
       .has_proof = true}};

  static Result<void> check(const Config& config) {
    const auto all = config.shunt_resistances();
    for (std::size_t i = 0; i < all.size(); ++i) {
      if (all[i] > 0 && std::isfinite(all[i])) continue;
      return Error{Errc::bad_argument, "cannot use this shunt", "shunt_resistance_" + std::to_string(i + 1),
                   std::to_string(all[i]) + " is not above 0", ""};
    }
    return {};
  }
  explicit Ina3221(const Config& config) : config_(config) {}

  Result<void> open(I2cDevice& chip) {
    if (auto same = check_identity(chip, chips[0], config_.identity); !same) return same;
    if (!config_.identity) {
      if (auto made = Ina::check_maker(chip, maker_register, chips[0]); !made) return made;
    }
    last_ = Samples<ThreePowersReading>::now();
    return chip.write_word(settings_register, settings);
  }

  Result<void> read(I2cDevice& chip, Samples<ThreePowersReading>& out) {
    const Result<std::uint16_t> kept = chip.read_word(settings_register);
    if (!kept) return kept.error();
    if (*kept != settings) {
      if (auto done = open(chip); !done) return done;
      out.unreadable(
          chip.error(Errc::bad_data, what, "it has lost its settings, and is set up again", "check its supply"));
      return {};
    }
    const Result<std::uint16_t> flags = chip.read_word(flags_register);
    if (!flags) return flags.error();
    const MonotonicTime now = Samples<ThreePowersReading>::now();
    if ((*flags & ready) == 0) {
      if (now - last_ > std::chrono::seconds{1})
        return chip.error(Errc::timed_out, what, "it has stopped measuring", "check its supply");
      return {};
    }
    last_ = now;
    ThreePowersReading reading;
    bool has_value = false;
    for (std::size_t i = 0; i < 3; ++i) {
      const Result<std::uint16_t> shunt = chip.read_word(static_cast<std::uint8_t>(first_shunt_register + 2 * i));
      if (!shunt) return shunt.error();
      const Result<std::uint16_t> bus = chip.read_word(static_cast<std::uint8_t>(first_shunt_register + 2 * i + 1));
      if (!bus) return bus.error();
      const auto one = decode(*shunt, *bus, config_.shunt_resistances()[i]);
      if (one) {
        put(reading, i, *one);
        has_value = true;
      } else {
        out.unreadable(chip.error(Errc::out_of_range, what, "channel " + std::to_string(i + 1) + ": " + one.error().why,
                                  one.error().advice));
      }
    }
    if (has_value) out.add(reading);
    return {};
  }

  /// `shunt`, `bus`: the registers of a channel. Errors: out-of-range.
  static Result<PowerReading> decode(std::uint16_t shunt, std::uint16_t bus, double shunt_resistance) {
    const int code = static_cast<std::int16_t>(shunt) >> 3;
    constexpr int end = 0x0fff;  // codes from here on are invalid
    if (code >= end || code <= -end)
      return Error{Errc::out_of_range, what, "", "the current is larger than the chip can measure",
                   "use a smaller shunt"};
    const int bus_code = bus >> 3;
    if (bus_code >= end)
      return Error{Errc::out_of_range, what, "", "the bus voltage is higher than the chip can measure",
                   "check its wires"};
    constexpr double shunt_step = 40e-6, bus_step = 8e-3;  // V
    const double current = code * shunt_step / shunt_resistance, voltage = bus_code * bus_step;
    return PowerReading{voltage, current, voltage * current};
  }

 private:
  static void put(ThreePowersReading& reading, std::size_t channel, const PowerReading& one) noexcept {
    using R = ThreePowersReading;
    constexpr std::optional<double> R::*fields[][3] = {{&R::voltage_1, &R::current_1, &R::power_1},
                                                       {&R::voltage_2, &R::current_2, &R::power_2},
                                                       {&R::voltage_3, &R::current_3, &R::power_3}};
    reading.*fields[channel][0] = one.voltage;
    reading.*fields[channel][1] = one.current;
    reading.*fields[channel][2] = one.power;
  }

  static constexpr std::uint8_t settings_register = 0x00, first_shunt_register = 0x01, flags_register = 0x0f;
  static constexpr std::uint8_t maker_register = 0xfe;
  static constexpr std::uint16_t settings = 0x7127;  // all channels, no average, 1.1 ms each, again and again
  static constexpr std::uint16_t ready = 0x0001;
  static constexpr const char* what = "cannot read the INA3221";

  Config config_;
  MonotonicTime last_{};
};

}  // namespace rtdata
