// The rocket of rocket.json once more, in C++: it takes the topic "rocket" of its loop, from a sensor or a recording,
// and decides as the machine "flight". What the numbers mean: docs/tutorial-rocket.md.
#pragma once

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <string_view>
#include <type_traits>
#include <utility>
#include <variant>

#include "rtdata/data/event.hpp"
#include "rtdata/fsm/machine.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/topic.hpp"
#include "rtdata/sensors/feed.hpp"

namespace rocket {

using namespace std::chrono_literals;
namespace fsm = rtdata::fsm;

constexpr double g = 9.81;

struct Readings {
  double altitude = 0;      // m, by the barometer; NaN: it has said nothing
  double acceleration = 0;  // g, along the rocket
  RTDATA_FIELDS(Readings, (altitude, "m"), (acceleration, "[g]"))
};

inline double seconds(rtdata::Duration duration) { return std::chrono::duration<double>(duration).count(); }

// Rows of the last so many seconds. Of a sensor that is faster than they have room for, some are left out: of a second
// 1023 are kept, of 8 seconds 127 each.
class Window {
 public:
  struct Row {
    rtdata::Time time{};
    double value = 0;
  };
  explicit Window(rtdata::Duration length) : length_(length) {}
  void take(rtdata::Time time, double value) {
    if (count_ > 0 && time - back(0).time > 500ms) count_ = 0;  // a gap, of which nothing is known
    if (count_ > 0 && time - back(0).time < length_ / (size - 1)) return;
    at_ = (at_ + 1) % size;
    rows_[at_] = {time, value};
    if (count_ < size) ++count_;
    while (time - back(count_ - 1).time > length_) --count_;
  }
  std::size_t count() const { return count_; }
  const Row& back(std::size_t n) const { return rows_[(at_ + size - n) % size]; }
  rtdata::Duration length() const { return length_; }

 private:
  static constexpr std::size_t size = 1024;
  const rtdata::Duration length_;
  std::array<Row, size> rows_{};
  std::size_t at_ = 0, count_ = 0;
};

// The speed of something that is thrown upwards: the slope of a straight line through its latest altitudes is its speed
// in their middle; it is slower now, by what gravity has taken away since.
class Climb {
 public:
  explicit Climb(rtdata::Duration length) : rows_(length) {}
  void take(rtdata::Time time, double altitude) {
    rows_.take(time, altitude);
    double t = 0, h = 0, tt = 0, th = 0;
    for (std::size_t i = 0; i < rows_.count(); ++i) {
      const double x = seconds(rows_.back(i).time - time), y = rows_.back(i).value - altitude;
      t += x, h += y, tt += x * x, th += x * y;
    }
    const double n = double(rows_.count());
    mean_ = rows_.count() > 2 ? (n * th - t * h) / (n * tt - t * t) : 0;
    now_ = mean_ + g * t / n;
  }
  rtdata::Duration length() const { return rows_.length(); }
  bool is_whole() const {
    return rows_.count() > 2 &&
           seconds(rows_.back(0).time - rows_.back(rows_.count() - 1).time) > 0.8 * seconds(length());
  }
  double mean() const { return mean_; }
  double now() const { return now_; }

 private:
  Window rows_;
  double mean_ = 0, now_ = 0;
};

// What the accelerometer says.
class Felt {
 public:
  void take(rtdata::Time time, double acceleration) {
    const double passed = has_felt_ ? seconds(time - at_) : 0;
    has_felt_ = true;
    at_ = time;
    // What it shows too much while it lies still and nearly upright.
    if (!was_thrown_ && std::abs(acceleration - 1) < 0.4) {
      rested_ = std::min(rested_ + passed, 20.0);
      if (rested_ > 0) bias_ += (acceleration - 1 - bias_) * std::min(1.0, passed / rested_);
    }
    speed_ += (acceleration - 1 - (was_thrown_ ? bias_ : 0)) * g * passed;
    rows_.take(time, speed_);
    if (!was_thrown_ && gained() > 12) was_thrown_ = true, before_ = speed_ - gained();
    if (was_thrown_) top_ = std::max(top_, speed());
  }
  bool was_thrown() const { return was_thrown_; }
  bool is_silent(rtdata::Time now) const { return !has_felt_ || now - at_ > 1s; }
  double speed() const { return speed_ - before_; }  // m/s, since it was thrown
  double top() const { return top_; }                // the highest of them
  double gained() const {                            // m/s, in the last 2 s; 0 where there is a gap in them
    if (rows_.count() < 2) return 0;
    const auto& oldest = rows_.back(rows_.count() - 1);
    return rows_.back(0).time - oldest.time > 1600ms ? rows_.back(0).value - oldest.value : 0;
  }

 private:
  Window rows_{2s};
  rtdata::Time at_{};
  bool has_felt_ = false, was_thrown_ = false;
  double speed_ = 0, before_ = 0, top_ = 0, bias_ = 0, rested_ = 0;
};

// What the states look at.
class Sensors {
 public:
  explicit Sensors(rtdata::Time start)
      : now_(start),
        changed_(start),
        moved_(start),
        up_(start),
        above_5_(start),
        above_10_(start),
        above_50_(start),
        whole_(start),
        spoke_(start) {}

  void take(rtdata::Time time, const Readings& readings) {
    now_ = time;
    if (std::isfinite(readings.acceleration)) felt_.take(time, readings.acceleration);
    if (std::isfinite(readings.altitude)) take_altitude(readings.altitude);
    best_felt_ = std::max(best_felt_, felt_.gained());
    best_ = std::max({best_, best_felt_, climb().is_whole() ? least() : 0});
  }
  // From now on.
  void begin_boost() { best_ = best_felt_ = 0; }
  void begin_descent() { fastest_ = 0; }

  const Felt& felt() const { return felt_; }
  bool is_silent() const { return felt_.is_silent(now_); }  // the accelerometer is
  const Climb& climb() const { return is_quiet() ? quick_ : slow_; }
  bool is_quiet() const { return noise_ < 3; }
  // There is no gap in the window, and the height changes.
  bool is_ready() const { return climb().is_whole() && unchanged() < 500ms; }
  double least() const { return climb().mean() - noise_; }  // m/s, what noise may add left out
  double best() const { return best_; }                     // m/s, that it surely had, by one sensor or the other
  double best_felt() const { return best_felt_; }           // by the accelerometer alone
  double sink() const { return -long_.mean(); }
  bool is_sink_known() const { return long_.is_whole() && now_ - spoke_ < 1s; }
  double fastest() const { return fastest_; }  // m/s, up or down in the descent, by the barometer
  rtdata::Duration unchanged() const { return now_ - changed_; }
  rtdata::Duration still() const { return now_ - moved_; }  // slower than 8 m/s, or silent
  rtdata::Duration down() const { return now_ - up_; }      // it does not climb, or is silent
  // From 50 m/s to 5 in more than a second, as what flies freely: what is stuck, or wrong near Mach 1, stops at once.
  bool is_smooth() const { return !was_fast_ || above_5_ - above_50_ > 1s; }
  // From 10 m/s to nothing takes 1 s in free fall.
  bool is_free() const { return is_quiet() && was_above_10_ && now_ - above_10_ > 700ms; }
  // Less than a third of what it was: by what was felt, it may be at its apogee. So it may when nothing is felt.
  bool is_slow() const { return !felt_.was_thrown() || is_silent() || felt_.speed() < felt_.top() / 3; }
  bool falls() const { return is_ready() && climb().mean() < -10; }
  // Over the lowest that it was for 20 s, which is the pad.
  bool is_near_ground() const { return has_ground_ && altitude_ < ground_ + 30; }

 private:
  void take_altitude(double raw) {
    const bool is_gap = now_ - spoke_ > 500ms;
    if (is_gap) whole_ = now_;
    const double passed = seconds(now_ - spoke_);
    spoke_ = now_;
    // The middle one of three: a single wrong value is none.
    const double altitude = rows_ < 2 ? raw
                                      : std::max(std::min(last_, raw), std::min(std::max(last_, raw), last_but_one_));
    last_but_one_ = std::exchange(last_, raw);
    ++rows_;
    since_change_ += passed;
    if (altitude != altitude_) {  // rows that only repeat a value do not count
      const double step = altitude - altitude_;
      if (now_ - whole_ > 400ms)
        noise_ += (std::min(std::abs(step - step_), 15.0) - noise_) * std::min(1.0, since_change_ / 1.5);
      step_ = step;
      altitude_ = altitude;
      changed_ = now_;
      since_change_ = 0;
    }
    quick_.take(now_, altitude);
    slow_.take(now_, altitude);
    long_.take(now_, altitude);
    smoothed_ += (altitude - smoothed_) * (rows_ == 1 ? 1.0 : std::min(1.0, passed / 10));
    if (now_ - whole_ > 20s) {
      ground_ = has_ground_ ? std::min(ground_, smoothed_) : smoothed_;
      has_ground_ = true;
    }
    const bool is_whole = climb().is_whole();
    fastest_ = std::max(fastest_, std::abs(climb().mean()));
    if (!is_whole || std::abs(climb().mean()) > 8) moved_ = now_;
    if (!is_whole || (is_ready() && climb().now() > 5)) up_ = now_;
    if (!is_ready()) return;
    if (climb().now() > 50) was_fast_ = true, above_50_ = now_;
    if (climb().now() > 10) was_above_10_ = true, above_10_ = now_;
    if (climb().now() > 5) above_5_ = now_;
  }

  Climb quick_{1s}, slow_{4s}, long_{8s};
  Felt felt_;
  double noise_ = 0, best_ = 0, best_felt_ = 0, fastest_ = 0;
  rtdata::Time now_, changed_, moved_, up_, above_5_, above_10_, above_50_, whole_, spoke_;
  bool was_fast_ = false, was_above_10_ = false, has_ground_ = false;
  double last_ = 0, last_but_one_ = 0, altitude_ = 0, step_ = 0, since_change_ = 0, smoothed_ = 0, ground_ = 0;
  std::size_t rows_ = 0;
};

// It has not flown before it was as fast as nobody carries it.
class Boost : public fsm::State {
 public:
  explicit Boost(Sensors& sensors) : sensors_(sensors) {}
  void arrive(const fsm::Moment&) override { sensors_.begin_boost(); }

 private:
  Sensors& sensors_;
};

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
  Descent(Sensors& sensors, Charges charges) : sensors_(sensors), charges_(std::move(charges)) {}
  void arrive(const fsm::Moment&) override {
    sensors_.begin_descent();
    charges_.drogue();
    charges_.backup();
  }

 private:
  Sensors& sensors_;
  const Charges charges_;
};

// The machine stays in the boost while `check` says no.
class Coast : public fsm::State {
 public:
  explicit Coast(const Sensors& sensors) : sensors_(sensors) {}
  bool check(const fsm::Moment&) override { return sensors_.best() > 12; }

 private:
  const Sensors& sensors_;
};

class Rocket {
 public:
  Rocket(rtdata::Loop& loop, Charges charges)
      : sensors_(loop.time()),
        feed_(loop, {.name = "readings"}),
        flight_(loop, {.name = "flight", .start = "pad"}),
        rocket_(flight_, "readings", 1s) {
    // Numbers of any type, also where some are absent, as in an imported table with empty cells.
    source_ = loop.subscribe("rocket", [this](const rtdata::EventView& event) {
      const Readings readings{number_of(event, "altitude"), number_of(event, "acceleration")};
      sensors_.take(event.time(), readings);
      feed_.publish(readings, event.time());
    });
    add_states(std::move(charges));
    add_transitions();
    flight_.start();
  }
  fsm::Machine& machine() { return flight_; }

 private:
  static double number_of(const rtdata::EventView& event, std::string_view field) {
    const rtdata::Leaf* const leaf = event.description().find(field);
    if (leaf == nullptr) return std::numeric_limits<double>::quiet_NaN();
    return std::visit(
        [](const auto& value) {
          if constexpr (std::is_arithmetic_v<std::remove_cvref_t<decltype(value)>>)
            return double(value);
          else
            return std::numeric_limits<double>::quiet_NaN();
        },
        event.value(*leaf));
  }

  void add_states(Charges charges) {
    flight_.add_state("pad");
    flight_.add_state("boost", std::make_unique<Boost>(sensors_));
    flight_.add_state("coast", std::make_unique<Coast>(sensors_));
    flight_.add_state("apogee", std::make_unique<Apogee>(charges.drogue));
    flight_.add_state("descent", std::make_unique<Descent>(sensors_, std::move(charges)));
    flight_.add_state("landed", {.is_final = true});
  }

  void add_transitions() {
    const Sensors& s = sensors_;
    const auto add = [this](fsm::Transition transition) { flight_.add_transition(std::move(transition)); };
    add({.from = "pad",
         .to = "boost",
         .when = [this] { return rocket_->acceleration > 1.8; },
         .hold = 100ms,
         .cause = "liftoff"});
    add({.from = "pad",
         .to = "boost",
         .when = [&s] { return s.is_ready() && s.least() > 12; },
         .hold = 700ms,
         .cause = "liftoff, by the barometer"});
    add({.from = "boost",
         .to = "coast",
         .when = [this] { return rocket_->acceleration < 0.5; },
         .hold = 200ms,
         .cause = "burnout"});
    add({.from = "boost",
         .to = "apogee",
         .when = [&s] { return s.falls() && s.is_smooth() && s.best() > 12; },
         .hold = 2s,
         .cause = "it falls"});
    add({.from = "boost",
         .to = "pad",
         .when = [&s] { return s.best_felt() < 12 && s.still() > 5s; },
         .after = 5s,
         .cause = "it has not flown"});
    add({.from = "coast",
         .to = "apogee",
         .when =
             [&s](const fsm::Moment& moment) {
               return s.is_ready() && s.climb().now() < 0 && s.is_smooth() && s.still() < 1s &&
                      moment.in_state > s.climb().length() && (s.felt().gained() <= 0 || s.is_silent()) &&
                      (s.is_free() || s.is_slow());
             },
         .cause = "apogee"});
    add({.from = "coast",
         .to = "apogee",
         .when = [&s] { return s.felt().was_thrown() && s.felt().speed() < 0 && !s.is_silent() && s.down() > 2500ms; },
         .hold = 1s,
         .after = 3s,
         .cause = "apogee, without a barometer"});
    add({.from = "coast",
         .to = "apogee",
         .when = [&s] { return s.falls() && (s.is_smooth() || s.down() > 3s) && (s.is_free() || s.is_slow()); },
         .hold = 300ms,
         .cause = "it falls"});
    add({.from = "coast",
         .to = "apogee",
         .when = [&s] { return s.falls() && s.is_smooth(); },
         .hold = 2s,
         .cause = "it falls, whatever was felt"});
    add({.from = "coast",
         .to = "apogee",
         .when =
             [&s] {
               const bool sinks = (s.is_ready() && s.climb().mean() < -2) || s.down() > 2500ms;
               return sinks && !s.is_silent() && std::abs(s.felt().gained()) < 6 && s.felt().was_thrown() &&
                      s.is_slow();
             },
         .hold = 1s,
         .cause = "it hangs on something"});
    add({.from = "coast",
         .to = "apogee",
         .when =
             [&s] {
               return s.is_ready() && s.climb().mean() < -2 && (s.is_smooth() || s.down() > 3s) && s.is_silent() &&
                      s.felt().was_thrown();
             },
         .hold = 1s,
         .cause = "it sinks, and nothing is felt"});
    add({.from = "coast",
         .to = "pad",
         .when = [&s] { return !s.felt().was_thrown() && s.still() > 5s; },
         .cause = "it has not flown"});
    add({.from = "apogee", .to = "descent", .after = 500ms, .cause = "the parachute is out"});
    add({.from = "descent",
         .to = "landed",
         .when =
             [&s] {
               return s.is_sink_known() && std::abs(s.sink()) < 2 && s.fastest() > 3 &&
                      (s.unchanged() < 2s || s.is_near_ground());
             },
         .hold = 5s,
         .after = 10s,
         .cause = "landing"});
    add({.from = "descent",
         .to = "landed",
         .when = [&s] { return s.unchanged() > 60s; },
         .after = 30min,
         .cause = "time is up, without a barometer"});
    add({.from = "descent", .to = "landed", .after = 3h, .cause = "time is up"});
  }

  Sensors sensors_;
  rtdata::Feed<Readings> feed_;
  fsm::Machine flight_;
  fsm::Input<Readings> rocket_;
  rtdata::Subscription source_;
};

}  // namespace rocket
