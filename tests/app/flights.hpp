/// Flights of rockets as rows of altitude and acceleration, simulated and real, with the times at which things
/// happened.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <iomanip>
#include <numbers>
#include <optional>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "paths.hpp"

namespace rtdata::test {

struct FlightRow {
  double time = 0;                          // s
  std::optional<double> altitude = {};      // m, by the barometer
  std::optional<double> acceleration = {};  // g, along the rocket, as it is felt in it: 1 on the pad
};

struct Flight {
  std::string name;
  std::vector<FlightRow> rows = {};
  double liftoff = 0;  // s, as it truly was
  double burnout = 0;
  double fading = 0.5;  // s before it in which drag may already be stronger than the motor
  double apogee = 0;
  double landing = 0;
  double dip_from = 0;  // the pressure near Mach 1, after burnout; both 0: none
  double dip_until = 0;
  double height = 0;  // m

  std::string csv() const {
    std::ostringstream text;
    text << std::fixed << std::setprecision(3);
    text << "t,altitude [m],acceleration\n";
    for (const FlightRow& row : rows) {
      text << row.time << ',';
      if (row.altitude) text << *row.altitude;
      text << ',';
      if (row.acceleration) text << *row.acceleration;
      text << '\n';
    }
    return text.str();
  }
};

/// A rocket, its sensors, and how often they are read.
struct Rocket {
  std::string name;
  double thrust = 10;     // g
  double burn = 2;        // s; the thrust falls over the last fifth
  double drag = 2e-4;     // 1/m, at sea level, below Mach 1
  double fall = 20;       // m/s, after apogee
  double fall_below = 6;  // m/s, lower than 300 m
  double opens = 1;       // s after apogee: until then it falls freely
  double rate = 20;       // Hz
  double noise = 0.5;     // m
  double lag = 0;         // s, of the barometer
  double step = 0;        // m, which is the least difference that the barometer shows
  double dip = 400;       // m that the altitude seems to fall near Mach 1
  double shake = 0.05;    // g of noise
  double bias = 0;        // g
  double wobble = 0;      // g, at 1.3 Hz, while it coasts
  double base = 0;        // m, of the pad
  double pad = 15;        // s on the pad before liftoff
};

inline Flight simulated(const Rocket& rocket, std::uint32_t seed = 1) {
  constexpr double g = 9.81;
  constexpr double dt = 0.001;
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  Flight flight{rocket.name};
  flight.liftoff = rocket.pad;
  flight.burnout = rocket.pad + rocket.burn;
  flight.fading = 0.2 * rocket.burn;
  double height = 0;
  double speed = 0;
  double shown = 0;
  double next = 0;
  for (std::int64_t i = 0;; ++i) {
    const double t = static_cast<double>(i) * dt;
    const double density = std::exp(-height / 8500);
    const double sound = std::max(295.0, 340 - 0.0041 * height);
    const double mach = std::abs(speed) / sound;
    double felt = 1;
    if (t >= flight.liftoff && flight.landing == 0) {
      const double left = (flight.burnout - t) / (0.2 * rocket.burn);
      const double push = rocket.thrust * std::clamp(left, 0.0, 1.0);
      const double transonic = 1 + 0.8 * std::exp(-std::pow((mach - 1.05) / 0.15, 2));
      const double drag = rocket.drag * transonic * density * speed * std::abs(speed) / g;
      felt = push - drag;
      const bool is_open = flight.apogee > 0 && t >= flight.apogee + rocket.opens;
      if (is_open) {
        const double target = height < 300 ? -rocket.fall_below : -rocket.fall * std::sqrt(1 / density);
        felt = std::clamp(1 + (target - speed) / (g * 0.3), -20.0, 20.0);
      }
      speed += (felt - 1) * g * dt;
      height += speed * dt;
      if (flight.apogee == 0 && t > flight.burnout && speed <= 0) {
        flight.apogee = t;
        flight.height = height;
      }
      if (flight.apogee > 0 && height <= 0) {
        flight.landing = t;
        height = speed = 0;
      }
    }
    // The pressure at the port is wrong near Mach 1, by a bump that is as wide as the rocket takes to slow down.
    const double dip = speed > 0 ? rocket.dip * std::exp(-std::pow((mach - 1) / 0.05, 2)) : 0;
    if (dip > 5 && t > flight.burnout) {
      if (flight.dip_from == 0) flight.dip_from = t;
      flight.dip_until = t;
    }
    shown += rocket.lag > 0 ? (height - dip - shown) * std::min(1.0, dt / rocket.lag) : height - dip - shown;
    if (t >= next) {
      next += 1 / rocket.rate;
      double altitude = rocket.base + shown + rocket.noise * normal(random);
      if (rocket.step > 0) altitude = rocket.step * std::round(altitude / rocket.step);
      double acceleration = felt + rocket.bias + rocket.shake * normal(random);
      if (t > flight.burnout && flight.apogee == 0)
        acceleration += rocket.wobble * std::sin(2 * std::numbers::pi * 1.3 * t);
      flight.rows.push_back({t, altitude, acceleration});
    }
    if (flight.landing > 0 && t > flight.landing + 40) return flight;
  }
}

/// Rockets that differ in what matters: height, speed, rate, and what their sensors do wrong.
inline std::vector<Rocket> rockets() {
  return {
      {.name = "hobby",
       .thrust = 5.3,
       .burn = 0.8,
       .drag = 4e-4,
       .fall = 5,
       .fall_below = 5,
       .rate = 50,
       .noise = 0.3,
       .dip = 0},
      {.name = "low and slow",
       .thrust = 3.5,
       .burn = 2.5,
       .drag = 3e-4,
       .fall = 6,
       .rate = 10,
       .noise = 0.8,
       .dip = 0,
       .base = 812},
      {.name = "mid", .thrust = 9, .burn = 3, .drag = 3e-4, .rate = 20, .lag = 0.2},
      {.name = "mid, wobbling", .thrust = 9, .burn = 3, .drag = 3e-4, .rate = 37, .noise = 1, .shake = 0.1, .wobble = 1},
      {.name = "transonic", .thrust = 12, .burn = 3.5, .drag = 2e-4, .rate = 37, .noise = 0.8},
      {.name = "supersonic", .thrust = 15, .burn = 5, .drag = 2e-4, .rate = 37, .noise = 1, .lag = 0.1, .bias = 0.05},
      {.name = "supersonic, coarse",
       .thrust = 15,
       .burn = 4,
       .drag = 3e-4,
       .rate = 100,
       .noise = 0.2,
       .step = 1,
       .dip = 1500},
      {.name = "15 km",
       .thrust = 9,
       .burn = 10,
       .drag = 8e-5,
       .fall = 30,
       .rate = 50,
       .noise = 2,
       .lag = 0.1,
       .wobble = 0.3},
      {.name = "15 km, fast", .thrust = 22, .burn = 5, .drag = 1.2e-4, .fall = 30, .rate = 20, .noise = 2, .base = 1400},
  };
}

/// One of the many that are possible.
inline Rocket any_rocket(std::uint32_t seed) {
  std::mt19937 random(seed);
  const auto between = [&](double least, double most) {
    return std::uniform_real_distribution<double>(least, most)(random);
  };
  Rocket rocket{.name = "any " + std::to_string(seed)};
  rocket.burn = std::exp(between(std::log(0.7), std::log(9)));
  rocket.thrust = between(4, 16);
  rocket.drag = std::exp(between(std::log(8e-5), std::log(6e-4)));
  rocket.fall = between(5, 30);
  rocket.fall_below = between(4, std::min(rocket.fall, 9.0));
  rocket.rate = std::exp(between(std::log(10), std::log(120)));
  rocket.noise = between(0.1, 2);
  rocket.lag = between(0, 0.3);
  rocket.step = between(0, 1) < 0.3 ? between(0.1, 1) : 0;
  rocket.dip = between(0, 1500);
  rocket.shake = between(0.01, 0.15);
  rocket.bias = between(-0.06, 0.06);
  rocket.wobble = between(0, 1);
  rocket.base = between(-200, 2500);
  return rocket;
}

// What goes wrong with the sensors of a flight.

/// No altitude from this time on.
inline Flight barometer_dead(Flight flight, double from) {
  for (FlightRow& row : flight.rows)
    if (row.time >= from) row.altitude.reset();
  return flight;
}
/// The altitude stays as it is at this time.
inline Flight barometer_frozen(Flight flight, double from) {
  std::optional<double> last;
  for (FlightRow& row : flight.rows) {
    if (row.time < from || !last) last = row.altitude;
    row.altitude = last;
  }
  return flight;
}
inline Flight barometer_noisy(Flight flight, double metres, std::uint32_t seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  for (FlightRow& row : flight.rows) *row.altitude += metres * normal(random);
  return flight;
}
/// No rows for two seconds of each `period`.
inline Flight with_gaps(Flight flight, double period, double first) {
  std::erase_if(flight.rows,
                [&](const FlightRow& row) { return row.time >= first && std::fmod(row.time - first, period) < 2; });
  return flight;
}
/// An accelerometer of so many g.
inline Flight saturated(Flight flight, double most) {
  for (FlightRow& row : flight.rows) row.acceleration = std::clamp(*row.acceleration, -most, most);
  return flight;
}
/// It shows this from a time on.
inline Flight accelerometer_stuck(Flight flight, double from, double at) {
  for (FlightRow& row : flight.rows)
    if (row.time >= from) row.acceleration = at;
  return flight;
}

/// It shows a little more or less than at this time, so that it never quite stands still.
inline Flight barometer_flickering(Flight flight, double from, double metres) {
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  const Flight frozen = barometer_frozen(flight, from);
  for (std::size_t i = 0; i < flight.rows.size(); ++i)
    if (flight.rows[i].time >= from)
      flight.rows[i].altitude = *frozen.rows[i].altitude + std::round(metres * normal(random) * 10) / 10;
  return flight;
}
/// It reads `speed` less each second than it should, for so long, and recovers in 1 s.
inline Flight barometer_dipping(Flight flight, double from, double seconds, double speed) {
  for (FlightRow& row : flight.rows) {
    const double t = row.time - from;
    if (t >= 0) *row.altitude -= speed * seconds * std::clamp(std::min(t / seconds, 1 - (t - seconds)), 0.0, 1.0);
  }
  return flight;
}
/// Its values come at this rate, and are repeated in the rows between.
inline Flight barometer_slow(Flight flight, double rate) {
  double next = 0;
  std::optional<double> last;
  for (FlightRow& row : flight.rows) {
    if (row.time >= next) {
      last = row.altitude;
      next += 1 / rate;
    }
    row.altitude = last;
  }
  return flight;
}
inline Flight accelerometer_biased(Flight flight, double g) {
  for (FlightRow& row : flight.rows) *row.acceleration += g;
  return flight;
}
/// It feels this from one time to another.
inline Flight knocked(Flight flight, double from, double to, double g) {
  for (FlightRow& row : flight.rows)
    if (row.time >= from && row.time < to) row.acceleration = g;
  return flight;
}
/// A rocket that stays on the pad.
inline Flight on_pad(double seconds, double rate, double noise) {
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  Flight flight{"on the pad"};
  for (double t = 0; t < seconds; t += 1 / rate)
    flight.rows.push_back({t, 100 + noise * normal(random), 1 + 0.02 * normal(random)});
  return flight;
}

/// The flight of ../shared/data/flight, with so many seconds on the pad before its first row, which is 0.1 s before 3
/// g, and a minute on the ground after its last. None: the folder is not there.
inline std::optional<Flight> real_flight(double pad = 10) {
  const std::string folder = in_source("../shared/data/flight/");
  const auto column_of = [&](const char* name, int column) {
    std::vector<std::pair<double, double>> values;
    std::ifstream file(folder + name);
    std::string line;
    std::getline(file, line);
    while (std::getline(file, line)) {
      std::istringstream cells(line);
      std::string cell;
      double time = 0;
      for (int i = 0; i <= column && std::getline(cells, cell, ','); ++i)
        if (i == 0) time = std::stod(cell) * 1e-5;
      values.emplace_back(time, std::stod(cell));
    }
    return values;
  };
  const auto altitude = column_of("tars_barometer.csv", 3);
  const auto acceleration = column_of("tars_highg_imu.csv", 4);
  if (altitude.empty() || acceleration.empty()) return std::nullopt;
  constexpr double period = 0.027;
  Flight flight{"real"};
  const double first = altitude.front().first;
  double highest = altitude.front().second;
  for (double t = 0; t < pad; t += period)
    flight.rows.push_back({t, altitude.front().second, acceleration.front().second});
  std::size_t at = 0;
  for (const auto& [time, metres] : altitude) {
    while (at + 1 < acceleration.size() && acceleration[at + 1].first <= time) ++at;
    flight.rows.push_back({pad + time - first, metres, acceleration[at].second});
    if (metres > highest) {
      highest = metres;
      flight.apogee = flight.rows.back().time;
    }
  }
  const FlightRow last = flight.rows.back();
  for (double t = period; t < 60; t += period) flight.rows.push_back({last.time + t, last.altitude, last.acceleration});
  flight.liftoff = pad + 0.1;
  flight.burnout = pad + 3.6;  // where its acceleration falls through 0
  flight.landing = last.time;
  flight.dip_from = pad + 4.5;
  flight.dip_until = pad + 9.5;
  flight.height = highest - altitude.front().second;
  return flight;
}

}  // namespace rtdata::test
