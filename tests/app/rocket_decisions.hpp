/// What the machine of examples/rocket decides, without a loop: thousands of flights a second. That it is the same is
/// tested with machines from JSON and in C++ (rocket_campaign_test.cpp).
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include "../examples/rocket/rocket.hpp"
#include "app/random_flights.hpp"

namespace rtdata::test {

class RocketDecisions {
 public:
  void take(double time, const VerticalMotion& motion) {
    const double in_state = time - since_;
    if (state_ == "pad") {
      if (motion.flying) go("boost", time);
    } else if (state_ == "boost") {
      if (holds("burnout", motion.acceleration < -2, 0.2, time)) return go("coast", time);
      if (holds("falls", rocket::falls(motion), 1, time)) return go("apogee", time);
      if (holds("stands", !motion.flying, 5, time)) return go("pad", time);
    } else if (state_ == "coast") {
      if (holds("falls", rocket::falls(motion), 0.1, time)) return go("apogee", time);
      if (holds("time", rocket::may_fall(motion), 1, time) && in_state >= 60) return go("apogee", time);
      if (holds("stands", !motion.flying, 20, time)) return go("pad", time);
    }
  }
  /// It was killed, and goes on in its state.
  void resume() { held_.clear(); }
  bool is_fired() const { return state_ == "apogee"; }
  double fired_at() const { return since_; }

 private:
  bool holds(const char* what, bool is, double seconds, double time) {
    if (!is) held_.erase(what);
    return is && time - held_.try_emplace(what, time).first->second > seconds - 1e-6;
  }
  void go(const char* state, double time) {
    state_ = state;
    since_ = time;
    held_.clear();
  }

  std::string state_ = "pad";
  double since_ = 0;
  std::map<std::string, double> held_;
};

/// Seconds after the apogee at which the drogue is fired; none: never.
inline std::optional<double> fired(const RandomFlight& flight) {
  VerticalKalman estimate;
  RocketDecisions decisions;
  bool is_killed = false;
  for (const RandomRow& row : flight.rows) {
    if (!is_killed && row.time > flight.killed) {
      is_killed = true;
      estimate.reset();
      decisions.resume();
    }
    estimate.take(from_nanoseconds(static_cast<std::int64_t>((1e4 + row.time) * 1e9)),
                  {row.altitude, row.acceleration});
    decisions.take(row.time, motion_of(estimate.now()));
    if (decisions.is_fired()) return decisions.fired_at() - flight.apogee;
  }
  return std::nullopt;
}

}  // namespace rtdata::test
