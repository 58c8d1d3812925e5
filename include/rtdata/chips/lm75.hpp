/// Lm75: a thermometer LM75, LM75A, LM75B, TMP75 or another of this family on I2C.
///
///     rtdata::DriverSensor<rtdata::Lm75> room(loop, {.name = "room", .rate = 1_Hz}, bus, {.address = 0x48});
///
/// Two bytes, -55 to 125 degrees, in steps of 0.5 (LM75) to 0.0625 (TMP75); values outside are unreadable. Addresses:
/// 0x48 to 0x4f. It measures by itself, some ten times a second. It has no identity and no checksum.
///
/// Sources: NXP LM75B, data sheet of 2015, 7.4.3 temperature register; TI TMP75, 8.5.1.
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "rtdata/data/describe.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

struct TemperatureReading {
  double temperature = 0;
  friend constexpr auto describe(type_tag<TemperatureReading>) {
    return record("temperature", field("temperature", &TemperatureReading::temperature, "Cel"));
  }
};

class Lm75 {
 public:
  static constexpr std::string_view type = "lm75";
  static constexpr std::string_view description = "temperature of an LM75, TMP75 or the like on I2C";
  static constexpr std::string_view notes = R"(
- Addresses `0x48` to `0x4f`, by what A0 to A2 are connected to. 2.8 to 5.5 V.
- -55 to 125 degrees, in steps of 0.5 (LM75) to 0.0625 (TMP75); values outside are unreadable.
- It measures by itself, some ten times a second; a reading takes the last value.
- It has no identity and no checksum: another chip at its address gives a wrong temperature.
)";
  struct Config {
    friend constexpr auto parameters(type_tag<Config>) { return parameter_list(); }
  };
  using Value = TemperatureReading;
  using Device = I2cDevice;
  static constexpr I2cDevice::Place place{0x48};
  static constexpr KnownChip chips[] = {
      {.name = "LM75, TMP75", .addresses = {0x48, 0x49, 0x4a, 0x4b, 0x4c, 0x4d, 0x4e, 0x4f}}};
  static constexpr ChipSample samples[] = {
      {.wires = ChipWires::word_registers, .bytes = {{{"00", "19 00"}}}, .values = {{{"temperature", 25}}}}};
  explicit Lm75(const Config&) {}

  Reading<TemperatureReading> read(I2cDevice& chip) {
    constexpr double least = -55, most = 125;
    const Result<std::uint16_t> word = chip.read_word(0x00);
    if (!word) return word.error();
    const double degrees = decode(*word);
    if (degrees < least || degrees > most) {
      return Unreadable{chip.error(Errc::out_of_range, "cannot read the LM75",
                                   std::to_string(degrees) + " degrees is outside its range, -55 to 125 degrees",
                                   "check its wires; check that it is an LM75")};
    }
    return TemperatureReading{degrees};
  }
  /// Degrees Celsius of the register's word.
  static double decode(std::uint16_t word) noexcept { return static_cast<std::int16_t>(word) / 256.0; }
};

}  // namespace rtdata
