/// The protocol of Sensirion's chips on I2C: commands of 16 bits, and words of 16 bits with a checksum each. The common
/// part of their drivers (sht.hpp, scd4x.hpp, sgp.hpp, sps30.hpp).
///
/// A chip does not support a read without a stop after its command: the driver writes, waits as long as the command
/// takes, and then reads.
///
/// Sources: Sensirion SHT3x-DIS, data sheet of December 2022, 4.12; SCD4x, data sheet V1.3 of September 2022, 3.3;
/// SGP40, data sheet V1.0 of July 2020, table 9; SPS30, data sheet V1.0 of March 2020, 6.2.
///
/// Values; any thread.
#pragma once

#include <array>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

namespace rtdata::detail {

/// Polynomial 0x31, begun with 0xff: 0x92 for 0xbe, 0xef.
constexpr std::uint8_t sensirion_checksum(std::span<const std::uint8_t, 2> bytes) noexcept {
  unsigned sum = 0xff;
  for (const std::uint8_t byte : bytes) {
    sum ^= byte;
    for (int bit = 0; bit < 8; ++bit) sum = (sum & 0x80) != 0 ? (sum << 1 ^ 0x31) & 0xff : sum << 1 & 0xff;
  }
  return static_cast<std::uint8_t>(sum);
}

/// A command, with the words that it takes.
template <std::same_as<std::uint16_t>... Words>
constexpr std::array<std::uint8_t, 2 + 3 * sizeof...(Words)> sensirion_command(std::uint16_t command,
                                                                               Words... words) noexcept {
  std::array<std::uint8_t, 2 + 3 * sizeof...(Words)> bytes{static_cast<std::uint8_t>(command >> 8),
                                                           static_cast<std::uint8_t>(command & 0xff)};
  std::size_t at = 2;
  [[maybe_unused]] const auto add = [&](std::uint16_t word) {
    const std::array<std::uint8_t, 2> two{static_cast<std::uint8_t>(word >> 8), static_cast<std::uint8_t>(word & 0xff)};
    bytes[at] = two[0];
    bytes[at + 1] = two[1];
    bytes[at + 2] = sensirion_checksum(two);
    at += 3;
  };
  (add(words), ...);
  return bytes;
}

/// The words of an answer; empty: a checksum is wrong.
template <std::size_t size>
constexpr std::optional<std::array<std::uint16_t, size / 3>> sensirion_words(
    const std::array<std::uint8_t, size>& bytes) noexcept {
  static_assert(size % 3 == 0);
  std::array<std::uint16_t, size / 3> words{};
  for (std::size_t i = 0; i < words.size(); ++i) {
    const std::array<std::uint8_t, 2> two{bytes[3 * i], bytes[3 * i + 1]};
    if (sensirion_checksum(two) != bytes[3 * i + 2]) return std::nullopt;
    words[i] = static_cast<std::uint16_t>(two[0] << 8 | two[1]);
  }
  return words;
}

}  // namespace rtdata::detail
