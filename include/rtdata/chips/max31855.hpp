/// Max31855: a thermocouple at a MAX31855 of Maxim on SPI.
///
///     rtdata::DriverSensor<rtdata::Max31855> oven(loop, {.name = "oven", .rate = 5_Hz}, bus, {.chip_select = 0});
///
/// The chip is made for one type of thermocouple, given by the last letter of its name (MAX31855K, J, N, T, S, R, E),
/// and has no settings. It measures by itself, some ten times a second, in steps of 0.25 degrees; a tick reads the last
/// value. A thermocouple that is open, or shorted to ground or to the supply, is unreadable, with that reason.
///
/// Without a chip all bits read as ones or as zeros. Ones are recognised by two bits that are always 0. All zeros could
/// also mean 0 degrees at both ends; the driver takes them as unreadable. There is no identity and no checksum.
///
/// Clock to 5 MHz, mode 0. Source: Maxim, 19-5793, memory map (tables 2 to 5).
///
/// Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string_view>

#include "rtdata/chips/max31856.hpp"
#include "rtdata/data/describe.hpp"
#include "rtdata/io/spi.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

class Max31855 {
 public:
  static constexpr std::string_view type = "max31855";
  static constexpr std::string_view description = "temperature of a thermocouple at a MAX31855 on SPI";
  static constexpr std::string_view notes = R"(
- Pins: SO to MISO, SCK, CS; mode 0, `clock` to 5 MHz.
- The letter at the end of the chip's name is the type of its thermocouple.
- It measures some ten times a second: a higher `rate` reads values twice.
- An open thermocouple, or one that is shorted to ground or to the supply, is reported and counted as unreadable. So
  are answers of only ones or only zeros, which mean that no chip answers; a chip with both ends at exactly 0 degrees
  sends the same.
)";
  struct Config {
    friend constexpr auto parameters(type_tag<Config>) { return parameter_list(); }
  };
  using Value = ThermocoupleReading;
  using Device = SpiDevice;
  static constexpr SpiPlace place{};
  static constexpr KnownChip chips[] = {{.name = "MAX31855"}};
  static constexpr ChipSample samples[] = {{.wires = ChipWires::answers,
                                            .bytes = {{{"", "06 4c 19 00"}}},
                                            .values = {{{"temperature", 100.75}, {"cold_junction", 25}}},
                                            .has_proof = true}};
  explicit Max31855(const Config&) {}

  Reading<ThermocoupleReading> read(SpiDevice& chip) {
    std::array<std::uint8_t, 4> bytes{};
    if (auto done = chip.read(bytes); !done) return std::move(done).error();
    auto reading = decode(bytes);
    if (!reading) return Unreadable{at_place(chip, reading.error())};
    return *reading;
  }

  /// Errors: bad-data (no chip, or a thermocouple fault).
  static Result<ThermocoupleReading> decode(std::span<const std::uint8_t, 4> bytes) {
    const std::uint32_t word = static_cast<std::uint32_t>(bytes[0]) << 24 | static_cast<std::uint32_t>(bytes[1]) << 16 |
                               static_cast<std::uint32_t>(bytes[2]) << 8 | bytes[3];
    constexpr std::uint32_t always_zero = 0x0002'0008, fault = 0x0001'0000;
    const auto refused = [](const char* why, const char* advice) {
      return Error{Errc::bad_data, "cannot read the MAX31855", "", why, advice};
    };
    if ((word & always_zero) != 0 || word == 0)
      return refused(word == 0 ? "it gives only zeros: no chip answers" : "bits that must be 0 are 1: no chip answers",
                     "check its wires and supply, `chip_select`, `mode` and `clock`");
    if ((word & 1) != 0) return refused("the thermocouple is open", "check its wires");
    if ((word & 2) != 0) return refused("the thermocouple is shorted to ground", "check its wires");
    if ((word & 4) != 0) return refused("the thermocouple is shorted to the supply", "check its wires");
    if ((word & fault) != 0) return refused("it reports an unknown fault", "check its wires");
    const auto bits = static_cast<std::int32_t>(word);
    return ThermocoupleReading{(bits >> 18) * 0.25, (static_cast<std::int16_t>(word & 0xffff) >> 4) * 0.0625};
  }
};

}  // namespace rtdata
