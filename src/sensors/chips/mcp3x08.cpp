// Microchip MCP3004/3008, DS21295D: 5.0 protocol, 6.1 with bytes of a microcontroller (figure 6-1). MCP3204/3208,
// DS21298E: 5.0, 6.1.
#include "rtdata/sensors/mcp3x08.hpp"

#include <string>

namespace rtdata {

std::array<std::uint8_t, 3> Mcp3x08::request(AdcModel model, unsigned channel) noexcept {
  const auto select = static_cast<std::uint8_t>(channel & 7);
  // A start bit, 1 for single-ended, the channel; so placed that the code ends with the last byte.
  if (model == AdcModel::mcp3008) return {0x01, static_cast<std::uint8_t>(0x80 | select << 4), 0};
  return {static_cast<std::uint8_t>(0x06 | select >> 2), static_cast<std::uint8_t>((select & 3) << 6), 0};
}

std::optional<std::uint16_t> Mcp3x08::decode(AdcModel model, std::span<const std::uint8_t, 3> bytes) noexcept {
  const unsigned bits = model == AdcModel::mcp3008 ? 10 : 12;
  const unsigned answer = static_cast<unsigned>(bytes[1]) << 8 | bytes[2];
  if ((answer >> bits & 1) != 0) return std::nullopt;
  return static_cast<std::uint16_t>(answer & ((1u << bits) - 1));
}

Reading<AdcReading> Mcp3x08::read(SpiDevice& chip) {
  std::array<std::array<std::uint8_t, 3>, 8> requests{}, answers{};
  std::array<SpiSegment, 8> segments{};
  for (unsigned channel = 0; channel < 8; ++channel) {
    requests[channel] = request(config_.model, channel);
    segments[channel] = {.write = requests[channel], .read = answers[channel], .release_after = true};
  }
  if (auto done = chip.transfer(segments); !done) return std::move(done).error();
  const double step = config_.reference_voltage / (config_.model == AdcModel::mcp3008 ? 1024 : 4096);
  AdcReading reading;
  for (std::size_t channel = 0; channel < 8; ++channel) {
    const std::optional<std::uint16_t> code = decode(config_.model, answers[channel]);
    if (!code)
      return Unreadable{chip.error(Errc::bad_data, "cannot read the converter",
                                   "channel " + std::to_string(channel) + " has no null bit: nothing answers",
                                   "look at its wires and supply, `chip_select`, `mode`, `clock`, and `model`")};
    reading.raw[channel] = *code;
    reading.voltage[channel] = *code * step;
  }
  return reading;
}

}  // namespace rtdata
