/// Mcp3x08: analog-to-digital converters MCP3008 (10 bits) and MCP3208 (12 bits) of Microchip on SPI.
///
///     rtdata::DriverSensor<rtdata::Mcp3x08> adc(loop, {.name = "adc", .rate = 100_Hz}, bus, {.chip_select = 0},
///                                               {.channels = {{.name = "throttle", .input = "0"}, {.input = "2-3"}},
///                                                .model = rtdata::AdcModel::mcp3208, .reference_voltage = 3.3});
///     loop.subscribe("adc", [](const rtdata::EventView& event) { ... });  // a record of throttle and ain2_ain3, in V
///
/// Each tick reads the channels one after the other in one message, 0.025 ms apart at a clock of 1 MHz; the event has
/// the time of the first. The highest code means the reference voltage or more, 0 means 0 V or less. Without a chip, or
/// with the data line stuck high, all bits read as ones: the null bit shows this, and the reading is unreadable. A data
/// line stuck low cannot be distinguished from 0 V.
///
/// Clocks: to 1 MHz at 2.7 V, 2 MHz (MCP3008: 3.6 MHz) at 5 V. Modes 0 and 3.
///
/// Sources: Microchip MCP3004/3008, DS21295D: 5.0 protocol, 6.1 with bytes of a microcontroller (figure 6-1).
/// MCP3204/3208, DS21298E: 5.0, 6.1.
///
/// Driver (driver.hpp): used on the bus's lane. The kernel's own driver of these chips is used with `analog`.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/describe.hpp"
#include "rtdata/detail/chips/adc_channels.hpp"
#include "rtdata/io/spi.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

/// The voltages of the channels, in their order; their number and names are in the description of the events.
struct Voltages {
  std::array<double, detail::most_channels> voltages{};
};

enum class AdcModel { mcp3008, mcp3208 };

class Mcp3x08 {
 public:
  static constexpr std::string_view type = "mcp3x08";
  static constexpr std::string_view aliases = "adc";
  static constexpr std::string_view description = "voltages by an MCP3008 or MCP3208 on SPI";
  static constexpr std::string_view notes = R"(
- Pins: DOUT to MISO, DIN to MOSI, CLK, CS; mode 0 or 3, `clock` to 1 MHz at 2.7 V, 2 MHz (MCP3008: 3.6 MHz) at 5 V.
- `input` is 0 to 7 (against ground) or one of the pairs 0-1, 1-0, 2-3, 3-2, 4-5, 5-4, 6-7 and 7-6: the first minus the
  second, which must not be above the first.
- Each channel is a field (`ain0`, `ain2_ain3` unless it has a `name`).
- A missing chip reads as ones, which is reported. If the data line is at ground, it reads as 0 V, which cannot be
  detected.
)";

  struct Channel {
    std::string name = {};    ///< of the field; empty: by the input
    std::string input = "0";  ///< "0" to "7", "0-1", "1-0", "2-3" ...
    friend constexpr auto parameters(type_tag<Channel>) {
      return parameter_list(
          parameter("name", &Channel::name, "name of the field; default: from the input, such as ain0", TextIs::field),
          parameter(
              "input", &Channel::input,
              "one input against ground (0), or the difference of two (0-1: input 0 minus input 1)",
              choices("0", "1", "2", "3", "4", "5", "6", "7", "0-1", "1-0", "2-3", "3-2", "4-5", "5-4", "6-7", "7-6")));
    }
  };
  struct Config {
    std::vector<Channel> channels = {};  ///< empty: each input against ground
    AdcModel model = AdcModel::mcp3208;
    double reference_voltage = 3.3;  ///< V at the pin VREF: full scale, one more than the highest code
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(
          parameter("channels", &Config::channels,
                    "inputs to convert, in this order; empty: each input against ground"),
          parameter("model", &Config::model, "which chip it is",
                    choices(value("mcp3008", AdcModel::mcp3008), value("mcp3208", AdcModel::mcp3208))),
          parameter("reference_voltage", &Config::reference_voltage, "voltage at the pin VREF", unit("V"),
                    range(0.25, 7.0)));
    }
  };
  using Value = Voltages;
  using Device = SpiDevice;
  static constexpr SpiPlace place{};
  static constexpr KnownChip chips[] = {{.name = "MCP3008", .model = "mcp3008"},
                                        {.name = "MCP3208", .model = "mcp3208"}};
  // The null bit, and half of the range.
  static constexpr ChipSample samples[] = {
      {.wires = ChipWires::answers, .bytes = {{{"", "00 08 00"}}}, .values = {{{"ain0", 1.65}, {"ain7", 1.65}}}}};

  static Result<void> check(const Config& config) {
    for (std::size_t i = 0; i < config.channels.size(); ++i)
      if (const auto input = detail::find_input(inputs, config.channels[i].input, i); !input) return input.error();
    return {};
  }
  static Result<std::shared_ptr<const Description>> describe(const Config& config) {
    return detail::describe_channels(detail::chosen_or_all(config.channels, inputs, 8),
                                     DescriptionBuilder::Presence::always);
  }
  explicit Mcp3x08(const Config& config) : config_(config) {
    config_.channels = detail::chosen_or_all(config.channels, inputs, 8);
  }

  Reading<Voltages> read(SpiDevice& chip) {
    const std::size_t count = config_.channels.size();
    std::array<std::array<std::uint8_t, 3>, detail::most_channels> requests{}, answers{};
    std::array<SpiSegment, detail::most_channels> segments{};
    for (std::size_t i = 0; i < count; ++i) {
      requests[i] = request(config_.model, config_.channels[i].input);
      segments[i] = {.write = requests[i], .read = answers[i], .release_after = true};
    }
    if (auto done = chip.transfer(std::span(segments).first(count)); !done) return std::move(done).error();
    const double step = config_.reference_voltage / (1 << bits_of(config_.model));
    Voltages reading;
    for (std::size_t i = 0; i < count; ++i) {
      const std::optional<std::uint16_t> code = decode(config_.model, answers[i]);
      if (!code)
        return Unreadable{chip.error(Errc::bad_data, "cannot read the converter",
                                     detail::field_of(config_.channels[i]) + " has no null bit: no chip answers",
                                     "check its wires and supply, `chip_select`, `mode`, `clock`, and `model`")};
      reading.voltages[i] = *code * step;
    }
    return reading;
  }

  /// `request` gives the three bytes to send for an input; `code_of` takes its code from the three bytes received.
  /// Empty: the null bit is 1, no chip has answered.
  static std::array<std::uint8_t, 3> request(AdcModel model, std::string_view input) noexcept {
    std::size_t number = 0;
    while (number < inputs.size() && inputs[number] != input) ++number;
    const unsigned single = number < 8 ? 1 : 0, select = number & 7;
    // A start bit, 1 for single-ended, the channel, placed so that the code ends with the last byte.
    if (model == AdcModel::mcp3008) return {0x01, static_cast<std::uint8_t>(single << 7 | select << 4), 0};
    return {static_cast<std::uint8_t>(0x04 | single << 1 | select >> 2), static_cast<std::uint8_t>((select & 3) << 6),
            0};
  }
  static std::optional<std::uint16_t> decode(AdcModel model, std::span<const std::uint8_t, 3> bytes) noexcept {
    const unsigned bits = bits_of(model);
    const unsigned answer = static_cast<unsigned>(bytes[1]) << 8 | bytes[2];
    if ((answer >> bits & 1) != 0) return std::nullopt;
    return static_cast<std::uint16_t>(answer & ((1u << bits) - 1));
  }

 private:
  static constexpr unsigned bits_of(AdcModel model) noexcept { return model == AdcModel::mcp3008 ? 10 : 12; }
  static constexpr std::array<std::string_view, 16> inputs{"0",   "1",   "2",   "3",   "4",   "5",   "6",   "7",
                                                           "0-1", "1-0", "2-3", "3-2", "4-5", "5-4", "6-7", "7-6"};
  Config config_;
};

}  // namespace rtdata
