/// InertialModel: what differs between the chips that rtdata/chips/inertial.hpp drives, as data.
///
/// Constants; any thread.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <numbers>
#include <optional>
#include <span>

#include "rtdata/io/chip.hpp"
#include "rtdata/io/identity.hpp"
#include "rtdata/io/registers.hpp"

namespace rtdata {

inline constexpr double standard_gravity = 9.80665;                   ///< m/s2
inline constexpr double radians_a_degree = std::numbers::pi / 180.0;  ///< rad

/// A number that a setting can have, in the words of the data sheet (Hz, g, degrees a second), and its code.
struct InertialChoice {
  double number;
  std::uint8_t code;
  double per_count = 0;  ///< of a range: m/s2 or rad/s
};

/// A register to write. Its value is `value` plus the code of each setting times its factor.
struct InertialWrite {
  std::uint8_t number;
  std::uint8_t value = 0;
  std::uint8_t by_rate = 0, by_acceleration = 0, by_angle = 0, by_filter = 0;
  Duration pause = Duration{0};  ///< that the chip needs afterwards
  std::uint8_t on_spi = 0;       ///< more bits of the value, where the chip is on SPI
};

/// How to query and read the FIFO.
struct InertialFifo {
  InertialWrite off, on;                         ///< off and on empties it; `on` not read back: settings are lost
  std::span<const InertialWrite> emptying = {};  ///< between them, if they alone do not
  std::uint8_t status = 0;                       ///< register of the number of samples
  std::size_t status_bytes = 1;                  ///< the first one is the lowest, unless `big_endian`
  std::uint32_t count_mask = 0;                  ///< in the status
  std::uint32_t over_mask = 0;                   ///< it has run over
  std::uint32_t torn_mask = 0;                   ///< the next byte is not the first one of a sample
  std::uint8_t over_register = 0, over_bit = 0;  ///< a separate overflow flag; reading clears it
  std::size_t count_bytes = 1;                   ///< of what is counted
  std::size_t capacity = 0;                      ///< bytes
  bool keeps_whole_samples = false;              ///< an overflow drops the oldest; false: it breaks the sample order
  std::uint8_t data = 0;                         ///< register it is read from
  bool is_stream = false;                        ///< the register is read on and on; else once for each sample
  std::uint8_t second_data = 0;                  ///< of a second reading of 6 bytes for each sample; 0: none
  bool is_tagged = false;                        ///< words of 7 bytes, of which one says what it is (LSM6DSO)
  unsigned to_discard = 0;                       ///< samples after it is switched on
};

/// How much the self-test must change an output, without regard to the sign: m/s2 or rad/s.
struct InertialLimits {
  double least = 0, most = 0;
};
/// The limits of acceleration X, Y, Z, then of angular velocity.
using InertialSixLimits = std::array<InertialLimits, 6>;

/// The self-test: bits that make the chip deflect its own masses, and the expected change.
struct InertialSelfTest {
  std::uint8_t acceleration_register = 0, acceleration_on = 0;  ///< 0: it has none here
  std::uint8_t angle_register = 0, angle_on = 0;
  std::uint8_t acceleration_output = 0, angle_output = 0;  ///< registers
  double acceleration_range = 0, angle_range = 0;          ///< at which it is done
  InertialSixLimits limits{};
  Result<InertialSixLimits> (*limits_of)(RegisterDevice& chip) = nullptr;  ///< where each chip has its own
};

struct InertialModel {
  KnownChip chip;
  std::span<const InertialChoice> rates, accelerations, angles, filters;  ///< empty: it has no such setting
  std::span<const InertialWrite> setting_up, sleeping;
  InertialFifo fifo;
  bool big_endian = false;
  std::size_t sample_bytes = 6;
  int acceleration_at = 0, angle_at = -1, temperature_at = -1;  ///< in a sample; -1: it is not there
  std::uint8_t temperature_register = 0;                        ///< 0: there is none, or it is in the samples
  double counts_per_degree = 1, degrees_at_zero = 0;
  InertialSelfTest self_test = {};
  RegisterAddressing addressing = {};
  std::uint8_t bank_register = 0;  ///< bits 4 and 5 choose a bank, which is 0 except in `setting_up`; 0: there are none
};

/// What a configuration has chosen; none: the default of the model.
struct InertialSettings {
  std::optional<double> rate{}, acceleration{}, angle{}, filter{};
  bool self_test = false;
  std::optional<IdentityCode> identity{};
};

}  // namespace rtdata
