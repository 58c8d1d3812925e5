// The kernel's format of pulses per second, and the check for use as a time source. Pure functions.
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

#include "rtdata/data/error.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::detail {

struct PpsStamp {
  Time time{};              ///< by the machine's clock
  std::uint32_t count = 0;  ///< 0: no pulse yet
  bool operator==(const PpsStamp&) const = default;
};
/// "1700000000.123456789#42". Errors: bad-data.
Result<PpsStamp> parse_pps(std::string_view text);

/// How far a time is from the nearest whole second.
Duration from_second(Time time) noexcept;

/// For one source: finds which second a pulse begins.
class PpsTimeCheck {
 public:
  enum class Verdict {
    accepted,
    too_few,       ///< too few pulses in a row one second apart
    unkept_clock,  ///< no synchronized clock tells which second it is
    not_a_second,  ///< by a clock that is accurate enough, the pulses are not at the start of a second
  };
  /// Call it for each pulse: its monotonic time, its time of day, and the largest error of that clock.
  Verdict look_at(MonotonicTime at, Time time, std::optional<Duration> clock_accuracy, Duration accuracy) noexcept;
  /// Forgets all pulses.
  void reset() noexcept { in_a_row_ = 0; }

 private:
  MonotonicTime last_{};
  Time last_time_{};
  int in_a_row_ = 0;
};

}  // namespace rtdata::detail
