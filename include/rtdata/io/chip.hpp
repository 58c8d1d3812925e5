/// KnownChip, ChipSample: the chips of a driver, as data. `rtdata scan` finds chips with them, `rtdata types` and
/// docs/chips.md show them, and tests run the driver on a fake chip that is made from them.
///
///     class Thermometer {                                     // a driver (driver.hpp)
///       static constexpr rtdata::KnownChip chips[] = {
///           {.name = "TMP117", .addresses = {0x48, 0x49, 0x4a, 0x4b}}};
///       static constexpr rtdata::ChipSample samples[] = {
///           {.wires = rtdata::ChipWires::word_registers,
///            .bytes = {{{"00", "0c 80"}}},                    // register 0 has the word 0x0c80 ...
///            .values = {{{"temperature", 25}}}}};             // ... which is 25 degrees
///
/// Constants, which any thread may read.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>

namespace rtdata {

struct RegisterAddressing;

/// The identity of a chip: a register of 8 bits, or up to three of them or a word, the highest byte first.
/// `check_identity` (identity.hpp) compares it.
struct ChipIdentity {
  std::uint8_t number = 0;  ///< of the first register
  std::uint32_t value = 0;
  std::uint32_t mask = 0xff;  ///< the bits that count; the highest says how many bytes are read
  constexpr std::size_t size() const noexcept { return mask > 0xffff ? 3 : mask > 0xff ? 2 : 1; }
  constexpr bool is_of(std::uint32_t found) const noexcept { return ((found ^ value) & mask) == 0; }
};

/// A chip that a driver can be set to.
struct KnownChip {
  std::string_view name;                       ///< "BMP280", as in messages
  std::string_view model = {};                 ///< the value of the parameter `model`; empty: its default, or none
  std::array<std::uint8_t, 8> addresses = {};  ///< on I2C: its usual addresses; 0: no more
  std::optional<ChipIdentity> identity = {};   ///< none: only its address shows it
  constexpr bool is_at(unsigned address) const noexcept {
    for (const std::uint8_t one : addresses)
      if (one != 0 && one == address) return true;
    return false;
  }
};

/// The chips of a driver's table of models, each of which has its own as `chip`.
template <class Model, std::size_t count>
constexpr std::array<KnownChip, count> chips_of(const Model (&models)[count]) {
  std::array<KnownChip, count> chips;
  for (std::size_t i = 0; i < count; ++i) chips[i] = models[i].chip;
  return chips;
}

/// How the chip of a sample is accessed.
enum class ChipWires {
  registers,                 ///< of 8 bits, on SPI read with bit 7; the register number increments
  registers_with_write_bit,  ///< of 8 bits on SPI, written with bit 7
  word_registers,            ///< of 16 bits, the high byte first; the register number does not increment
  answers,                   ///< a request, and its answer
};

/// What a chip gives, in hexadecimal digits: "65 5a c0".
struct ChipBytes {
  std::string_view at;     ///< the number of the first register, or the request; empty: whatever is sent, or nothing
  std::string_view bytes;  ///< that are read
  std::uint8_t fixed = 0;  ///< bits of the first byte that the chip sets itself: writing does not change them
  bool is_fifo = false;    ///< the register gives these bytes again and again
};

/// A field of the events, and its number.
struct ChipValue {
  std::string_view field;
  double value = 0;
};

/// A working chip: the bytes that it gives and the values that they mean, best the example of its data sheet.
struct ChipSample {
  std::string_view members = {};  ///< of the sensor's item in a configuration, beside its place: R"("model": "bme280")"
  ChipWires wires = ChipWires::registers;
  std::array<ChipBytes, 8> bytes = {};   ///< none: the sample belongs to the configuration only
  std::array<ChipValue, 4> values = {};  ///< of every event
  bool has_proof = false;                ///< by identity, checksum or settings: only zeros or only ones are not values
  const RegisterAddressing* addressing = nullptr;  ///< of a driver that says it (registers.hpp); null: the usual one
};

}  // namespace rtdata
