// The rocket of rocket.json once more, in C++: it takes the topic "rocket" of its loop, from a sensor or a recording,
// and decides as the machine "flight". What the numbers mean: docs/tutorial-rocket.md.
#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <utility>

#include "rtdata/fsm/machine.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/sensors/vertical.hpp"

namespace rocket {

using namespace std::chrono_literals;
namespace fsm = rtdata::fsm;
using rtdata::VerticalMotion;

inline double seconds(rtdata::Duration duration) { return std::chrono::duration<double>(duration).count(); }

inline bool falls(const VerticalMotion& motion) { return motion.speed + motion.speed_deviation < 0; }
// Fast upwards, and sure of it, nothing can be at its apogee.
inline bool may_fall(const VerticalMotion& motion) { return motion.speed - 2 * motion.speed_deviation < 30; }

// Each sets an output, whose lease of 2 s ends it.
struct Charges {
  std::function<void()> drogue, backup;
};

class Apogee : public fsm::State {
 public:
  explicit Apogee(std::function<void()> drogue) : drogue_(std::move(drogue)) {}
  void arrive(const fsm::Moment&) override { drogue_(); }

 private:
  const std::function<void()> drogue_;
};

// It sets the drogue once more, which is on for 2.5 s then.
class Descent : public fsm::State {
 public:
  explicit Descent(Charges charges) : charges_(std::move(charges)) {}
  void arrive(const fsm::Moment&) override {
    charges_.drogue();
    charges_.backup();
  }

 private:
  const Charges charges_;
};

class Rocket {
 public:
  Rocket(rtdata::Loop& loop, Charges charges)
      : estimate_(
            loop, {.name = "motion"},
            {.barometer = "rocket", .height = "altitude", .accelerometer = "rocket", .acceleration = "acceleration"}),
        flight_(loop, {.name = "flight", .start = "pad"}),
        motion_(flight_, "motion", 1s) {
    flight_.add_state("pad");
    flight_.add_state("boost");
    flight_.add_state("coast");
    flight_.add_state("apogee", std::make_unique<Apogee>(charges.drogue));
    flight_.add_state("descent", std::make_unique<Descent>(std::move(charges)));
    flight_.add_state("landed", {.is_final = true});
    add_transitions();
    flight_.start();
  }
  fsm::Machine& machine() { return flight_; }

 private:
  void add_transitions() {
    const auto add = [this](fsm::Transition transition) { flight_.add_transition(std::move(transition)); };
    const auto flies = [this] { return motion_ && motion_->flying; };
    const auto stands = [this] { return motion_ && !motion_->flying; };
    const auto is_falling = [this] { return motion_ && falls(*motion_); };
    add({.from = "pad", .to = "boost", .when = flies, .cause = "liftoff"});
    add({.from = "boost",
         .to = "coast",
         .when = [this] { return motion_ && motion_->acceleration < -2; },
         .hold = 200ms,
         .cause = "burnout"});
    add({.from = "boost", .to = "apogee", .when = is_falling, .hold = 1s, .cause = "it falls"});
    add({.from = "boost", .to = "pad", .when = stands, .hold = 5s, .cause = "it has not flown"});
    add({.from = "coast", .to = "apogee", .when = is_falling, .hold = 100ms, .cause = "apogee"});
    add({.from = "coast",
         .to = "apogee",
         .when = [this] { return motion_ && may_fall(*motion_); },
         .hold = 1s,
         .after = 1min,
         .cause = "time is up"});
    add({.from = "coast", .to = "pad", .when = stands, .hold = 20s, .cause = "it has not flown"});
    add({.from = "apogee", .to = "descent", .after = 500ms, .cause = "the parachute is out"});
    add({.from = "descent", .to = "landed", .when = stands, .hold = 3s, .after = 10s, .cause = "landing"});
    add({.from = "descent",
         .to = "landed",
         .when = [this] { return motion_ && motion_->unchanged > 60; },
         .hold = 1s,
         .after = 30min,
         .cause = "time is up, without a barometer"});
    add({.from = "descent", .to = "landed", .after = 3h, .cause = "time is up"});
  }

  rtdata::VerticalSensor estimate_;
  fsm::Machine flight_;
  fsm::Input<VerticalMotion> motion_;
};

}  // namespace rocket
