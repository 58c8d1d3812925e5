// fsm_event: what a state machine of 8 states costs for each event, beside a switch by hand on the same loop: an event
// that three transitions are tried for, and one that takes a transition.
// limits: what four limits cost for each value, beside four comparisons with hysteresis by hand.
#include <cstdint>
#include <string>
#include <vector>

#include "harness.hpp"
#include "rtdata/fsm/machine.hpp"
#include "rtdata/loop/topic.hpp"
#include "rtdata/process/limits.hpp"
#include "rtdata/sensors/feed.hpp"

namespace bench {
namespace {

using namespace std::chrono_literals;
namespace fsm = rtdata::fsm;

constexpr unsigned events = 100'000;
constexpr unsigned states = 8;

struct Value {
  double value = 0;
  RTDATA_FIELDS(Value, (value))
};

double ns_per_event(std::int64_t begin) { return static_cast<double>(thread_cpu_ns() - begin) / events; }

/// A topic whose events are published and delivered, 100 in a turn of a loop in virtual time.
struct Loaded {
  Loaded() : feed(loop, {.name = "value"}) {}
  /// Values of which each `taken`th is larger than 1.
  double measure(unsigned taken) {
    const std::int64_t begin = thread_cpu_ns();
    for (unsigned i = 0; i < events;) {
      for (unsigned k = 0; k < 100; ++k, ++i) feed.publish({i % taken == 0 ? 2.0 : 0.0});
      loop.advance(1ms);
    }
    return ns_per_event(begin);
  }
  rtdata::Loop loop{rtdata::Loop::Manual{}};
  rtdata::Feed<Value> feed;
};

class Ours : public Loaded {
 public:
  Ours() {
    for (unsigned i = 0; i < states; ++i) machine_.add_state(name(i));
    for (unsigned i = 0; i < states; ++i) {
      for (const double limit : {100.0, 50.0, 1.0})
        machine_.add_transition({.from = name(i), .to = name((i + 1) % states), .when = [this, limit] {
                                   return value_ && value_->value > limit;
                                 }});
    }
    machine_.start();
  }
  std::uint64_t changes() const { return machine_.counts().transitions; }

 private:
  static std::string name(unsigned i) { return "state" + std::to_string(i); }
  fsm::Machine machine_{loop, {.name = "machine", .start = "state0"}};
  fsm::Input<Value> value_{machine_, "value"};
};

/// The same, with its changes published.
class ByHand : public Loaded {
 public:
  ByHand() : changes_(loop, {.name = "machine"}) {
    seen_ = loop.subscribe<Value>("value", [this](const rtdata::Event<Value>& event) {
      const double value = event->value;
      switch (state_) {
        case 0:
        case 1:
        case 2:
        case 3:
        case 4:
        case 5:
        case 6:
        case 7:
          if (value > 100 || value > 50 || value > 1) change((state_ + 1) % states, event.time);
          break;
        default:
          break;
      }
    });
  }

 private:
  void change(unsigned to, rtdata::Time time) {
    static constexpr const char* names[] = {"state0", "state1", "state2", "state3",
                                            "state4", "state5", "state6", "state7"};
    fsm::StateChange change;
    change.from = names[state_];
    change.to = names[to];
    change.cause = "value";
    change.lasted = std::chrono::duration<double>(time - since_).count();
    since_ = time;
    state_ = to;
    changes_.publish(change, time);
  }
  rtdata::Feed<fsm::StateChange> changes_;
  rtdata::Subscription seen_;
  unsigned state_ = 0;
  rtdata::Time since_{};
};

/// Values that wander over all four limits.
const std::vector<double>& values() {
  static const std::vector<double> all = [] {
    std::vector<double> made(4096);
    std::uint32_t noise = 1;
    double value = 0;
    for (double& one : made) {
      noise = noise * 1664525u + 1013904223u;
      value = value * 0.99 + (static_cast<double>(noise >> 8) / (1 << 24) - 0.5) * 4;
      one = value;
    }
    return made;
  }();
  return all;
}
constexpr double limits[] = {-8, -4, 4, 8};
constexpr double hysteresis = 0.5;

double measure_watch() {
  rtdata::LimitSettings settings;
  settings.low_low = limits[0];
  settings.low = limits[1];
  settings.high = limits[2];
  settings.high_high = limits[3];
  settings.hysteresis = hysteresis;
  rtdata::LimitWatch watch(settings);
  const auto& all = values();
  rtdata::Time time{};
  unsigned changes = 0;
  const std::int64_t begin = thread_cpu_ns();
  for (unsigned i = 0; i < events; ++i)
    changes += watch.take(all[i % all.size()], time += rtdata::Duration{1'000'000}) ? 1 : 0;
  keep(changes);
  return ns_per_event(begin);
}

/// Each limit with a flag of its own, and the worst that is set.
double measure_by_hand() {
  const auto& all = values();
  bool low_low = false, low = false, high = false, high_high = false;
  int level = 0;
  unsigned changes = 0;
  const std::int64_t begin = thread_cpu_ns();
  for (unsigned i = 0; i < events; ++i) {
    const double value = all[i % all.size()];
    low_low = value < limits[0] || (low_low && value < limits[0] + hysteresis);
    low = value < limits[1] || (low && value < limits[1] + hysteresis);
    high = value > limits[2] || (high && value > limits[2] - hysteresis);
    high_high = value > limits[3] || (high_high && value > limits[3] - hysteresis);
    const int now = low_low ? -2 : high_high ? 2 : low ? -1 : high ? 1 : 0;
    changes += now != level ? 1 : 0;
    level = now;
    keep(level);
  }
  keep(changes);
  return ns_per_event(begin);
}

}  // namespace

void bench_machines(Report& report) {
  if (report.wants("fsm_event")) {
    Ours ours;
    ByHand by_hand;
    report.add(measure_pair(
        {.name = "fsm_event", .unit = "ns/event", .reach = 2}, [&] { return ours.measure(~0u); },
        [&] { return by_hand.measure(~0u); }, 15));
    report.add(measure_pair(
        {.name = "fsm_event_taken", .unit = "ns/event", .reach = 2}, [&] { return ours.measure(1); },
        [&] { return by_hand.measure(1); }, 15));
    report.remark("fsm_event: " + std::to_string(ours.changes()) + " changes");
  }
  if (report.wants("limits"))
    report.add(measure_pair({.name = "limits", .unit = "ns/event", .reach = 2}, measure_watch, measure_by_hand, 15));
}

}  // namespace bench
