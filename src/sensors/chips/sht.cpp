// Sensirion SHT3x-DIS, data sheet of December 2022: table 4 measurement time, 4.3 single shot, 4.12 checksum, 4.13
// conversion. SHT4x, data sheet of March 2022: table 4 time, 4.5 command 0xfd, 4.6 conversion.
#include "rtdata/sensors/sht.hpp"

#include <algorithm>
#include <array>

namespace rtdata {
namespace {

constexpr const char* what = "cannot read the hygrometer";

double fraction(std::uint8_t high, std::uint8_t low) noexcept { return (high << 8 | low) / 65535.0; }

}  // namespace

Result<void> Sht::start(I2cDevice& chip) {
  constexpr std::array<std::uint8_t, 2> of_sht3x{0x24, 0x00};  // without holding the clock
  constexpr std::array<std::uint8_t, 1> of_sht4x{0xfd};
  return config_.model == ShtModel::sht3x ? chip.write(of_sht3x) : chip.write(of_sht4x);
}

Duration Sht::conversion_time() const noexcept {
  using namespace std::chrono_literals;
  return config_.model == ShtModel::sht3x ? 16ms : 9ms;
}

Reading<HumidityReading> Sht::read(I2cDevice& chip) {
  std::array<std::uint8_t, 6> bytes{};
  if (auto done = chip.read(bytes); !done) return std::move(done).error();
  auto reading = decode(bytes, config_.model);
  if (!reading) return Unreadable{chip.error(Errc::bad_data, what, reading.error().why, reading.error().advice)};
  return *reading;
}

std::uint8_t Sht::checksum(std::span<const std::uint8_t, 2> bytes) noexcept {
  unsigned sum = 0xff;
  for (const std::uint8_t byte : bytes) {
    sum ^= byte;
    for (int bit = 0; bit < 8; ++bit) sum = (sum & 0x80) != 0 ? (sum << 1 ^ 0x31) & 0xff : sum << 1 & 0xff;
  }
  return static_cast<std::uint8_t>(sum);
}

Result<HumidityReading> Sht::decode(std::span<const std::uint8_t, 6> bytes, ShtModel model) {
  if (checksum(bytes.subspan<0, 2>()) != bytes[2] || checksum(bytes.subspan<3, 2>()) != bytes[5])
    return Error{Errc::bad_data, what, "", "a checksum is wrong", "look at its wires, and `model`"};
  const double temperature = -45 + 175 * fraction(bytes[0], bytes[1]);
  const double share = fraction(bytes[3], bytes[4]);
  return HumidityReading{temperature, std::clamp(model == ShtModel::sht3x ? 100 * share : 125 * share - 6, 0.0, 100.0)};
}

}  // namespace rtdata
