/// LimitWatch: whether a value is beyond its limits, with hysteresis, delay, and a latch.
///
///     rtdata::LimitWatch watch({.high = 5e5, .high_high = 6e5, .hysteresis = 1e4, .delay = 200ms, .latched = true});
///     if (watch.take(pressure, loop.time())) show(watch.state());
///     watch.acknowledge();
///
/// A value is beyond `high` or `high_high` if it is greater, and beyond `low` or `low_low` if it is less. The level is
/// reached when all values have been beyond the limit for `delay`; it ends with the first value that is back by
/// `hysteresis`. Only values change the level, not the passing of time, so a replay gives the same result.
///
/// The alarm is the state to signal: the level or, if `latched`, the worst level until somebody has acknowledged it,
/// even if the value is back. A level that is worse than the alarm, or on the other side, is a new alarm without
/// acknowledgement. Levels `low_low` and `high_high` are worse than `low` and `high`.
///
/// An unknown value (absent, not finite, or no events) has the level `unknown`. An existing alarm then does not change;
/// without one, the alarm is `unknown`, so that somebody checks.
///
/// Only the constructor and `change` may allocate or throw; no function locks. Values; one thread at a time.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "rtdata/data/describe.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata {

enum class LimitLevel : std::int8_t { low_low = -2, low = -1, normal = 0, high = 1, high_high = 2, unknown = 3 };

constexpr auto describe(type_tag<LimitLevel>) {
  return enumeration("limit_level", value("low_low", LimitLevel::low_low), value("low", LimitLevel::low),
                     value("normal", LimitLevel::normal), value("high", LimitLevel::high),
                     value("high_high", LimitLevel::high_high), value("unknown", LimitLevel::unknown));
}

struct LimitSettings {
  std::optional<double> low_low = {}, low = {}, high = {}, high_high = {};  ///< at least one, in ascending order
  double hysteresis = 0;  ///< not negative; less than the distance from `low` to `high`
  Duration delay{0};
  bool latched = false;
};

/// Errors (bad-argument): no limit, not in ascending order, not finite, an invalid hysteresis or delay.
Result<void> check_limits(const LimitSettings& settings);

struct LimitState {
  LimitLevel level = LimitLevel::normal;  ///< of the value
  LimitLevel alarm = LimitLevel::normal;  ///< the state to signal
  bool acknowledged = true;               ///< also true without an alarm
  std::optional<double> value = {};       ///< the last one; empty: unknown
  std::optional<double> limit = {};       ///< that of the alarm's level
  bool operator==(const LimitState&) const = default;
};

class LimitWatch {
 public:
  /// SetupError: as `check_limits`.
  explicit LimitWatch(const LimitSettings& settings);

  /// Takes a value; returns true if level, alarm or acknowledgement have changed.
  bool take(double value, Time time) noexcept;
  bool take_unknown() noexcept;
  /// Acknowledges the alarm. False: there was nothing to acknowledge.
  bool acknowledge() noexcept;
  const LimitState& state() const noexcept { return state_; }
  /// Changes the limits; the alarm and its acknowledgement stay until the next value. SetupError: as `check_limits`.
  void change(const LimitSettings& settings);
  /// Returns to the initial state.
  void reset() noexcept;

 private:
  struct Limit {
    std::optional<double> at;
    int side;  // 1: greater values are beyond it, -1: lesser ones
    LimitLevel level;
    bool is_passed = false;
    std::optional<Time> beyond_since = {};
  };
  bool change_to(LimitLevel level) noexcept;
  std::optional<double> limit_of(LimitLevel level) const noexcept;
  void find_same() noexcept;
  void forget_same() noexcept;

  std::array<Limit, 4> limits_;  // the worst of each side first
  double hysteresis_ = 0;
  Duration delay_{0};
  bool is_latched_ = false;
  double same_from_ = 0, same_until_ = 0;  // a value between these changes nothing, at any time
  LimitState state_;
};

/// 0: normal, 1: a warning (low, high, unknown), 2: critical (low_low, high_high).
constexpr int severity(LimitLevel level) noexcept {
  if (level == LimitLevel::normal) return 0;
  return level == LimitLevel::low_low || level == LimitLevel::high_high ? 2 : 1;
}

}  // namespace rtdata
