/// VerticalKalman: height, vertical speed and acceleration of a flying object, from a barometer and an accelerometer
/// along its axis, or from one of both.
///
///     rtdata::VerticalKalman rocket({.burn = std::chrono::seconds{7}});
///     rocket.take(time, {.height = 212.4, .acceleration = 3.1});   // m; g, 1 at rest
///     if (rocket.now().speed + rocket.now().speed_deviation < 0) { ... }   // it surely falls
///
/// A Kalman filter of height, speed, acceleration and the accelerometer's bias. Its rules:
///   - on the ground it learns the accelerometer's bias (the difference from 1 g) and the height of the ground;
///   - in flight it ignores the barometer near the speed of sound, and each height that differs from the expected one
///     by more than the noise; after seconds of ignored heights it uses the barometer again when a series of heights
///     agrees with the accelerometer or, after a longer time, with itself;
///   - while the speed is unknown (no accelerometer, or one at the end of its range) it ignores the barometer for
///     `burn` after the liftoff, then uses it again when a series of heights agrees;
///   - it ignores an accelerometer at the end of its range or with the same value for 2 s, and a barometer that repeats
///     a height.
/// The deviations show the uncertainty; they grow while nothing is measured.
///
/// A value, without a loop; allocates nothing after its construction. Any thread, one at a time.
#pragma once

#include <array>
#include <cstddef>
#include <limits>

#include "rtdata/data/time.hpp"

namespace rtdata {

struct VerticalKalmanConfig {
  Duration burn = std::chrono::seconds{7};  ///< time without the barometer after liftoff, if the speed is unknown
  double noise = 0.5;                       ///< m, least noise of the barometer; it detects more by itself
  double range = 0;                         ///< g, range of the accelerometer; 0: detected by repeated values
};

struct VerticalReadings {
  static constexpr double none = std::numeric_limits<double>::quiet_NaN();
  double height = none;        ///< m, by the barometer; NaN: not measured
  double acceleration = none;  ///< g, along the axis, as measured: 1 at rest, 0 in free fall; NaN: not measured
};

enum class BarometerUse {
  none,     ///< no new value
  used,     ///< its height is used
  locked,   ///< ignored: near the speed of sound, or during `burn`
  refused,  ///< ignored: too far from the expected height
};

struct VerticalState {
  double height = 0;        ///< m, above the barometer's zero
  double speed = 0;         ///< m/s, upwards
  double acceleration = 0;  ///< m/s2, upwards; -9.8 in free fall
  double height_deviation = 0;
  double speed_deviation = 0;
  double ground = VerticalReadings::none;  ///< m, where it stood; NaN: not known
  double unchanged = 0;                    ///< s since the barometer's last new value
  BarometerUse barometer = BarometerUse::none;
  bool accelerometer = false;  ///< it measures
  bool is_flying = false;      ///< from liftoff until it stands still
};

class VerticalKalman {
 public:
  explicit VerticalKalman(VerticalKalmanConfig config = {});
  /// Readings less than 1 us apart count as one instant, of which the last of each kind is used; so do readings older
  /// than the latest.
  void take(Time time, VerticalReadings readings);
  const VerticalState& now() const noexcept { return now_.state; }
  /// As new.
  void reset() noexcept;

 private:
  /// A series of the barometer's heights, thinned to the available space.
  struct Point {
    double time = 0, height = 0;
    double path = 0;  // m, by the accelerometer alone, from where the stretch begins
  };
  static constexpr std::size_t room = 96;
  struct Filter {
    double time = 0, step = 0;  // s since the first readings; since those before
    std::array<double, 4> x{};
    std::array<std::array<double, 4>, 4> p{};
    VerticalState state;
    bool has_height = false;
    // The accelerometer.
    double felt = 1, felt_before = 1, felt_at = -1e9, felt_since = -1e9;
    std::size_t felt_times = 0;
    double highest = 0, lowest = 0;                  // g, that it has shown
    double upper_end = 1e9, lower_end = -1e9;        // g, of its range as found
    double path = 0, path_speed = 0, path_from = 0;  // by the accelerometer alone, without a pause, since `path_from`
    double gained = 0, most = 0;                     // m/s, felt since the liftoff
    double gained_before = 0, most_before = 0;       // when it began to show one and the same value
    double paused_at = -1e9;
    double beyond = 0;                      // s, at the end of its range since the liftoff
    double felt_mean = 1, moved_at = -1e9;  // g, of 0.3 s; when that was no rest
    double ended_at = -1e9, low_at = -1e9;  // when it was last at the end of its range; below 0.3 g or burning
    bool is_stuck = false, is_doubted = false;
    // The barometer.
    double height = 0, height_before = 0, middle = 0, changed_at = -1e9, changed_before = -1e9, heard_at = -1e9,
           noise = 0;
    std::size_t steps = 0;
    double refused_at = -1e9;                   // since then each height was refused; -1e9: it is not
    double rest_mean = 0;                       // m, of how far heights are from the expected ones
    double contested = 0, contested_at = -1e9;  // m/s, by which it climbs faster while it is refused
    double locked_at = -1e9;
    double highest_heard = 0, still_height = 0, stays_since = -1e9;
    // The flight.
    double stood_at = -1e9, stood_for = 0;  // s
    double flew_at = -1e9, fell_at = -1e9, rest_bias = 0;
    double rises_since = -1e9, thrust_since = -1e9, contrary_since = -1e9, still_since = -1e9, hangs_since = -1e9,
           up_since = -1e9;
    bool has_seen_liftoff = false, is_known = false, has_burnt = false, has_fallen = false;
    std::array<Point, room> points{};
    std::array<Point, 2> third{{{-1e9, 0, 0}, {-1e9, 0, 0}}};  // the last two heights
    std::size_t first = 0, count = 0;
  };

  void apply(double time, const VerticalReadings& readings);
  void predict(double passed);
  bool coasts() const;
  bool feel(double felt);
  void hear(double height);
  enum class Measured { height, speed, acceleration, felt };
  void measure(Measured what, double value, double variance);
  void begin(double height);
  void keep(double time, double height, double path);
  bool believe();
  void decide();
  void lift_off(bool is_felt);

  VerticalKalmanConfig config_;
  Filter now_, before_;      // before_: before the latest instant
  VerticalReadings latest_;  // of that instant
  Time start_{};
  bool has_begun_ = false;
};

}  // namespace rtdata
