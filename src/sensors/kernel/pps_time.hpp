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
  std::uint32_t count = 0;  ///< 0: there was none yet
  bool operator==(const PpsStamp&) const = default;
};
/// "1700000000.123456789#42". Errors: bad-data.
Result<PpsStamp> parse_pps(std::string_view text);

/// How far a time is from the nearest whole second.
Duration from_second(Time time) noexcept;

/// For one source: tells which second a pulse begins.
class PpsTimeCheck {
 public:
  enum class Verdict {
    accepted,
    too_few,       ///< pulses in a row that are a second apart
    unkept_clock,  ///< nobody knows which second it is
    not_a_second,  ///< the pulses do not begin seconds, by a clock that is kept better than that
  };
  /// Call it for each pulse: its monotonic time, its time of day, and the largest error of that clock.
  Verdict look_at(MonotonicTime at, Time time, std::optional<Duration> clock_accuracy, Duration accuracy) noexcept;
  /// As if there had been none.
  void reset() noexcept { in_a_row_ = 0; }

 private:
  MonotonicTime last_{};
  Time last_time_{};
  int in_a_row_ = 0;
};

}  // namespace rtdata::detail
