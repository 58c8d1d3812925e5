/// SerialSettings: how the bits go over a serial line. Default: 9600 8N1.
///
///     rtdata::SerialSettings settings{.baud_rate = 115200, .parity = rtdata::Parity::even};
///
/// Values; any thread.
#pragma once

#include <cstdint>

#include "rtdata/data/describe.hpp"
#include "rtdata/data/parameter.hpp"

namespace rtdata {

enum class Parity { none, even, odd, mark, space };
constexpr auto describe(type_tag<Parity>) {
  return enumeration("parity", value("none", Parity::none), value("even", Parity::even), value("odd", Parity::odd),
                     value("mark", Parity::mark), value("space", Parity::space));
}

struct SerialSettings {
  std::uint32_t baud_rate = 9600;  ///< bits a second; any that the device can do, not only the usual ones
  unsigned character_size = 8;     ///< bits of a character, 5 to 8
  Parity parity = Parity::none;
  unsigned stop_bits = 1;  ///< 1 or 2

  friend constexpr auto parameters(type_tag<SerialSettings>) {
    return parameter_list(parameter("baud_rate", &SerialSettings::baud_rate, "speed, any that the device can do",
                                    rtdata::unit("Bd"), range(1, 20000000)),
                          parameter("character_size", &SerialSettings::character_size, "bits of a character",
                                    rtdata::unit("bit"), range(5, 8)),
                          parameter("parity", &SerialSettings::parity, "parity bit"),
                          parameter("stop_bits", &SerialSettings::stop_bits, "stop bits", range(1, 2)));
  }
};

}  // namespace rtdata
