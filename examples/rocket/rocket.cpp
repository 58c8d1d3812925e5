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

// The speed of something that is thrown upwards: the slope of a straight line through its latest altitudes is its speed
// in their middle; it is slower now, by what gravity has taken away since.
class Climb {
 public:
  explicit Climb(rtdata::Duration length) : length_(length) {}
  void take(rtdata::Time time, double altitude) {
    if (count_ > 0 && time - newest().time > 500ms) count_ = 0;  // a gap
    at_ = (at_ + 1) % rows_.size();
    rows_[at_] = {time, altitude};
    if (count_ < rows_.size()) ++count_;
    while (time - row(count_ - 1).time > length_) --count_;
    double t = 0, h = 0, tt = 0, th = 0;
    for (std::size_t i = 0; i < count_; ++i) {
      const double x = seconds(row(i).time - time), y = row(i).altitude - altitude;
      t += x, h += y, tt += x * x, th += x * y;
    }
    const double n = double(count_);
    mean_ = count_ > 2 ? (n * th - t * h) / (n * tt - t * t) : 0;
    now_ = mean_ + g * t / n;
  }
  rtdata::Duration length() const { return length_; }
  bool is_whole() const { return count_ > 2 && seconds(newest().time - row(count_ - 1).time) > 0.8 * seconds(length_); }
  double mean() const { return mean_; }
  double now() const { return now_; }

 private:
  struct Row {
    rtdata::Time time{};
    double altitude = 0;
  };
  const Row& row(std::size_t back) const { return rows_[(at_ + rows_.size() - back) % rows_.size()]; }
  const Row& newest() const { return row(0); }
  const rtdata::Duration length_;
  std::array<Row, 2048> rows_{};  // enough for the longer one at 500 Hz
  std::size_t at_ = 0, count_ = 0;
  double mean_ = 0, now_ = 0;
};

// What the accelerometer says.
class Felt {
 public:
  void take(rtdata::Time time, double acceleration) {
    const double passed = seconds(time - rows_[at_].time);
    speed_ += (acceleration - 1) * g * passed;
    if (passed > 0.5) count_ = 0;  // a gap, of which nothing is known
    at_ = (at_ + 1) % rows_.size();
    rows_[at_] = {time, speed_};
    if (count_ < rows_.size()) ++count_;
    while (time - row(count_ - 1).time > 2s) --count_;
    if (!was_thrown_ && gained() > 12) {
      was_thrown_ = true;
      speed_ = rows_[at_].speed = gained();
      count_ = 1;
    }
    if (was_thrown_) top_ = std::max(top_, speed_);
  }
  bool was_thrown() const { return was_thrown_; }
  double speed() const { return speed_; }                                            // m/s, since it was thrown
  double top() const { return top_; }                                                // the highest of them
  double gained() const { return count_ > 0 ? speed_ - row(count_ - 1).speed : 0; }  // m/s, in the last 2 s

 private:
  struct Row {
    rtdata::Time time{};
    double speed = 0;
  };
  const Row& row(std::size_t back) const { return rows_[(at_ + rows_.size() - back) % rows_.size()]; }
  std::array<Row, 1024> rows_{};  // 2 s at 500 Hz
  std::size_t at_ = 0, count_ = 0;
  bool was_thrown_ = false;
  double speed_ = 0, top_ = 0;
};

// What the states look at.
struct Sensors {
  Climb quick{1s}, slow{4s};
  Felt felt;
  double noise = 0;                // m, of the barometer
  double best = 0;                 // m/s, that was surely reached since liftoff, by one sensor or the other
  bool was_fast = false;           // the barometer has shown more than 50 m/s
  rtdata::Time above_50, above_5;  // m/s, when it was last faster
  rtdata::Time moved;              // when it was last faster than 8 m/s, up or down
  rtdata::Time changed;            // when the altitude last did
  rtdata::Time now;

  explicit Sensors(rtdata::Time start) : above_50(start), above_5(start), moved(start), changed(start), now(start) {}

  void take(rtdata::Time time, const Readings& readings) {
    const double passed = seconds(time - now);
    now = time;
    if (std::isfinite(readings.acceleration)) felt.take(time, readings.acceleration);
    if (std::isfinite(readings.altitude)) take_altitude(readings.altitude, passed);
    best = std::max({best, felt.gained(), climb().is_whole() ? climb().mean() - noise : 0});
  }
  const Climb& climb() const { return noise < 3 ? quick : slow; }
  bool is_ready() const { return climb().is_whole() && now - changed < 500ms; }
  rtdata::Duration still() const { return now - moved; }
  // From 50 m/s to 5 in more than a second, as what flies freely: what is stuck, or wrong near Mach 1, stops at once.
  bool is_smooth() const { return !was_fast || above_5 - above_50 > 1s; }

 private:
  void take_altitude(double altitude, double passed) {
    since_change_ += passed;
    if (altitude != before_) {  // rows that only repeat a value do not count
      const double step = altitude - before_;
      noise += (std::min(std::abs(step - step_before_) / 2, 8.0) - noise) * std::min(1.0, since_change_ / 0.7);
      step_before_ = step;
      before_ = altitude;
      changed = now;
      since_change_ = 0;
    }
    quick.take(now, altitude);
    slow.take(now, altitude);
    if (!climb().is_whole() || std::abs(climb().mean()) > 8) moved = now;
    if (!is_ready()) return;
    if (climb().now() > 50) was_fast = true, above_50 = now;
    if (climb().now() > 5) above_5 = now;
  }
  double before_ = 0, step_before_ = 0, since_change_ = 0;
};

// It has not flown before it was as fast as nobody carries it.
class Boost : public fsm::State {
 public:
  explicit Boost(Sensors& sensors) : sensors_(sensors) {}
  void arrive(const fsm::Moment&) override { sensors_.best = 0; }
  void leave(const fsm::Moment&) override { std::printf("  at %.0f m/s\n", sensors_.felt.speed()); }

 private:
  Sensors& sensors_;
};

// The charge is on while the machine is in this state: set an rtdata::Output here.
class Apogee : public fsm::State {
 public:
  void arrive(const fsm::Moment&) override { std::puts("  charge on"); }
  void leave(const fsm::Moment&) override { std::puts("  charge off"); }
};

// The machine stays in the boost while `check` says no.
class Coast : public fsm::State {
 public:
  explicit Coast(const Sensors& sensors) : sensors_(sensors) {}
  bool check(const fsm::Moment&) override { return sensors_.best > 12; }

 private:
  const Sensors& sensors_;
};

int main(int argc, char** argv) {
  const std::string flight_of = argc > 1 ? argv[1] : "flight.db", decisions = argc > 2 ? argv[2] : "decided.db";
  const rtdata::Time start = rtdata::Recording::open(flight_of).or_throw().runs().or_throw().back().started;
  rtdata::ManualClock clock(start);
  rtdata::Runtime runtime({.name = "rocket", .clock = &clock});
  rtdata::Loop loop(runtime, {});
  rtdata::SqliteSink sink(loop, {.path = decisions});

  Sensors sensors(start);
  const auto take = loop.subscribe<Readings>("rocket", [&](const auto& event) { sensors.take(event.time, *event); });
  fsm::Machine flight(loop, {.name = "flight", .start = "pad"});
  fsm::Input<Readings> rocket(flight, "rocket", 1s);  // behind `take`, which knows of a row first
  const auto falls = [&] { return sensors.is_ready() && sensors.climb().mean() < -10 && sensors.is_smooth(); };
  const Felt& felt = sensors.felt;

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
  flight.add_transition({.from = "pad",
                         .to = "boost",
                         .when = [&] { return sensors.is_ready() && sensors.climb().mean() - sensors.noise > 12; },
                         .hold = 700ms,
                         .cause = "liftoff, by the barometer"});
  flight.add_transition({.from = "boost",
                         .to = "coast",
                         .when = [&] { return rocket->acceleration < 0.5; },
                         .hold = 200ms,
                         .cause = "burnout"});
  flight.add_transition({.from = "boost",
                         .to = "apogee",
                         .when = [&] { return falls() && sensors.best > 12; },
                         .hold = 2s,
                         .cause = "it falls"});
  flight.add_transition({.from = "boost",
                         .to = "pad",
                         .when = [&] { return sensors.best < 12 && sensors.still() > 5s; },
                         .after = 5s,
                         .cause = "it has not flown"});
  flight.add_transition({.from = "coast",
                         .to = "apogee",
                         .when =
                             [&](const fsm::Moment& moment) {
                               return sensors.is_ready() && sensors.climb().now() < 0 && sensors.is_smooth() &&
                                      sensors.still() < 1s && moment.in_state > sensors.climb().length() &&
                                      felt.gained() <= 0 && (!felt.was_thrown() || felt.speed() < felt.top() / 3);
                             },
                         .cause = "apogee"});
  flight.add_transition({.from = "coast",
                         .to = "apogee",
                         .when = [&] { return felt.was_thrown() && felt.speed() < 0 && sensors.still() > 2500ms; },
                         .cause = "apogee, without a barometer"});
  flight.add_transition({.from = "coast", .to = "apogee", .when = falls, .hold = 300ms, .cause = "it falls"});
  flight.add_transition({.from = "coast",
                         .to = "pad",
                         .when = [&] { return !felt.was_thrown() && sensors.still() > 5s; },
                         .cause = "it has not flown"});
  flight.add_transition({.from = "apogee", .to = "descent", .after = 2s, .cause = "the parachute is out"});
  flight.add_transition({.from = "descent",
                         .to = "landed",
                         .when =
                             [&](const fsm::Moment& moment) {
                               return sensors.slow.is_whole() && std::abs(sensors.slow.mean()) < 2 &&
                                      sensors.now - sensors.changed < moment.in_state;
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
