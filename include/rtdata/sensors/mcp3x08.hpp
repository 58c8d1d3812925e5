/// Mcp3x08: analog-to-digital converters MCP3008 (10 bits) and MCP3208 (12 bits) of Microchip on SPI.
///
///     rtdata::DriverSensor<rtdata::Mcp3x08> adc(loop, {.name = "adc", .rate = 100_Hz}, bus, {.chip_select = 0},
///                                               {.model = AdcModel::mcp3208, .reference_voltage = 3.3});
///
/// Each tick reads all eight channels against ground, one after the other in one message: at a clock of 1 MHz in
/// 0.2 ms, 0.025 ms apart; the event has the time of the first. A chip that is not there, or whose data line hangs,
/// reads as ones, which its null bit shows: unreadable. One that is held at 0 looks like 0 V.
///
/// Clocks: to 1 MHz at 2.7 V, 2 MHz (MCP3008: 3.6 MHz) at 5 V. Modes 0 and 3.
///
/// Driver (driver.hpp): used on the bus's lane. The kernel's own driver of these chips is used with `analog`.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>

#include "rtdata/data/describe.hpp"
#include "rtdata/io/spi.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

struct AdcReading {
  std::array<double, 8> voltage{};     ///< of each channel
  std::array<std::uint16_t, 8> raw{};  ///< the codes that these are made of
  friend constexpr auto describe(type_tag<AdcReading>) {
    return record("adc", field("voltage", &AdcReading::voltage, "V"), field("raw", &AdcReading::raw));
  }
};

enum class AdcModel { mcp3008, mcp3208 };

class Mcp3x08 {
 public:
  static constexpr std::string_view type = "mcp3x08";
  static constexpr std::string_view description = "eight channels of an MCP3008 or MCP3208 on SPI";
  static constexpr std::string_view notes = R"(
- All eight channels against ground, one after the other in one message: 0.2 ms at a clock of 1 MHz.
- Clock: to 1 MHz with a supply of 2.7 V, 2 MHz (MCP3008: 3.6 MHz) with 5 V. Modes 0 and 3.
- SPI has no acknowledgement: a chip that is not there reads as ones, which its null bit shows, and is unreadable; a data line
  held at 0 cannot be told from 0 V.
- Signals above `reference_voltage` read as its last code. The kernel's own driver of these chips is read with `analog`.
)";
  struct Config {
    AdcModel model = AdcModel::mcp3208;
    double reference_voltage = 3.3;  ///< V at the pin VREF: of the code after the last
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(
          parameter("model", &Config::model, "which chip it is",
                    choices(value("mcp3008", AdcModel::mcp3008), value("mcp3208", AdcModel::mcp3208))),
          parameter("reference_voltage", &Config::reference_voltage, "at the pin VREF", unit("V"), range(0.25, 7.0)));
    }
  };
  using Value = AdcReading;
  using Device = SpiDevice;
  static constexpr SpiPlace place{};
  explicit Mcp3x08(const Config& config) : config_(config) {}

  Reading<AdcReading> read(SpiDevice& chip);

  /// The three bytes that ask for a channel, and its code in the three that come meanwhile; none: the null bit is 1, no
  /// chip has answered.
  static std::array<std::uint8_t, 3> request(AdcModel model, unsigned channel) noexcept;
  static std::optional<std::uint16_t> decode(AdcModel model, std::span<const std::uint8_t, 3> bytes) noexcept;

 private:
  Config config_;
};

}  // namespace rtdata
