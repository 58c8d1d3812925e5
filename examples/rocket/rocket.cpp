// The rocket of rocket.json once more, in C++: flown from a recording of its sensors, as fast as it goes. On board, a
// sensor takes the place of the replay. What the numbers mean: docs/tutorial-rocket.md.
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <memory>
#include <string>

#include "rtdata/fsm/machine.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/sinks/recording.hpp"
#include "rtdata/sinks/replay.hpp"
#include "rtdata/sinks/sqlite.hpp"

using namespace std::chrono_literals;
namespace fsm = rtdata::fsm;

constexpr double g = 9.81;

struct Readings {
  double altitude = 0;
  double acceleration = 0;
  friend constexpr auto describe(rtdata::type_tag<Readings>) {
    return rtdata::record("import", rtdata::field("altitude", &Readings::altitude, "m"),  // as rtdata import calls it
                          rtdata::field("acceleration", &Readings::acceleration));
  }
};

double seconds(rtdata::Duration duration) { return std::chrono::duration<double>(duration).count(); }

// The speed now of something that is thrown upwards: the slope of a straight line through its latest altitudes, which
// is its speed in their middle, less what gravity takes away from there on.
class Climb {
 public:
  explicit Climb(rtdata::Duration length) : length_(length) {}
  void take(rtdata::Time time, double altitude) {
    if (count_ > 0 && time - newest().time > 500ms) count_ = 0;  // a gap
    at_ = (at_ + 1) % rows_.size();
    rows_[at_] = {time, altitude};
    if (count_ < rows_.size()) ++count_;
    while (time - row(count_ - 1).time > length_) --count_;
  }
  rtdata::Duration length() const { return length_; }
  bool is_whole() const { return count_ > 2 && seconds(newest().time - row(count_ - 1).time) > 0.8 * seconds(length_); }
  double speed() const {
    double t = 0, h = 0, tt = 0, th = 0;
    for (std::size_t i = 0; i < count_; ++i) {
      const double x = seconds(row(i).time - newest().time), y = row(i).altitude - newest().altitude;
      t += x, h += y, tt += x * x, th += x * y;
    }
    const double n = double(count_);
    return (n * th - t * h) / (n * tt - t * t) + g * t / n;
  }

 private:
  struct Row {
    rtdata::Time time{};
    double altitude = 0;
  };
  const Row& row(std::size_t back) const { return rows_[(at_ + rows_.size() - back) % rows_.size()]; }
  const Row& newest() const { return row(0); }
  const rtdata::Duration length_;
  std::array<Row, 500> rows_{};  // enough for the longer one at 120 Hz
  std::size_t at_ = 0, count_ = 0;
};

// What the states look at.
struct Sensors {
  Climb quick{1s}, slow{4s};
  double noise = 0;  // m, of the barometer
  bool is_flying = false;
  double felt_speed = 0;   // m/s, what was felt since liftoff, less gravity
  rtdata::Time changed{};  // when the altitude last did
  rtdata::Time fast{};     // when it last climbed or fell faster than 25 m/s
  rtdata::Time now{};

  void take(rtdata::Time time, const Readings& readings) {
    const double passed = seconds(time - now);
    now = time;
    felt_speed = is_flying || readings.acceleration > 1.8 ? felt_speed + (readings.acceleration - 1) * g * passed : 0;
    if (!std::isfinite(readings.altitude)) return;
    if (readings.altitude != before_) changed = time;
    const double step = readings.altitude - before_;
    noise += (std::min(std::abs(step - step_before_) / 2, 8.0) - noise) * std::min(1.0, passed / 0.7);
    step_before_ = step;
    before_ = readings.altitude;
    quick.take(time, readings.altitude);
    slow.take(time, readings.altitude);
    if (std::abs(climb().speed()) > 25) fast = time;
  }
  const Climb& climb() const { return noise < 4 ? quick : slow; }
  double unchanged() const { return seconds(now - changed); }

 private:
  double before_ = 0, step_before_ = 0;
};

class Boost : public fsm::State {
 public:
  explicit Boost(Sensors& sensors) : sensors_(sensors) {}
  void arrive(const fsm::Moment&) override { sensors_.is_flying = true; }
  void leave(const fsm::Moment&) override { std::printf("  at %.0f m/s\n", sensors_.felt_speed); }

 private:
  Sensors& sensors_;
};

// The charge is on while the machine is in this state: set an rtdata::Output here.
class Apogee : public fsm::State {
 public:
  void arrive(const fsm::Moment&) override { std::puts("  charge on"); }
  void leave(const fsm::Moment&) override { std::puts("  charge off"); }
};

// The machine stays in the boost while `check` says no: who has merely carried the rocket about has not flown it.
class Coast : public fsm::State {
 public:
  explicit Coast(const Sensors& sensors) : sensors_(sensors) {}
  bool check(const fsm::Moment&) override { return std::max(sensors_.felt_speed, sensors_.quick.speed()) > 5; }

 private:
  const Sensors& sensors_;
};

int main(int argc, char** argv) {
  const std::string flight_of = argc > 1 ? argv[1] : "flight.db", decisions = argc > 2 ? argv[2] : "decided.db";
  rtdata::ManualClock clock(rtdata::Recording::open(flight_of).or_throw().runs().or_throw().back().started);
  rtdata::Runtime runtime({.name = "rocket", .clock = &clock});
  rtdata::Loop loop(runtime, {});
  rtdata::SqliteSink sink(loop, {.path = decisions});

  Sensors sensors;
  const auto take = loop.subscribe<Readings>("rocket", [&](const auto& event) { sensors.take(event.time, *event); });
  fsm::Machine flight(loop, {.name = "flight", .start = "pad"});
  fsm::Input<Readings> rocket(flight, "rocket", 1s);  // behind `take`, which knows of a row first
  const auto falls = [&] { return sensors.quick.is_whole() && sensors.quick.speed() < -15; };

  flight.add_state("pad");
  flight.add_state("boost", std::make_unique<Boost>(sensors));
  flight.add_state("coast", std::make_unique<Coast>(sensors));
  flight.add_state("apogee", std::make_unique<Apogee>());
  flight.add_state("descent");
  flight.add_state("landed", {.is_final = true});

  flight.add_transition({.from = "pad",
                         .to = "boost",
                         .when = [&] { return rocket->acceleration > 1.8; },
                         .hold = 100ms,
                         .cause = "liftoff"});
  flight.add_transition({.from = "boost",
                         .to = "coast",
                         .when = [&] { return rocket->acceleration < 0.5; },
                         .hold = 200ms,
                         .cause = "burnout"});
  flight.add_transition({.from = "boost", .to = "apogee", .when = falls, .hold = 2s, .cause = "it falls"});
  flight.add_transition({.from = "coast",
                         .to = "apogee",
                         .when =
                             [&](const fsm::Moment& moment) {
                               const Climb& climb = sensors.climb();
                               return moment.in_state > climb.length() && climb.is_whole() && climb.speed() < 0 &&
                                      sensors.now - sensors.fast > 1s && sensors.unchanged() < 0.5;
                             },
                         .cause = "apogee"});
  flight.add_transition({.from = "coast",
                         .to = "apogee",
                         .when = [&] { return sensors.felt_speed < 0 && sensors.unchanged() > 2.5; },
                         .cause = "apogee, without a barometer"});
  flight.add_transition({.from = "coast", .to = "apogee", .when = falls, .hold = 2s, .cause = "it falls"});
  flight.add_transition({.from = "apogee", .to = "descent", .after = 2s, .cause = "the parachute is out"});
  flight.add_transition({.from = "descent",
                         .to = "landed",
                         .when =
                             [&](const fsm::Moment& moment) {
                               return sensors.slow.is_whole() && std::abs(sensors.slow.speed() + 2 * g) < 2 &&
                                      sensors.unchanged() < seconds(moment.in_state);
                             },
                         .hold = 5s,
                         .after = 10s,
                         .cause = "landing"});

  const auto tell = loop.subscribe<fsm::StateChange>("flight", [](const rtdata::Event<fsm::StateChange>& change) {
    std::printf("%8.2f s  %s: %s\n", seconds(change.time.time_since_epoch()), std::string(change->to).c_str(),
                std::string(change->cause).c_str());
  });
  flight.start();
  rtdata::Replay replay(loop, {.file = flight_of, .topics = {"rocket"}});
  while (!replay.is_done()) loop.advance(1s);
  return flight.state() == "landed" ? 0 : 1;
}
