// NXP LM75B, data sheet of 2015: 7.4.3 temperature register; TI TMP75, 8.5.1.
#include "rtdata/sensors/lm75.hpp"

#include <string>

namespace rtdata {

Reading<TemperatureReading> Lm75::read(I2cDevice& chip) {
  constexpr double least = -55, most = 125;
  const Result<std::uint16_t> word = chip.read_word(0x00);
  if (!word) return word.error();
  const double degrees = decode(*word);
  if (degrees < least || degrees > most) {
    return Unreadable{chip.error(Errc::out_of_range, "cannot read the LM75",
                                 std::to_string(degrees) + " degrees is nothing that it measures",
                                 "look at its wires, and whether this is an LM75")};
  }
  return TemperatureReading{degrees};
}

}  // namespace rtdata
