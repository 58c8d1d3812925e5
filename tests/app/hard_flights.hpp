/// Flights that are hard to decide, one for each seed and kind of trouble: rockets from 100 m to 15 km in a plane, with
/// what their sensors show of it. Each row has the true vertical speed beside it, so that a decision can be judged.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "app/flights.hpp"

namespace rtdata::test {

/// What is hard about a flight.
enum class Trouble {
  none,
  two_stages,  // the thrust pauses
  tilted,      // 10 to 35 degrees from upright
  noisy,       // 5 to 20 m of noise
  lagging,     // the static port follows in 0.2 to 0.6 s
  transonic,   // 100 to 500 m down, each time it passes Mach 1
  ejection,    // pressure of the charge in the bay, 0.1 to 0.5 s
  spikes,      // single values 100 m off, each 1 to 2 s
  dead,        // no altitude, from a moment on
  frozen,      // the same altitude, from a moment on
  gaps,        // no rows for 2 s, once or each 6 to 12 s
  saturated,   // the accelerometer ends at 2 to 8 g
  biased,      // by up to 0.3 g
  dragging,    // up to 5 g of drag after burnout
  handled,     // dropped 10 cm, carried up a hill, taken up in a lift, gusts; and then it flies
  waiting,     // 20 minutes of weather before it flies
  hung,        // the motor chuffs, and burns seconds later
  rebooted,    // the first row is in the boost
  ballistic,   // nothing opens
  mixed,       // some of these together, none of which takes a sensor away
  stays,       // two hours of weather and hands on the pad, and no flight
  count
};

inline const char* name_of(Trouble trouble) {
  constexpr std::array names = {"none",    "two stages", "tilted", "noisy",    "lagging",   "transonic", "ejection",
                                "spikes",  "dead",       "frozen", "gaps",     "saturated", "biased",    "dragging",
                                "handled", "waiting",    "hung",   "rebooted", "ballistic", "mixed",     "stays"};
  static_assert(names.size() == static_cast<std::size_t>(Trouble::count));
  return names[static_cast<std::size_t>(trouble)];
}

struct HardFlight : Flight {
  Trouble trouble = Trouble::none;
  std::vector<double> speeds = {};  // m/s upwards, of each row, in truth
  bool has_barometer = true;        // up to the apogee
  double first_row = 0;             // s
  double gap_at_apogee = 0;         // s after it, when rows come again
  double noise = 0;                 // m
  bool is_ejected = false;
};

namespace hard {

constexpr double g = 9.81;

struct Chance {
  std::mt19937 random;
  double between(double least, double most) { return std::uniform_real_distribution<double>(least, most)(random); }
  double grows(double least, double most) { return std::exp(between(std::log(least), std::log(most))); }
  bool is(double probability) { return between(0, 1) < probability; }
  double normal() { return std::normal_distribution<double>()(random); }
};

struct Body {
  double pad = 15;        // s
  double peak = 8;        // g
  double burn = 2;        // s
  double pause = 0;       // s without thrust, in the middle
  double drag = 2e-4;     // 1/m
  double tilt = 0;        // rad from upright, of the rail
  double fall = 20;       // m/s
  double fall_below = 6;  // m/s, below 300 m
  double opens = 1;       // s after the apogee
  bool never_opens = false;
};

struct Moment {
  double time = 0, height = 0, speed = 0, mach = 0, felt = 1;
};

struct Path {
  std::vector<Moment> moments;  // each ms
  double liftoff = 0, burnout = 0, apogee = 0, landing = 0, height = 0;
};

/// The rocket turns into the wind that it makes, so that its axis is the direction in which it flies.
inline Path path_of(const Body& body, double after) {
  constexpr double dt = 0.001;
  Path path;
  double across = 0, x = 0;  // m/s, m
  double height = 0, speed = 0;
  double axis_x = std::sin(body.tilt), axis_z = std::cos(body.tilt);
  const double end = body.pad + body.burn + body.pause;
  for (std::int64_t i = 0;; ++i) {
    const double t = static_cast<double>(i) * dt;
    const double density = std::exp(-height / 8500);
    const double sound = std::max(295.0, 340 - 0.0041 * height);
    const double total = std::hypot(across, speed);
    const double mach = total / sound;
    double felt = axis_z;
    if (t >= body.pad && path.landing == 0) {
      double burnt = t - body.pad;
      bool burns = burnt < body.burn + body.pause;
      if (body.pause > 0 && burnt > body.burn / 2) {
        burns = burns && burnt > body.burn / 2 + body.pause;
        burnt -= burns ? body.pause : 0;
      }
      const double rise = std::clamp(burnt / (0.1 * body.burn), 0.0, 1.0);
      const double tail = std::clamp((body.burn - burnt) / (0.2 * body.burn), 0.0, 1.0);
      const double push = burns ? body.peak * std::min(rise, tail) : 0;
      const double transonic = 1 + 0.8 * std::exp(-std::pow((mach - 1.05) / 0.15, 2));
      const double drag = body.drag * transonic * density * total * total / g;
      if (path.liftoff == 0 && push > axis_z) path.liftoff = t;
      if (path.liftoff > 0 || height > 0) {
        const bool is_open = path.apogee > 0 && !body.never_opens && t >= path.apogee + body.opens;
        if (is_open) {
          const double target = height < 300 ? -body.fall_below : -body.fall * std::sqrt(1 / density);
          felt = std::clamp(1 + (target - speed) / (g * 0.3), -20.0, 20.0);
          speed += (felt - 1) * g * dt;
          across -= across * dt;
        } else {
          felt = push - drag;
          const bool is_guided = std::hypot(x, height) < 2;
          if (!is_guided && total > 1) axis_x = across / total, axis_z = speed / total;
          const double along = felt * g - (is_guided ? g * axis_z : 0);
          across += along * axis_x * dt;
          speed += (along * axis_z - (is_guided ? 0 : g)) * dt;
        }
        x += across * dt;
        height += speed * dt;
        if (path.apogee == 0 && t > path.liftoff + 0.1 && speed <= 0) path.apogee = t, path.height = height;
        if (path.apogee > 0 && height <= 0) path.landing = t, height = speed = across = 0, axis_z = 1;
      }
    }
    path.moments.push_back({t, height, speed, mach, felt});
    if (path.landing > 0 && t > path.landing + after) break;
    if (t > body.pad + 20 && path.liftoff == 0) break;
  }
  path.burnout = end;
  return path;
}

}  // namespace hard

/// The same for the same seed.
inline HardFlight hard_flight(Trouble trouble, std::uint32_t seed) {
  using namespace hard;
  Chance chance{std::mt19937(seed * 64 + static_cast<std::uint32_t>(trouble))};
  const auto is = [&](Trouble one) { return trouble == one; };
  const auto has = [&](Trouble one, double probability) {
    return is(one) || (is(Trouble::mixed) && chance.is(probability));
  };
  HardFlight flight;
  flight.trouble = trouble;
  flight.name = std::string(name_of(trouble)) + " " + std::to_string(seed);

  Body body;
  body.pad = is(Trouble::handled) ? 120 : is(Trouble::waiting) ? 1200 : is(Trouble::hung) ? 30 : chance.between(8, 30);
  if (has(Trouble::ballistic, 0.2)) body.never_opens = true;
  body.tilt = has(Trouble::tilted, 0.4) ? chance.between(10, 35) * std::numbers::pi / 180
                                        : chance.between(0, 6) * std::numbers::pi / 180;
  const bool is_fast = has(Trouble::transonic, 0.3);
  const bool drags = has(Trouble::dragging, 0.2);
  const bool has_pause = has(Trouble::two_stages, 0.2);
  Path path;
  if (is(Trouble::stays)) {
    body.pad = 1e9;
  } else {
    for (int tries = 0;; ++tries) {
      body.peak = chance.between(3, 20);
      body.burn = chance.grows(0.3, 8);
      body.drag = chance.grows(5e-5, 1e-3);
      body.pause = has_pause ? chance.between(0.2, 3) : 0;
      body.fall = chance.between(6, 40);
      body.fall_below = chance.between(4, 9);
      body.opens = chance.between(0.3, 2);
      // What it does about the height, roughly: most of the tries are left out for that alone.
      const double gained = (body.peak * 0.85 - 1) * g * body.burn;
      if (gained < 40 || (is_fast && gained < 380) || gained > 1400) continue;
      path = path_of(body, 40);
      double fastest = 0, slowest = 0;
      for (const Moment& moment : path.moments) {
        if (path.apogee > 0 && moment.time > path.apogee) break;
        fastest = std::max(fastest, moment.mach);
        slowest = std::min(slowest, moment.felt);
      }
      if (path.height < 100 || path.height > 15000 || path.liftoff == 0) continue;
      if (path.apogee < path.burnout + 1) continue;  // two stages: the second burns upwards
      if (is_fast != (fastest > 1.15) || (drags && slowest > -1.5) || slowest < -5) continue;
      break;
    }
  }

  const double rate = chance.is(0.5) ? chance.between(10, 30) : chance.grows(10, 100);
  flight.noise = has(Trouble::noisy, 0.2) ? chance.between(5, 20) : chance.grows(0.1, 2);
  const double lag = has(Trouble::lagging, 0.3) ? chance.between(0.2, 0.6) : chance.between(0, 0.1);
  const double base = chance.is(0.3) ? 2000 : chance.between(-200, 2500);
  // A coarse barometer that lies still on a hill cannot be told from one that is stuck in the air.
  const double step = chance.is(0.2) && !is(Trouble::handled) ? chance.between(0.1, 1) : 0;
  const double shake = chance.grows(0.01, 0.15);
  const bool is_blind = is(Trouble::dead) || is(Trouble::frozen);
  const double bias = has(Trouble::biased, 0.3) || (is_blind && chance.is(0.3)) ? chance.between(-0.3, 0.3)
                                                                                : chance.between(-0.05, 0.05);
  const double most = has(Trouble::saturated, 0.2) ? chance.between(2, 8) : 50;
  const double dip = is_fast ? chance.between(100, 500) : 0;
  const double dip_length = chance.between(0.5, 2);
  const double weather_period = chance.between(2000, 6000);
  const double weather = chance.between(2, 10);  // m
  const double gust = is(Trouble::stays) || is(Trouble::handled) || is(Trouble::waiting) ? chance.between(1, 4) : 0;
  const double lift_up = chance.between(1, 3);
  const double hill_up = chance.between(0.5, 1.5);

  flight.liftoff = path.liftoff;
  flight.burnout = path.burnout;
  flight.apogee = path.apogee;
  flight.landing = path.landing;
  flight.height = path.height;

  // The dips begin where the rocket passes Mach 1.
  std::vector<double> dips;
  bool was_above = false;
  for (const Moment& moment : path.moments) {
    const bool is_above = moment.mach > 1;
    if (is_above != was_above && (flight.apogee == 0 || moment.time < flight.apogee)) dips.push_back(moment.time);
    was_above = is_above;
  }
  const bool is_ejected = has(Trouble::ejection, 0.3);
  flight.is_ejected = is_ejected;
  const double ejection_from = flight.apogee + chance.between(0, 1), ejection_for = chance.between(0.1, 0.5);
  const double ejection = chance.between(30, 200) * (chance.is(0.8) ? -1 : 1);
  const bool has_spikes = has(Trouble::spikes, 0.3);

  const double coast = flight.apogee - flight.burnout;
  const double dies = is(Trouble::dead) || is(Trouble::frozen)
                          ? (chance.is(0.15)  ? chance.between(0, flight.liftoff)
                             : chance.is(0.2) ? chance.between(flight.apogee, flight.landing)
                                              : chance.between(flight.liftoff, flight.apogee))
                          : 1e9;
  flight.has_barometer = dies > flight.apogee + 2;
  const bool has_gaps = is(Trouble::gaps);
  const double gap_from = chance.between(2, flight.apogee + 2);
  const double gap_each = chance.is(0.5) ? 1e9 : chance.between(6, 12);
  const bool is_rebooted = is(Trouble::rebooted);
  flight.first_row = is_rebooted ? flight.liftoff + chance.between(0.1, 0.7) * (flight.burnout - flight.liftoff) : 0;
  const double chuff = is(Trouble::hung) ? chance.between(5, 25) : -1;

  double wind = 0, shown = 0, next = flight.first_row, spike_at = chance.between(1, 2);
  std::optional<double> frozen;
  bool is_first = true;
  const double end = is(Trouble::stays) ? 7200 : path.moments.back().time;
  const double dt = is(Trouble::stays) ? 1 / std::min(rate, 20.0) : 0.001;
  const std::int64_t steps = static_cast<std::int64_t>(end / dt);
  const bool is_handled = is(Trouble::handled) || is(Trouble::stays);
  for (std::int64_t i = 0; i < steps; ++i) {
    const double t = static_cast<double>(i) * dt;
    const Moment now = is(Trouble::stays) ? Moment{t} : path.moments[static_cast<std::size_t>(i)];
    double height = now.height;
    double felt = now.felt;
    const bool is_on_pad = flight.liftoff == 0 || t < flight.liftoff;
    // Carried up a hill for 40 s, then up in a lift for 12 s, and down again, each ten minutes or once.
    if (is_handled) {
      const double u = is(Trouble::stays) ? std::fmod(t, 600) : t;
      height += hill_up * std::clamp(u - 8, 0.0, 40.0) *
                (is(Trouble::stays) ? 1 - std::clamp((u - 200) / 60, 0.0, 1.0) : 1);
      height += lift_up * std::clamp(u - 55, 0.0, 12.0) *
                (is(Trouble::stays) ? 1 - std::clamp((u - 300) / 12, 0.0, 1.0) : 1);
      if (u > 8 && u < 48) felt += 0.25 * std::sin(2 * std::numbers::pi * 1.8 * t);
      if (u > 55 && u < 56) felt += lift_up / g;
      if (u > 66 && u < 67) felt -= lift_up / g;
      if (u > 80 && u < 80.14) felt = 0;      // dropped 10 cm
      if (u > 80.14 && u < 80.165) felt = 5;  // onto the table
      if (u > 90 && u < 90.03) felt = 3;      // a knock
    }
    if (chuff > 0 && t > chuff && t < chuff + 0.12) felt = 2.5;
    if (gust > 0) wind += -wind * dt / 1.5 + gust * std::sqrt(2 * dt / 1.5) * chance.normal();
    double error = weather * std::sin(2 * std::numbers::pi * t / weather_period) + (is_on_pad ? wind : 0);
    for (const double at : dips)
      if (t > at && t < at + dip_length) error -= dip * std::sin(std::numbers::pi * (t - at) / dip_length);
    if (is_ejected && t > ejection_from && t < ejection_from + ejection_for) error += ejection;
    shown = is_first || lag < 0.002 ? height + error : shown + (height + error - shown) * std::min(1.0, dt / lag);
    is_first = false;
    if (t < next) continue;
    next += 1 / rate;
    double altitude = base + shown + flight.noise * chance.normal();
    if (has_spikes && t > spike_at) {
      altitude += chance.is(0.5) ? 100 : -100;
      spike_at = t + chance.between(1, 2);
    }
    if (step > 0) altitude = step * std::round(altitude / step);
    FlightRow row{t, altitude, std::clamp(felt + bias + shake * chance.normal(), -most, most)};
    if (t >= dies) {
      if (is(Trouble::frozen)) {
        if (!frozen) frozen = row.altitude;
        row.altitude = frozen;
      } else {
        row.altitude.reset();
      }
    }
    if (has_gaps && t > gap_from && std::fmod(t - gap_from, gap_each) < 2) {
      if (t > flight.apogee - 1.5 && t < flight.apogee + 2.5) flight.gap_at_apogee = t - flight.apogee + 1.5;
      continue;
    }
    flight.rows.push_back(row);
    flight.speeds.push_back(now.speed);
  }
  (void)coast;
  return flight;
}

/// What is wrong with what was decided of it; empty: nothing.
struct Decision {
  double time = 0;  // s
  std::string from, to, cause;
};

inline std::string judged(const HardFlight& flight, const std::vector<Decision>& decisions) {
  const auto first_to = [&](const std::string& state) {
    for (const Decision& one : decisions)
      if (one.to == state) return one.time;
    return -1.0;
  };
  const auto said = [](const char* what, double by) { return std::string(what) + " " + std::to_string(by); };
  const double charge = first_to("apogee");
  if (flight.trouble == Trouble::stays) {
    if (charge >= 0) return "fires on the pad";
    return decisions.empty() || decisions.back().to == "pad" ? "" : "is not on the pad";
  }
  double liftoff = -1;  // the last boost before the coast
  for (const Decision& one : decisions) {
    if (one.to == "coast" || one.to == "apogee") break;
    if (one.to == "boost") liftoff = one.time;
  }
  if (charge < 0) return "never fires";
  double speed = 0;
  for (std::size_t i = 0; i < flight.rows.size() && flight.rows[i].time <= charge + 1e-6; ++i) speed = flight.speeds[i];
  const double off = charge - flight.apogee;
  if (charge < flight.liftoff) return said("fires on the pad", off);
  if (off < -1 && speed > 15) return said("early", off);
  if (flight.has_barometer) {
    const double late = std::max(flight.is_ejected ? 5.0 : 1.0, flight.gap_at_apogee);
    if (off < -1) return said("early and slow", off);
    if (off > late) return said("late", off);
  } else if (off > 3 + 0.35 * (flight.apogee - flight.liftoff)) {
    return said("late without a barometer", off);
  }
  const double true_liftoff = std::max(flight.liftoff, flight.first_row);
  double in_gap = 0.5;
  if (flight.trouble == Trouble::gaps) in_gap = 4.5;  // 2 s without rows, and then by the barometer
  if (liftoff < true_liftoff - 0.05 || liftoff > true_liftoff + in_gap) return said("liftoff", liftoff - true_liftoff);
  const double landed = first_to("landed");
  if (landed >= 0 && landed < flight.landing - 1) return said("landed in the air", landed - flight.landing);
  if (landed < 0 && flight.has_barometer && flight.trouble != Trouble::frozen && flight.trouble != Trouble::dead &&
      flight.trouble != Trouble::gaps)
    return "never landed";
  return "";
}

}  // namespace rtdata::test
