/// Flights at random, with what is wrong with their sensors: for a campaign, so each takes less than a millisecond.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <random>
#include <string>
#include <vector>

namespace rtdata::test {

struct RandomRow {
  double time = 0;
  double altitude = 0, acceleration = 0;  // NaN: none
};

struct RandomFlight {
  std::string what;  // is wrong with it
  std::vector<RandomRow> rows = {};
  double liftoff = 0, burnout = 0, apogee = 0, landing = 0, height = 0, fastest = 0;  // s, m, m/s
  double killed = 1e9, back = 1e9;                                                    // s; no rows between
  bool has_barometer = true, has_accelerometer = true;
  bool has_both = true;  // for all of the flight, whatever their values
  /// One of both sensors works: the accelerometer without a clip, a kill, or a gap while the motor burns; or the
  /// barometer for 4 s without a disturbance, after the apogee and `burn`, before the rocket is on the ground.
  bool works = true;
  bool is_calm = true;  // the barometer, from 2.5 s before the apogee until 2.5 s after it
};

namespace random_flights {

constexpr double g = 9.80665;
constexpr double none = std::numeric_limits<double>::quiet_NaN();

class Chance {
 public:
  explicit Chance(std::uint64_t seed) : random_(seed) {}
  double between(double least, double most) {
    return least + (most - least) * (static_cast<double>(random_() >> 11) * 0x1p-53);
  }
  double grows(double least, double most) { return std::exp(between(std::log(least), std::log(most))); }
  bool is(double probability) { return between(0, 1) < probability; }
  double normal() {
    if (has_spare_) return has_spare_ = false, spare_;
    const double r = std::sqrt(-2 * std::log(1 - between(0, 1))), a = between(0, 2 * std::numbers::pi);
    has_spare_ = true, spare_ = r * std::sin(a);
    return r * std::cos(a);
  }

 private:
  std::mt19937_64 random_;
  double spare_ = 0;
  bool has_spare_ = false;
};

struct Moment {
  float height = 0, speed = 0, mach = 0, felt = 1;
};
constexpr double step = 0.004;

struct Body {
  double pad = 8, peak = 8, burn = 2, drag = 2e-4, tilt = 0, fall = 20, opens = 1, pause = 0;
};

struct Path {
  std::vector<Moment> moments;
  double liftoff = 0, apogee = 0, landing = 1e9, height = 0, fastest = 0, mach = 0;
};

/// Until `after` s after the apogee.
inline Path path_of(const Body& body, double after) {
  Path path;
  double across = 0, x = 0, height = 0, speed = 0;
  double axis_x = std::sin(body.tilt), axis_z = std::cos(body.tilt);
  for (std::size_t i = 0;; ++i) {
    const double t = static_cast<double>(i) * step;
    double felt = axis_z, mach = 0;
    if (t >= body.pad) {
      const double density = std::exp(-height / 8500);
      const double total = std::hypot(across, speed);
      mach = total / std::max(295.0, 340 - 0.0041 * height);
      double burnt = t - body.pad;
      bool burns = burnt < body.burn + body.pause;
      if (body.pause > 0 && burnt > body.burn / 2) {
        burns = burns && burnt > body.burn / 2 + body.pause;
        burnt -= burns ? body.pause : 0;
      }
      const double push = burns ? body.peak * std::min(std::clamp(burnt / std::min(0.3, 0.1 * body.burn), 0.0, 1.0),
                                                       std::clamp((body.burn - burnt) / (0.2 * body.burn), 0.0, 1.0))
                                : 0;
      const double transonic = 1 + 0.8 * std::exp(-std::pow((mach - 1.05) / 0.15, 2));
      const double drag = body.drag * transonic * density * total * total / g;
      if (path.liftoff == 0 && push > axis_z) path.liftoff = t;
      if (t > path.landing) {
        felt = 1;
      } else if (path.liftoff > 0) {
        if (path.apogee > 0 && t >= path.apogee + body.opens) {
          const double target = -body.fall * std::sqrt(1 / density);
          felt = std::clamp(1 + (target - speed) / (g * 0.3), -20.0, 20.0);
          speed += (felt - 1) * g * step;
          across -= across * step;
        } else {
          felt = push - drag;
          const bool is_guided = std::hypot(x, height) < 2;
          if (!is_guided && total > 1) axis_x = across / total, axis_z = speed / total;
          const double along = felt * g - (is_guided ? g * axis_z : 0);
          across += along * axis_x * step;
          speed += (along * axis_z - (is_guided ? 0 : g)) * step;
          if (path.apogee > 0) felt = -felt * 0.3;  // it tumbles
        }
        x += across * step;
        height = std::max(0.0, height + speed * step);
        path.fastest = std::max(path.fastest, speed), path.mach = std::max(path.mach, mach);
        if (path.apogee == 0 && t > path.liftoff + 0.1 && speed <= 0) path.apogee = t, path.height = height;
        if (path.apogee > 0 && height <= 0) path.landing = t, speed = 0;
      }
    }
    path.moments.push_back({float(height), float(speed), float(mach), float(felt)});
    if (path.apogee > 0 && t > std::min(path.apogee + after, path.landing + 5)) return path;
    if (t > body.pad + 20 && path.liftoff == 0) return path;
    if (t > body.pad + 250) return path;
  }
}

/// A dip: so deep, half a sine or a triangle or with a flat bottom.
struct Dip {
  double from = 0, length = 1, depth = 0;
  int shape = 0;
  double at(double t) const {
    const double u = (t - from) / length;
    if (u <= 0 || u >= 1) return 0;
    if (shape == 0) return depth * std::sin(std::numbers::pi * u);
    if (shape == 1) return depth * (1 - std::abs(2 * u - 1));
    return depth * std::clamp(std::min(u, 1 - u) * 10, 0.0, 1.0);
  }
};

}  // namespace random_flights

enum class RandomSensors { both, barometer, accelerometer };

/// The same for the same seed.
inline RandomFlight random_flight(std::uint64_t seed) {
  using namespace random_flights;
  Chance chance(seed * 0x9E3779B97F4A7C15u + 12345);
  RandomFlight flight;
  const auto say = [&](const char* what) { flight.what += (flight.what.empty() ? "" : ", ") + std::string(what); };
  Body body;
  Path path;
  const bool is_fast = chance.is(0.35);
  for (;;) {
    body.pad = chance.between(6, 20);
    body.peak = chance.between(3, 20);
    body.burn = chance.grows(0.3, 8);
    body.drag = chance.grows(5e-5, 1e-3);
    body.tilt = (chance.is(0.2) ? chance.between(6, 20) : chance.between(0, 6)) * std::numbers::pi / 180;
    body.fall = chance.between(5, 40);
    body.opens = chance.is(0.5) ? 1e9 : chance.between(0.3, 2);  // by another altimeter
    body.pause = chance.is(0.1) ? chance.between(0.2, 2) : 0;
    const double gained = (body.peak * 0.85 - 1) * g * body.burn;
    if (gained < 40 || (is_fast && gained < 350) || gained > 1200) continue;
    path = path_of(body, 75);
    if (path.liftoff == 0 || path.apogee == 0 || path.height < 60 || path.height > 15000) continue;
    if (path.apogee < body.pad + body.burn + body.pause + 1) continue;
    if (is_fast != (path.mach > 0.95)) continue;
    break;
  }
  flight.liftoff = path.liftoff, flight.burnout = body.pad + body.burn + body.pause, flight.apogee = path.apogee;
  flight.height = path.height, flight.fastest = path.fastest, flight.landing = path.landing;

  const double draw = chance.between(0, 1);
  const auto sensors = draw < 0.86   ? RandomSensors::both
                       : draw < 0.98 ? RandomSensors::barometer
                                     : RandomSensors::accelerometer;
  const bool has_both = sensors == RandomSensors::both;
  flight.has_barometer = sensors != RandomSensors::accelerometer;
  flight.has_accelerometer = sensors != RandomSensors::barometer;
  if (sensors == RandomSensors::barometer) say("barometer only");
  if (sensors == RandomSensors::accelerometer) say("accelerometer only");

  // Of the barometer.
  const double rate = chance.grows(10, 200);
  const double noise = chance.grows(0.1, 5);
  const double lag = chance.is(0.2) ? chance.between(0.05, 0.3) : 0;
  const double base = chance.between(-200, 2500);
  const double grain = chance.is(0.2) ? chance.between(0.1, 1) : 0;
  const double slow = chance.is(0.15) ? chance.between(8, 25) : 0;  // its rate; rows between repeat it
  std::vector<Dip> dips;
  const auto dip_at = [&](double from, double length) {
    dips.push_back({from, length, chance.grows(20, 1000) * (chance.is(0.85) ? 1 : -1), int(chance.between(0, 3))});
  };
  if (path.mach > 0.95) {  // each time it passes Mach 1
    bool was_above = false;
    const double length = has_both ? chance.between(0.5, 5) : 1;
    for (std::size_t i = 0; i < path.moments.size(); ++i) {
      const double t = static_cast<double>(i) * step;
      if (t > path.apogee) break;
      const bool is_above = path.moments[i].mach > 1;
      if (is_above != was_above) {
        const double left = path.liftoff + 7 - t;
        dip_at(t, has_both ? length : left > 0.5 ? chance.between(0.3, std::min(left, 5.0)) : chance.between(0.2, 1));
      }
      was_above = is_above;
    }
  }
  if (flight.has_barometer && chance.is(0.35)) {
    say("dip");
    if (has_both) {
      dip_at(chance.between(path.liftoff, path.apogee + 1), chance.between(0.3, 5));
    } else if (chance.is(0.5)) {
      const double length = chance.between(0.3, 5);
      dip_at(path.liftoff + chance.between(0, 7 - length), length);
    } else {
      const double from = path.liftoff + chance.between(0, std::max(0.1, path.apogee - path.liftoff - 3));
      dip_at(from, chance.between(0.2, 1));
    }
  }
  double dead = 1e9, frozen = 1e9, frozen_until = 1e9;
  double spikes = 1e9;
  if (chance.is(0.1)) spikes = chance.between(1, 3), say("spikes");
  // One sensor may be taken away for good, of two.
  bool is_barometer_lost = sensors == RandomSensors::accelerometer;
  bool is_accelerometer_lost = sensors == RandomSensors::barometer;
  if (flight.has_barometer && chance.is(0.25)) {
    if (has_both && chance.is(0.35)) {
      is_barometer_lost = true;
      const double from = chance.between(0, path.apogee + 1);
      if (chance.is(0.5))
        dead = from, say("barometer dies");
      else
        frozen = from, say("barometer freezes");
    } else {
      frozen = chance.between(path.liftoff, path.apogee);
      frozen_until = frozen + chance.between(0.3, has_both ? 5 : 2);
      if (!has_both && frozen_until > path.apogee - 2.5) frozen_until = std::max(frozen, path.apogee - 2.5);
      say("barometer freezes for a while");
    }
  }
  // Of the accelerometer.
  double range = chance.is(0.5) ? 16 : 50, silent = 1e9, stuck = 1e9, adrift = 1e9, drift = 0;
  double stuck_at = 0;
  double bias = chance.is(0.1) ? chance.between(-0.3, 0.3) : chance.between(-0.05, 0.05);
  const double shake = chance.grows(0.01, 0.15);
  if (range < body.peak) range = 50;
  if (has_both && !is_barometer_lost && chance.is(0.4)) {
    const double kind = chance.between(0, 4);
    const double from = chance.between(0, path.apogee + 1);
    if (kind < 1.6) {
      range = chance.is(0.7) ? 2 : chance.between(2, 8), say("clipped");
    } else if (kind < 2.4) {
      silent = from, say("accelerometer falls silent"), is_accelerometer_lost = true;
    } else if (kind < 3.2) {
      stuck = from, stuck_at = chance.is(0.3) ? -1e9 : chance.between(-2, 4), say("accelerometer sticks");
      is_accelerometer_lost = true;
    } else {
      adrift = from, drift = chance.grows(0.005, 0.1) * (chance.is(0.5) ? 1 : -1), say("accelerometer drifts");
      is_accelerometer_lost = true;
    }
  }
  if (is_accelerometer_lost)  // as with a barometer alone
    for (Dip& dip : dips) {
      const double left = path.liftoff + 7 - dip.from;
      if (left > 0.3)
        dip.length = std::min(dip.length, left);
      else
        dip.length = std::min(dip.length, 1.0);
      if (dip.from + dip.length > path.liftoff + 7 && dip.from + dip.length > path.apogee - 2.5) dip.depth = 0;
    }
  if (is_accelerometer_lost && frozen_until < 1e8) {
    frozen_until = std::min(frozen_until, frozen + 2);
    if (frozen_until > path.apogee - 2.5) frozen_until = frozen;
  }
  double gap = 1e9, gap_length = 0;
  if (chance.is(0.2)) {
    gap = chance.between(1, path.apogee + 1), gap_length = chance.between(0.2, 2);
    say("gap");
  }
  // What is felt alone, and not while it is lifted, says nothing.
  if (is_barometer_lost && gap < flight.burnout && gap + gap_length > path.liftoff - 0.5) gap = flight.burnout;
  if (chance.is(0.04) && !(has_both && is_barometer_lost) && flight.has_barometer) {
    flight.killed = chance.between(path.liftoff - 1, path.apogee + 0.5);
    flight.back = flight.killed + chance.between(0.2, 1);
    say("killed");
  }

  double shown = 0, next = chance.between(0, 1 / rate), next_slow = 0, held = none, frozen_altitude = none;
  double next_spike = spikes;
  for (std::size_t i = 0; i < path.moments.size(); ++i) {
    const double t = static_cast<double>(i) * step;
    const Moment& now = path.moments[i];
    double error = 0;
    for (const Dip& dip : dips) error -= dip.at(t);
    shown = i == 0 || lag == 0 ? now.height + error : shown + (now.height + error - shown) * std::min(1.0, step / lag);
    while (next <= t) {
      const double at = next;
      next += 1 / (at < path.apogee + 25 ? rate : 10);
      if (at < 0) continue;
      double altitude = base + shown + noise * chance.normal();
      if (at > next_spike) altitude += chance.is(0.5) ? 100 : -100, next_spike = at + spikes * chance.between(0.5, 1.5);
      if (grain > 0) altitude = grain * std::round(altitude / grain);
      if (slow > 0) {
        if (at >= next_slow || std::isnan(held)) held = altitude, next_slow = at + 1 / slow;
        altitude = held;
      }
      double felt = now.felt + bias + shake * chance.normal();
      if (at > adrift) felt += drift * (at - adrift);
      if (at > stuck) {
        if (stuck_at < -1e8) stuck_at = std::clamp(felt, -range, range);
        felt = stuck_at;
      }
      felt = std::clamp(felt, -range, range);
      if (at > silent) felt = none;
      if (at > frozen && at < frozen_until) {
        if (std::isnan(frozen_altitude)) frozen_altitude = altitude;
        altitude = frozen_altitude;
      }
      if (at > dead) altitude = none;
      if (!flight.has_barometer) altitude = none;
      if (!flight.has_accelerometer) felt = none;
      if (at > gap && at < gap + gap_length) continue;
      if (at > flight.killed && at < flight.back) continue;
      flight.rows.push_back({at, altitude, felt});
    }
  }
  const bool feels = has_both && !is_accelerometer_lost && range > body.peak && flight.killed > 1e8 &&
                     (gap > flight.burnout || gap + gap_length < path.liftoff);
  const auto is_disturbed = [&](double t) {
    for (const Dip& dip : dips)
      if (dip.at(t) != 0) return true;
    return t > dead || (t > frozen && t < frozen_until) || (t > gap && t < gap + gap_length) ||
           (t > flight.killed && t < flight.back) || !flight.has_barometer;
  };
  flight.has_both = has_both && !is_accelerometer_lost && !is_barometer_lost;
  double calm_since = path.apogee;
  bool hears = false;
  for (double t = path.apogee - 2.5; t < path.landing && t < path.apogee + 60; t += 0.05) {
    const bool is = is_disturbed(t);
    if (t < path.apogee + 2.5) flight.is_calm = flight.is_calm && !is;
    if (is || t < path.apogee || t < path.liftoff + 7) calm_since = t;
    hears = hears || t - calm_since > 4;
  }
  flight.works = feels || sensors == RandomSensors::accelerometer || hears;
  return flight;
}

}  // namespace rtdata::test
