#include "rtdata/process/vertical_kalman.hpp"

#include <algorithm>
#include <cmath>

namespace rtdata {
namespace {

constexpr double g = 9.80665;
constexpr double fast = 230;          // m/s; from two thirds of the speed of sound on, static ports are wrong
constexpr double long_locked = 22;    // s; after this time the barometer is used again, whatever the estimated speed
constexpr double unknown_speed = 60;  // m/s of deviation: above this, any height would be accepted
constexpr double stretch = 3;         // s
constexpr double longest = 5.7;       // s, for which there is room
constexpr double square(double x) { return x * x; }
constexpr double seconds_of(Duration duration) { return std::chrono::duration<double>(duration).count(); }

/// A polynomial through a stretch of points: its value, slope and curvature at the end, and the residual of the points.
struct Fit {
  double value = 0, slope = 0, curvature = 0, rest = 1e9;
  double value_variance = 0, slope_variance = 0, curvature_variance = 0;  // for points with a variance of 1
  std::size_t count = 0;
  double length = 0;
};

/// The least squares of `degree` 1 or 2 through y at times up to 0.
class Sums {
 public:
  void add(double t, double y) {
    double power = 1;
    for (std::size_t i = 0; i < 5; ++i, power *= t) t_[i] += power;
    y_[0] += y, y_[1] += y * t, y_[2] += y * t * t, yy_ += y * y;
  }
  Fit fit(std::size_t degree) const {
    const std::size_t n = degree + 1;
    std::array<std::array<double, 6>, 3> m{};
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t j = 0; j < n; ++j) m[i][j] = t_[i + j];
      m[i][3 + i] = 1;
    }
    for (std::size_t i = 0; i < n; ++i) {  // its inverse
      const double pivot = m[i][i];
      if (!(std::abs(pivot) > 1e-12)) return {};
      for (double& one : m[i]) one /= pivot;
      for (std::size_t k = 0; k < n; ++k)
        if (const double by = m[k][i]; k != i)
          for (std::size_t j = 0; j < 6; ++j) m[k][j] -= by * m[i][j];
    }
    std::array<double, 3> c{};
    double explained = 0;
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t j = 0; j < n; ++j) c[i] += m[i][3 + j] * y_[j];
      explained += c[i] * y_[i];
    }
    const double freedom = std::max(1.0, t_[0] - double(n));
    return {.value = c[0],
            .slope = c[1],
            .curvature = 2 * c[2],
            .rest = std::sqrt(std::max(0.0, yy_ - explained) / freedom),
            .value_variance = m[0][3],
            .slope_variance = m[1][4],
            .curvature_variance = 4 * m[2][5],
            .count = static_cast<std::size_t>(t_[0])};
  }

 private:
  std::array<double, 5> t_{};
  std::array<double, 3> y_{};
  double yy_ = 0;
};

/// A polynomial through the latest `length` seconds of the filter's heights; with `feels`, of their difference from the
/// path by the accelerometer.
template <class Filter>
Fit fit_of(const Filter& f, double length, std::size_t degree, bool feels) {
  Sums sums;
  double oldest = f.time;
  for (std::size_t i = f.count; i-- > 0;) {
    const auto& point = f.points[(f.first + i) % f.points.size()];
    if (f.time - point.time > length || (feels && point.time < f.path_from)) break;
    oldest = point.time;
    sums.add(point.time - f.time, point.height - f.height - (feels ? point.path - f.path : 0));
  }
  Fit fit = sums.fit(degree);
  fit.length = f.time - oldest;
  if (fit.count < 6 || fit.length < 0.8 * length) return {};
  return fit;
}

}  // namespace

VerticalKalman::VerticalKalman(VerticalKalmanConfig config) : config_(config) {}

void VerticalKalman::reset() noexcept { *this = VerticalKalman(config_); }

void VerticalKalman::take(Time time, VerticalReadings readings) {
  if (!has_begun_) {
    has_begun_ = true;
    start_ = time;
    now_.time = -1;
  }
  const double at = seconds_of(time - start_);
  if (at - now_.time < 1e-6) {  // still the same instant
    now_ = before_;
    if (std::isfinite(readings.height)) latest_.height = readings.height;
    if (std::isfinite(readings.acceleration)) latest_.acceleration = readings.acceleration;
    apply(std::max(at, now_.time), latest_);
    return;
  }
  before_ = now_;
  latest_ = readings;
  apply(at, readings);
}

void VerticalKalman::apply(double time, const VerticalReadings& readings) {
  Filter& f = now_;
  const double passed = f.has_height || f.felt_at > -1e8 ? std::min(time - f.time, 10.0) : 0;
  f.time = time;
  if (passed > 0) predict(passed);
  f.state.accelerometer = std::isfinite(readings.acceleration) ? feel(readings.acceleration) : f.state.accelerometer;
  if (!std::isfinite(readings.acceleration) && time - f.felt_at > 0.5) f.state.accelerometer = false;
  f.state.barometer = BarometerUse::none;
  if (std::isfinite(readings.height)) hear(readings.height);
  f.state.unchanged = f.has_height ? time - f.changed_at : time;
  decide();
  if (f.state.is_flying && !f.is_known) {
    f.p[1][1] = std::max(f.p[1][1], square(300));
    if (!f.state.accelerometer) f.x[1] = f.x[2] = 0;  // nothing is known
  }
  f.state.height = f.x[0];
  f.state.speed = f.x[1];
  f.state.acceleration = f.x[2];
  f.state.height_deviation = std::sqrt(std::max(0.0, f.p[0][0]));
  f.state.speed_deviation = std::sqrt(std::max(0.0, f.p[1][1]));
  // While the barometer is refused and climbs, one of the two sensors is wrong.
  if (f.state.is_flying && f.refused_at > -1e8 && f.state.unchanged < 1) {
    const double sigma = std::max(config_.noise, f.noise);
    Fit fit;
    double unsure = 0;
    for (const double length : {1.2, 2.0, stretch}) {
      const Fit longer = fit_of(f, length, 2, false);
      if (longer.count > 0) fit = longer, unsure = sigma * std::sqrt(fit.slope_variance);
      if (fit.count > 0 && unsure < 2.5) break;
    }
    if (fit.count > 0) {
      const bool is_free = std::abs(fit.curvature + 12) < 10 + 3 * sigma * std::sqrt(fit.curvature_variance);
      if ((is_free || f.felt_times > 3) && fit.slope > 3 && fit.slope - f.x[1] > 8 + unsure)
        f.contested = fit.slope - f.x[1], f.contested_at = f.time;
      else if (f.contested > 0 && fit.rest > 1.8 * sigma + 0.7)  // in a dip it shows nothing
        f.contested_at = f.time;
    } else if (f.contested > 0) {
      f.contested_at = f.time;
    }
  }
  if (f.time - f.contested_at > 1.5 || !f.state.is_flying || f.state.unchanged > 3) f.contested = 0;
  f.state.speed_deviation = std::max(f.state.speed_deviation, f.contested);
}

bool VerticalKalman::coasts() const {
  return now_.state.is_flying && !now_.has_fallen &&
         (now_.has_burnt || now_.time - now_.flew_at > seconds_of(config_.burn));
}

void VerticalKalman::predict(double dt) {
  Filter& f = now_;
  // With an accelerometer, follow its changes. Without one, a freely flying object is slowed by gravity and drag; if it
  // burns, falls or stands, only a change is expected.
  const double lasts = 2;  // s
  const double keeps = f.state.accelerometer ? 1 : std::exp(-dt / lasts);
  const double mean = coasts() ? -g : 0;
  const double spread = coasts() ? 3 + square(f.x[1] / 60) : f.state.is_flying && !f.has_fallen ? 60 : 6;  // m/s2
  const double q = f.state.accelerometer ? 60 : 2 * square(std::min(spread, 60.0)) / lasts;                // (m/s2)2/s
  f.x[0] += dt * f.x[1] + dt * dt / 2 * f.x[2];
  f.x[1] += dt * f.x[2];
  f.x[2] = mean + (f.x[2] - mean) * keeps;
  const std::array<std::array<double, 4>, 4> by = {
      {{1, dt, dt * dt / 2, 0}, {0, 1, dt, 0}, {0, 0, keeps, 0}, {0, 0, 0, 1}}};
  std::array<std::array<double, 4>, 4> half{}, p{};
  for (std::size_t i = 0; i < 4; ++i)
    for (std::size_t j = 0; j < 4; ++j)
      for (std::size_t k = 0; k < 4; ++k) half[i][j] += by[i][k] * f.p[k][j];
  for (std::size_t i = 0; i < 4; ++i)
    for (std::size_t j = 0; j < 4; ++j)
      for (std::size_t k = 0; k < 4; ++k) p[i][j] += half[i][k] * by[j][k];
  const std::array<double, 3> way = {dt * dt / 2, dt, 1};
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < 3; ++j) p[i][j] += way[i] * way[j] * q * dt;
  p[1][1] += 0.02 * dt;
  p[3][3] += square(0.005 * g) * dt;
  f.step = dt;
  // If the axis is not upright, the felt speed is wrong by a part of the gained speed.
  if (f.state.is_flying && f.state.accelerometer && f.felt > 1)
    p[1][1] += 2 * square(0.03) * std::abs(f.gained) * (f.felt - 1) * g * dt;
  p[0][0] = std::min(p[0][0], 1e10), p[1][1] = std::min(p[1][1], 1e7), p[2][2] = std::min(p[2][2], 1e5);
  f.p = p;
  if (f.state.accelerometer) {
    const double a = (f.felt - 1) * g - f.x[3];
    f.path += f.path_speed * dt + a * dt * dt / 2;
    f.path_speed += a * dt;
    if (f.state.is_flying) f.gained += a * dt, f.most = std::max(f.most, f.gained);
  }
  if (!f.state.accelerometer || dt > 0.5) f.path_from = f.time;
}

/// Updates the filter with a measured height, speed or acceleration, or with the felt sum of acceleration and bias.
void VerticalKalman::measure(Measured what, double value, double variance) {
  Filter& f = now_;
  const bool is_felt = what == Measured::felt;
  const std::size_t of = is_felt ? 2 : static_cast<std::size_t>(what);
  std::array<double, 4> column{};
  for (std::size_t i = 0; i < 4; ++i) column[i] = f.p[i][of] + (is_felt ? f.p[i][3] : 0);
  const double s = column[of] + (is_felt ? column[3] : 0) + variance;
  const double rest = value - f.x[of] - (is_felt ? f.x[3] : 0);
  // The start or end of a motor is not a bias: in flight, the bias is learned only from the barometer.
  const bool keeps_bias = is_felt && f.state.is_flying;
  for (std::size_t i = 0; i < (keeps_bias ? 3u : 4u); ++i) f.x[i] += column[i] / s * rest;
  for (std::size_t i = 0; i < 4; ++i)
    for (std::size_t j = 0; j < 4; ++j)
      if (!keeps_bias || i < 3 || j < 3) f.p[i][j] -= column[i] * column[j] / s;
  if (f.state.is_flying) {
    const double most = (f.has_seen_liftoff ? 0.1 : 0.3) * g;
    f.x[3] = std::clamp(f.x[3], f.rest_bias - most, f.rest_bias + most);
  }
}

/// Takes a value of the accelerometer. Returns whether it measures.
bool VerticalKalman::feel(double felt) {
  Filter& f = now_;
  const double passed = std::clamp(f.time - f.felt_at, 0.0, 0.5);
  const bool is_first = f.felt_at < -1e8;
  if (is_first) {
    f.p[2][2] = square(20 * g);
    f.p[3][3] = square(0.08 * g);
    if (!f.has_height) f.p[1][1] = square(300);
  }
  const bool was_silent = f.time - f.felt_at > 0.5;
  const double pause = f.time - f.felt_at;
  if (pause > 0.3 && std::abs(felt - 1) > 0.5) f.paused_at = f.time;
  if (!is_first && pause > 0.3 && pause < f.step + 1e-6 && f.state.is_flying && f.state.accelerometer) {
    // For a pause, only the values at its ends are known; the change was somewhere in between.
    const double before = f.x[2], change = (felt - 1) * g - f.x[3] - before;
    const double unknown = 0.15 * std::max(std::abs(before + g), std::abs(before + g + change)) + 0.5;
    f.x[0] += change * square(pause) / 6, f.x[1] += change * pause / 2, f.x[2] += change;
    f.gained += change * pause / 2;
    const std::array<double, 2> way = {pause / 2, 1};
    for (std::size_t i = 0; i < 2; ++i)
      for (std::size_t j = 0; j < 2; ++j)
        f.p[i][j] += way[i] * way[j] * square(pause) * (square(change) / 12 + square(unknown));
  }
  f.felt_at = f.time;
  if (felt != f.felt || is_first || was_silent) {
    f.felt_since = f.time, f.felt_times = 0, f.is_stuck = false;
    f.felt_before = is_first ? 1 : f.felt;
    f.gained_before = f.gained, f.most_before = f.most;
  }
  ++f.felt_times;
  f.felt = felt;
  f.felt_mean += (felt - f.felt_mean) * (is_first || was_silent ? 1 : std::min(1.0, passed / 0.3));
  if (felt > f.upper_end) f.upper_end = 1e9;
  if (felt < f.lower_end) f.lower_end = -1e9;
  f.highest = std::max(f.highest, felt), f.lowest = std::min(f.lowest, felt);
  const double same = f.time - f.felt_since;
  if (std::abs(felt) > 1.5 && (f.felt_times > 2 || felt >= f.upper_end || felt <= f.lower_end)) f.ended_at = f.time;
  if (config_.range > 0) {
    f.upper_end = 0.98 * config_.range, f.lower_end = -f.upper_end;
  } else if (f.felt_times >= 3 && same > 0.15 && std::abs(felt) > 1.5) {
    double& end = felt > 0 ? f.upper_end : f.lower_end;
    if (std::abs(end) > 1e8 && (felt > 0 ? felt >= f.highest : felt <= f.lowest)) {
      end = felt;
      f.p[1][1] += square(same * 8 * g);  // it was used until now
    }
  }
  const bool may_rest = !f.state.is_flying && std::abs(felt - 1) < 0.3;  // a coarse one on the ground
  if (same > 2 && f.felt_times > 4 && !may_rest) {
    if (!f.is_stuck) f.p[1][1] += square(std::min(same, f.time - f.flew_at + 2) * g);
    if (!f.is_stuck) f.gained = f.gained_before, f.most = f.most_before;
    f.is_stuck = true;
    return false;
  }
  if (felt >= f.upper_end || felt <= f.lower_end) {
    // The true value is beyond this end.
    const double least = (felt - 1) * g;
    if (felt > 0 ? f.x[2] < least : f.x[2] > least) measure(Measured::acceleration, least, square(2));
    if (!f.state.is_flying) return false;
    // It may be 20 g all the time: this is not noise that averages out.
    f.beyond += passed;
    f.p[1][1] += square(10 * g) * (square(f.beyond) - square(f.beyond - passed));
    if (f.beyond > 0.25) f.is_known = false;
    return false;
  }
  // Without a motor only drag is felt, below 0, until the object hangs on a parachute: larger values mean that the
  // sensor has drifted.
  const double above = felt - f.x[3] / g;
  if (!f.has_burnt || above < 0.3 || above > 1.6 || f.state.unchanged > 0.5) f.low_at = f.time;
  if (f.time - f.low_at > 1) f.is_doubted = true;
  if (f.is_doubted || f.has_fallen) return false;
  if (f.state.is_flying && f.felt_mean < 0.5 && f.gained > 12) f.has_burnt = true;
  // Follow the start or end of a motor at once; between two values it may have been at any time.
  const double a = (felt - 1) * g, rest = a - f.x[2] - f.x[3];
  if (square(rest) > 9 * (f.p[2][2] + f.p[3][3] + square(0.8))) {
    const std::array<double, 3> way = {passed * passed / 6, passed / 2, 1};
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t j = 0; j < 3; ++j) f.p[i][j] += way[i] * way[j] * square(rest);
    f.p[1][1] += square(rest * passed) / 12;
  }
  measure(Measured::felt, a, square(0.8));
  return true;
}

void VerticalKalman::begin(double height) {
  Filter& f = now_;
  f.x[0] = height;
  if (!f.has_height) {
    f.height = f.height_before = height;
    f.changed_at = f.changed_before = f.time;
  }
  f.has_height = true;
  f.p[0][0] = square(std::max(2.0, 2 * f.noise));
  f.p[1][1] = std::max(f.p[1][1], square(300));
  f.p[2][2] = std::max(f.p[2][2], square(20 * g));
  if (f.felt_at < -1e8) f.p[3][3] = square(0.08 * g);
}

void VerticalKalman::keep(double time, double height, double path) {
  Filter& f = now_;
  if (f.count > 0) {
    const Point& last = f.points[(f.first + f.count - 1) % room];
    if (time - last.time < 2 * stretch / double(room - 2)) return;
    if (time - last.time > 0.7) f.count = 0;  // a gap
  }
  if (f.count == room) f.first = (f.first + 1) % room, --f.count;
  f.points[(f.first + f.count) % room] = {time, height, path};
  ++f.count;
}

void VerticalKalman::hear(double height) {
  Filter& f = now_;
  const bool is_first = !f.has_height;
  if (is_first) begin(height);
  const bool was_silent = f.time - f.heard_at > 0.7;
  f.heard_at = f.time;
  if (!is_first && height == f.height && (f.state.is_flying || f.time - f.changed_at < 0.2))
    return;  // it repeats itself
  if (height != f.height || is_first) {
    // From the second differences, which contain neither height nor speed.
    const double step = f.time - f.changed_at, before = f.changed_at - f.changed_before;
    if (!was_silent && step > 0 && before > 0 && step < 0.4 && before < 0.4) {
      const double second = (height - f.height) - (f.height - f.height_before) * step / before;
      const double scale = std::sqrt(1 + square(step / before) + square(1 + step / before));
      const double weight = std::max(1.0 / double(++f.steps), std::min(1.0, step / 3));
      f.noise += (std::min(std::abs(second) / scale * 1.25, std::max(3 * f.noise, 5.0)) - f.noise) * weight;
    }
    f.height_before = f.height, f.changed_before = f.changed_at;
    f.height = height, f.changed_at = f.time;
  }
  // In the stretch, each height is the median of three, so that a single wrong height has no effect.
  double middle = height;
  if (f.time - f.third[1].time < 0.5) {
    middle = std::max(std::min(f.third[0].height, height),
                      std::min(std::max(f.third[0].height, height), f.third[1].height));
    keep(f.third[1].time, middle, f.third[1].path);
  }
  f.middle = middle;
  f.third[0] = f.third[1];
  f.third[1] = {f.time, height, f.path};
  const double sigma = std::max(config_.noise, f.noise);
  const double interval = std::clamp(f.changed_at - f.changed_before, 0.001, 0.5);
  // The error of a static port at speed is not noise that averages out; neither is that of moving air.
  const double port = !f.state.is_flying      ? 0
                      : f.state.accelerometer ? 0.05 * std::clamp(f.x[1] - 60, 0.0, 300.0)
                                              : 4 * square(std::min(f.x[1], 300.0) / 200);
  const double variance = square(sigma) * std::max(1.0, 0.05 / interval) +
                          square(port) * std::max(1.0, 0.3 / interval) + square(0.5);
  if (!f.state.is_flying && f.stood_for < 2) {  // nothing is known yet
    f.x[0] = height, f.p[0][0] = variance;
    f.state.barometer = BarometerUse::used;
    return;
  }
  if (!f.state.is_flying) {
    if (std::abs(middle - f.x[0]) > 50 && f.state.accelerometer) {  // carried
      for (std::size_t i = 0; i < 4; ++i) f.p[0][i] = f.p[i][0] = 0;
      f.x[0] = middle, f.p[0][0] = variance;
    }
    measure(Measured::height, middle, variance);
    f.state.barometer = BarometerUse::used;
    return;
  }
  const double speed_deviation = std::sqrt(f.p[1][1]);
  if (speed_deviation > unknown_speed) f.is_known = false;
  const bool is_near_sound = f.is_known && f.has_seen_liftoff && f.state.accelerometer && f.x[1] > fast;
  if (is_near_sound && f.locked_at < -1e8) f.locked_at = f.time;
  if (f.x[1] < 0.8 * fast) f.locked_at = -1e9;
  if (is_near_sound && f.time - f.locked_at < long_locked) {
    f.state.barometer = BarometerUse::locked;
    f.refused_at = -1e9;
    return;
  }
  const bool is_locked = f.has_seen_liftoff && f.time - f.flew_at < seconds_of(config_.burn) &&
                         (f.is_known ? !f.state.accelerometer && (!f.has_burnt || f.refused_at > -1e8)
                                     : !(f.state.accelerometer && f.felt < 0.5));
  if (f.is_known && is_locked) {
    f.state.barometer = BarometerUse::locked;
    return;
  }
  if (!f.is_known) {
    f.state.barometer = is_locked ? BarometerUse::locked : BarometerUse::refused;
    if (!is_locked && believe()) f.state.barometer = BarometerUse::used;
    return;
  }
  const double rest = height - f.x[0];
  // After some time without it, a single height is not enough: a stretch of heights must follow the felt path.
  if (f.p[0][0] > square(5 * sigma + 8)) {
    const bool feels = f.state.accelerometer;
    const Fit fit = feels ? fit_of(f, speed_deviation > 5 + sigma / 2 ? stretch : 1.2, 1, true)
                          : fit_of(f, 1.2, 2, false);
    if (fit.count == 0 || fit.rest > 1.8 * sigma + 0.7 + 0.015 * std::abs(f.x[1]) ||
        std::abs(fit.slope + (feels ? f.path_speed : 0) - f.x[1]) > 3 * speed_deviation + 4) {
      if (f.refused_at < -1e8) f.refused_at = f.time;
      f.state.barometer = believe() ? BarometerUse::used : BarometerUse::refused;
      return;
    }
  }
  f.rest_mean += (rest - f.rest_mean) * std::min(1.0, interval / 0.25);
  const double systematic = f.p[0][0] + square(port);
  if (std::abs(rest) < 5 * std::sqrt(systematic + square(sigma) + 0.25) &&
      std::abs(f.rest_mean) < 4 * std::sqrt(systematic + square(sigma) * std::min(1.0, interval / 0.5)) + 1) {
    measure(Measured::height, height, variance);
    // An object that still climbs is slowed only by gravity and drag.
    if (!f.state.accelerometer && coasts())
      f.x[2] = std::clamp(f.x[2], -g - 8 - 0.0006 * square(f.x[1]), f.x[1] > 0 ? -g + 5 : 10.0);
    f.refused_at = -1e9;
    f.state.barometer = BarometerUse::used;
    return;
  }
  if (f.refused_at < -1e8) f.refused_at = f.time;
  f.state.barometer = BarometerUse::refused;
  if (believe()) f.state.barometer = BarometerUse::used;
}

/// Returns whether a stretch of ignored heights is accepted; the filter then continues from it.
bool VerticalKalman::believe() {
  Filter& f = now_;
  if (f.count < 8) return false;
  const double refused = f.refused_at > -1e8 ? f.time - f.refused_at : 1e9;
  const bool feels = f.state.accelerometer && !f.has_fallen;
  // With an accelerometer, the refused heights may be a dip of up to 5 s; without one, of up to 1 s.
  const bool may_burn = f.has_seen_liftoff && f.time - f.flew_at < seconds_of(config_.burn);
  if (f.is_known && (refused < (feels ? 5.5 : 2) || (!feels && may_burn))) return false;
  const double sigma = std::max(config_.noise, f.noise);
  const auto begin_from = [&](const Fit& fit, double speed, double acceleration) {
    f.p = {};
    f.p[0][0] = square(sigma) * fit.value_variance + 1;
    f.p[1][1] = square(2 * sigma) * fit.slope_variance + square(2) + square(2 * fit.rest);
    f.p[2][2] = square(4);
    f.x[0] = f.height + fit.value, f.x[1] = speed, f.x[2] = acceleration;
    f.refused_at = -1e9;
    f.rest_mean = f.contested = 0;
    f.is_known = true;
    return true;
  };
  // An object that falls this fast must have fallen for the corresponding time.
  const double flown = f.has_seen_liftoff ? f.time - f.flew_at + 1 : 1e9;
  const auto is_possible = [&](double speed) { return speed > -(g * flown + 10) && speed < 1500; };
  if (feels) {
    for (const double length : {f.has_seen_liftoff ? stretch : 1.2, stretch, longest}) {
      if (f.time - f.path_from < 0.8 * length) break;
      const Fit fit = fit_of(f, length, 1, true);
      if (fit.count == 0) break;
      const double speed = fit.slope + f.path_speed;
      // Dips of 5 s are curved, the more the steeper they are.
      const double most = 1.8 * sigma + 0.7 + 0.015 * std::abs(speed);
      const bool is_long = speed > -25 || length > 5 || (length > 2.9 && (speed < -10 - 5 * most || sigma < 1.4)) ||
                           (f.hangs_since > -1e8 && f.time - f.hangs_since > 1.5);
      if (!is_long || fit.rest > most || !is_possible(speed)) continue;
      const double bias = f.p[3][3];
      begin_from(fit, speed, f.x[2]);
      f.p[3][3] = bias;
      return true;
    }
  }
  // The barometer alone, against the accelerometer: if this lasts long, the accelerometer has drifted or is stuck.
  if (feels && f.is_known && refused < 6) return false;
  const double by_itself = f.has_seen_liftoff ? 12 : 6;  // s, since the liftoff, or since it began in flight
  if (feels && !f.is_known && (f.time - f.flew_at < by_itself || f.time - f.path_from < by_itself - 5)) return false;
  Fit fit;
  for (double length = feels ? stretch : 2; fit.count == 0; length = std::min(1.3 * length, longest)) {
    fit = fit_of(f, length, 2, false);
    if (fit.count == 0) return false;
    const double most = std::abs(fit.slope) < 10 ? 1.2 : 2.5;  // m/s2, the curvature that noise may cause
    if (length < longest && sigma * std::sqrt(fit.curvature_variance) > most) fit = {};
  }
  if (fit.rest > 1.8 * sigma + 0.7) return false;
  // Drag this large means that the object is fast.
  const bool is_clipped = f.felt <= f.lower_end && std::abs(f.upper_end + f.lower_end) < 0.05 * f.upper_end;
  if (f.time - f.felt_at < 0.5 && (!f.is_stuck || is_clipped) && f.felt_mean < -0.7 && fit.slope < 0 &&
      f.time - f.flew_at < 15)
    return false;
  if (!is_possible(fit.slope) || std::abs(fit.curvature) > 60) return false;
  // An object that still climbs is slowed only by gravity and drag.
  if (!f.has_fallen && f.time - f.flew_at > 7 && fit.slope > -5 &&
      (fit.curvature > -5 || fit.curvature < -15 - 0.002 * square(fit.slope)))
    return false;
  if (!f.has_fallen && std::abs(fit.slope) < 3 && std::abs(fit.curvature) < 3) return false;  // stuck, or on the ground
  begin_from(fit, fit.slope, fit.curvature);
  f.has_burnt = f.has_burnt || fit.curvature < -5;
  f.is_doubted = f.is_doubted || feels;
  return true;
}

/// `is_felt`: the accelerometer has measured its speed from the ground on.
void VerticalKalman::lift_off(bool is_felt) {
  Filter& f = now_;
  f.state.is_flying = true;
  f.has_seen_liftoff = f.stood_for >= 2;
  f.rest_bias = f.has_seen_liftoff ? f.x[3] : 0;
  f.flew_at = is_felt ? f.time : f.time - 1;
  f.gained = f.most = f.gained_before = f.most_before = f.beyond = 0;
  f.highest_heard = f.height;
  f.has_fallen = f.is_doubted = f.has_burnt = false;
  f.still_since = f.hangs_since = -1e9;
  f.refused_at = f.locked_at = -1e9;
  f.is_known = is_felt;
  if (is_felt) return;
  for (std::size_t i = 0; i < 4; ++i) f.p[1][i] = f.p[i][1] = 0;
  f.x[1] = 0;
}

/// Decides whether it stands or flies.
void VerticalKalman::decide() {
  Filter& f = now_;
  const auto held = [&](double& since, bool is, double seconds) {
    if (!is) since = -1e9;
    if (is && since < -1e8) since = f.time;
    return is && f.time - since >= seconds;
  };
  const bool feels = f.state.accelerometer;
  const double deviation = std::sqrt(std::max(0.0, f.p[1][1]));
  if (!f.state.is_flying) {
    if (std::abs(f.felt_mean - 1) > 0.4 || std::abs(f.felt - 1) > 1) f.moved_at = f.time;
    const bool rests = feels && f.time - f.moved_at > 0.5;
    if (rests && f.stood_for >= 2) {
      measure(Measured::speed, 0, square(0.5));
      measure(Measured::acceleration, 0, square(0.5));  // the felt value minus 1 g is the bias
      f.p[3][3] = std::max(f.p[3][3], square(0.01 * g));
    }
    const double passed = f.stood_at > -1e8 ? std::min(f.time - f.stood_at, 0.5) : 0;
    f.stood_at = f.time;
    const bool is_new = f.stood_for < 2, is_young = f.stood_for < 30;
    const bool has_heard = f.has_height && f.time - f.heard_at < 0.5;
    // Does the height change, or is its curve that of free fall?
    bool moves = false, is_heard_still = false;
    if (has_heard) {
      const double sigma = std::max(config_.noise, f.noise);
      const Fit second = fit_of(f, 1, 1, false), longer = fit_of(f, 2.5, 1, false);
      const auto is_fast = [&](const Fit& fit, double least) {  // if it has stood for long, only upwards
        return fit.count > 0 &&
               (is_young ? std::abs(fit.slope) : fit.slope) > least + 4 * sigma * std::sqrt(fit.slope_variance);
      };
      moves = is_fast(second, 12) || (is_new && is_fast(longer, 4));
      is_heard_still = (second.count > 0 || longer.count > 0) && !moves;
      if (is_new && feels && f.felt_mean < 0.5)
        for (const double length : {1.2, 2.4}) {
          const Fit bent = fit_of(f, length, 2, false);
          moves = moves || (bent.count > 0 && bent.rest < 1.8 * sigma + 0.7 &&
                            bent.curvature + 2.5 * sigma * std::sqrt(bent.curvature_variance) < -3);
        }
    }
    const bool stands = is_new  ? (feels ? rests && !moves : is_heard_still)
                        : feels ? rests
                                : std::abs(f.x[1]) < 5 && deviation < 10;
    if (stands) {
      f.stood_for += passed;
      if (is_new && f.stood_for >= 2) {
        f.x[1] = f.x[2] = 0;
        f.p[1][1] = square(feels ? 1 : 15), f.p[2][2] = square(feels ? 1 : 5);
        for (std::size_t i = 0; i < 4; ++i)
          for (std::size_t j = 0; j < 4; ++j)
            if (i != j) f.p[i][j] = 0;
      }
      if (f.has_height && f.stood_for >= 2) {
        if (!std::isfinite(f.state.ground)) f.state.ground = f.x[0];
        f.state.ground += (f.x[0] - f.state.ground) * std::min(1.0, passed / 5);
      }
    } else if (is_new) {
      f.stood_for = 0;
      f.x[1] = f.x[2] = 0;
      f.p[1][1] = square(300);
    }
    const bool is_thrust = f.time - f.felt_at < 0.5 && f.felt > 1.8 && !f.is_stuck;
    // A constant value may be the end of the range, or a stuck sensor: the barometer decides.
    const bool is_same = f.felt_times > 2 && has_heard && std::abs(f.felt_before - 1) < 0.5;
    const bool climbs = moves || f.middle - f.state.ground > 1 + 3 * std::max(config_.noise, f.noise);
    if (held(f.thrust_since, is_thrust && (!is_same || climbs),
             is_same  ? 0
             : is_new ? 0.15
                      : 0.3) ||
        (is_thrust && !is_same && f.x[1] > 8 + deviation && !is_new))
      return lift_off(feels && !is_same && !is_new && deviation < 20 && f.time - f.ended_at > 3 &&
                      f.time - f.paused_at > 1);
    if (held(f.rises_since, moves && f.time - f.changed_at < 0.5 && (!rests || is_new || f.time - f.felt_since > 2),
             is_new ? 0.3 : 0.5))
      return lift_off(false);
    const bool is_up = !is_new && has_heard && f.x[0] - f.state.ground > 25 + 4 * std::max(config_.noise, f.noise);
    if (held(f.up_since, is_up && !rests, 0.3)) return lift_off(false);
    // It moves, whatever the accelerometer shows.
    bool is_contrary = false;
    if (rests && f.count > 8 && f.time - f.points[f.first].time > stretch) {
      const Fit fit = fit_of(f, stretch, 1, false);
      is_contrary = fit.slope > 15 || (is_young && fit.slope < -8);
    }
    if (held(f.contrary_since, is_contrary, 1.5)) return lift_off(false);
    return;
  }
  if (f.x[1] + deviation < -3 && f.time - f.flew_at > 2 && !f.has_fallen) f.has_fallen = true, f.fell_at = f.time;
  // For seconds it feels as on the ground, and the felt speed is low: it hangs on a parachute.
  const double mean = f.felt_mean - f.x[3] / g;
  const bool hangs = feels && !f.has_fallen && f.time - f.flew_at > 3 && mean > 0.5 && mean < 1.6;
  if (held(f.hangs_since, hangs, 1.5)) {
    if (f.state.unchanged > 1 && f.gained < f.most / 3) f.x[1] = -15, f.p[1][1] = square(10);
    if (f.refused_at > -1e8) f.is_known = false;  // a stretch of the barometer is enough
  }
  // It stands still: the barometer shows this for seconds, after a fall or if no flight was felt.
  f.highest_heard = std::max(f.highest_heard, f.height);
  if (std::abs(f.height - f.still_height) > 2.5) f.still_height = f.height, f.stays_since = f.time;
  const bool has_flown = !f.has_fallen && f.most > 12;
  const Fit fit = has_flown ? Fit() : fit_of(f, longest, 1, false);
  const bool has_sunk = f.highest_heard - f.height > 15;
  const bool is_still = fit.count > 0 && std::abs(fit.slope) < 2 && f.state.unchanged < 1 &&
                        (has_sunk || !f.has_fallen);
  // For a coarse or stuck barometer: it has come down to the ground.
  const double above = f.height - f.state.ground;
  const bool is_low = f.has_fallen && has_sunk && f.changed_at > f.fell_at &&
                      (above < 30 || (above < 100 && f.x[0] < f.state.ground));
  const bool rests = feels && std::abs(f.felt - 1) < 0.4 && f.most < 12 && f.state.unchanged > 5;
  if ((held(f.still_since, is_still || rests, is_still ? 3 : 5) || (is_low && f.time - f.stays_since > 8)) &&
      f.time - f.flew_at > 5) {
    f.state.ground = VerticalReadings::none;
    f.state.is_flying = false;
    f.stood_for = 0;
    f.x[1] = 0;
    f.thrust_since = f.rises_since = f.contrary_since = f.up_since = -1e9;
    f.is_doubted = false;
  }
}

}  // namespace rtdata
