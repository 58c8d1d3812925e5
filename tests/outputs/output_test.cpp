// Outputs in virtual time, with a device of memory.
#include "rtdata/outputs/output.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "outputs/memory_actuator.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/process/expression.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/limit.hpp"

using namespace rtdata;
using namespace std::chrono_literals;
using outputs_test::Device;

namespace {

using Lines = std::vector<std::string>;

struct Air {
  double temperature = 0;
  friend constexpr auto describe(type_tag<Air>) { return record("air", field("temperature", &Air::temperature)); }
};

std::string number(double value) {
  std::string text = std::to_string(value);
  text.erase(text.find_last_not_of('0') + 1);
  if (text.back() == '.') text.pop_back();
  return text;
}

/// A change as a line: "set 1 > 1 by program", with why where it was not done, and "disarmed".
std::string line_of(const OutputChange& change) {
  constexpr const char* causes[] = {"start", "set",    "input",    "stale",   "lease",
                                    "arm",   "disarm", "watchdog", "failure", "stop"};
  std::string line = std::string(causes[static_cast<int>(change.cause)]) + " " + number(change.asked) + " > " +
                     (change.done ? number(*change.done) : "-");
  if (!change.by.empty()) line += " by " + std::string(change.by);
  if (!change.armed) line += ", disarmed";
  if (!change.why.empty()) line += ": " + std::string(change.why);
  return line;
}

struct Bench {
  Loop loop{Loop::Manual{}};
  Device device;
  Lines errors, changes;
  std::vector<double> took;
  Subscription seen;
  Output output;

  Bench() {
    loop.runtime().on_log([](const LogRecord&) {});
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.why); });
    seen = loop.subscribe<OutputChange>("o", [this](const Event<OutputChange>& event) {
      changes.push_back(line_of(*event));
      took.push_back(event->took);
    });
  }
  void make(OutputConfig config) {
    config.name = "o";
    output = Output(loop, std::move(config), device.make());
  }
  Lines told() {
    loop.advance(0ns);
    return std::exchange(changes, {});
  }
};

}  // namespace

TEST_SUITE("outputs") {
  TEST_CASE("US-35 an output is safe from the start on, each change is an event, and what it has already is none") {
    Bench b;
    b.make({.safe = 0});
    CHECK(b.output.value() == 0);
    CHECK(b.told() == Lines{"start 0 > 0"});
    CHECK(b.output.set(1).has_value());
    CHECK(b.output.set(1, "me").has_value());
    b.loop.advance(1ms);
    CHECK(b.told() == Lines{"set 1 > 1 by program"});
    CHECK(b.output.set(0.5, "me").has_value());
    b.loop.advance(1ms);
    CHECK(b.told() == Lines{"set 0.5 > 0.5 by me"});
    CHECK(b.device.did == Lines{"open 0", "set 1", "set 0.5"});
    CHECK(b.output.counts().repeated == 1);
    CHECK(b.output.set(std::nan("")).error().code == Errc::bad_argument);
    b.output.close();
    CHECK(b.device.did == Lines{"open 0", "set 1", "set 0.5", "set 0", "gone"});
    CHECK(b.output.set(1).error().code == Errc::closed);
    CHECK(b.errors.empty());
  }

  TEST_CASE("US-35 an alarm holds until it changes: what follows it is never stale, and has it from its start") {
    Bench b;
    Feed<Air> air(b.loop, {.name = "air"});
    LimitSensor alarm(b.loop, {.name = "hot"}, {.on = "air", .high = 30, .silence = 0s});
    const auto give = [&](double temperature) {
      air.publish({temperature});
      b.loop.advance(1ms);
    };
    give(40);
    b.make({.safe = 0, .on = "hot", .expression = "is_active", .max_age = 1s});
    b.loop.advance(1ms);
    CHECK(b.output.value() == 1);  // it was made later than the alarm
    for (int i = 0; i < 10; ++i) {
      give(41);
      b.loop.advance(1s);
    }
    CHECK(b.output.value() == 1);
    CHECK(b.errors.empty());
    CHECK(b.output.disarm("me").has_value());
    b.loop.advance(1ms);
    CHECK(b.output.value() == 0);
    CHECK(b.output.arm("me").has_value());
    b.loop.advance(1ms);
    CHECK(b.output.value() == 1);
    give(20);
    CHECK(b.output.value() == 0);
    CHECK(b.told() == Lines{"start 0 > 0", "input 1 > 1 by hot", "disarm 0 > 0 by me, disarmed", "arm 0 > 0 by me",
                            "input 1 > 1 by hot", "input 0 > 0 by hot"});
    b.output.close();

    // On the alarm, with what is measured: that changes it too, and its silence counts.
    (void)b.told();
    b.make({.safe = 0,
            .on = "hot",
            .with = {"air"},
            .expression = "not hot.is_active and air.temperature < 25",
            .max_age = 1s});
    give(20);
    CHECK(b.output.value() == 1);
    give(26);
    CHECK(b.output.value() == 0);  // the alarm is as before
    give(21);
    b.loop.advance(900ms);
    CHECK(b.output.value() == 1);
    b.loop.advance(100ms);
    CHECK(b.output.value() == 0);
    CHECK(b.errors == Lines{"the topic \"air\" has had no event yet", "the topic \"air\" has had no event for 1 s"});
    give(21);
    CHECK(b.output.value() == 1);
    CHECK(b.told() == Lines{"start 0 > 0", "stale 0 > 0 by hot", "input 1 > 1 by hot", "input 0 > 0 by hot",
                            "input 1 > 1 by hot", "stale 0 > 0 by hot", "input 1 > 1 by hot"});
    b.errors.clear();
    b.output.close();
    (void)b.told();

    // With another topic, whose silence counts.
    give(40);
    b.make(
        {.safe = 0, .on = "air", .with = {"hot"}, .expression = "temperature > 35 and hot.is_active", .max_age = 1s});
    for (int i = 0; i < 10; ++i) {
      give(41);
      b.loop.advance(500ms);
    }
    CHECK(b.output.value() == 1);
    b.loop.advance(1s);
    CHECK(b.output.value() == 0);
  }

  TEST_CASE("US-35 an output is safe max_age after one of its topics fell silent, whatever the others bring") {
    Bench b;
    Feed<Air> air(b.loop, {.name = "air"}), oven(b.loop, {.name = "oven"});
    LimitSensor alarm(b.loop, {.name = "hot"}, {.on = "oven", .high = 30, .silence = 0s});
    const auto give = [&](Feed<Air>& to, double temperature) {
      to.publish({temperature});
      b.loop.advance(1ms);
    };
    for (const std::string& on : {std::string("hot"), std::string("oven")}) {
      CAPTURE(on);
      give(oven, 20);
      b.loop.advance(2s);  // the alarm tells of a change once in a second
      b.make({.on = on,
              .with = {"air", on == "hot" ? "oven" : "hot"},
              .expression = "hot.is_active and air.temperature < 50 and oven.temperature > 0",
              .max_age = 4s});
      (void)b.told();
      give(air, 20);
      give(oven, 20);
      give(oven, 20);  // after what the alarm made of the one before
      CHECK(b.output.value() == 0);
      give(air, 20);  // for the last time
      for (int i = 0; i < 3; ++i) {
        b.loop.advance(1s);
        give(oven, 20);
      }
      b.loop.advance(200ms);
      give(oven, 40);  // the alarm changes, 3.2 s after
      give(oven, 40);
      CHECK(b.output.value() == 1);
      b.loop.advance(793ms);
      CHECK(b.output.value() == 1);  // 3.999 s after
      b.errors.clear();
      b.loop.advance(1ms);
      CHECK(b.output.value() == 0);
      CHECK(b.errors == Lines{"the topic \"air\" has had no event for 4 s"});
      // Neither another topic nor a change of the alarm makes it go on.
      for (const double temperature : {20, 40, 40}) {
        b.loop.advance(1s);
        give(oven, temperature);
      }
      CHECK(b.output.value() == 0);
      CHECK(b.errors.size() == 1);
      CHECK(b.output.health() == Health::degraded);
      give(air, 20);
      if (on == "oven") give(oven, 40);
      CHECK(b.output.value() == 1);
      CHECK(b.output.health() == Health::ok);
      b.output.close();
    }
  }

  TEST_CASE("US-35 a device that is slow holds no loop: the time it took is told, and only the latest value waits") {
    Bench b;
    b.make({});
    (void)b.told();
    b.took.clear();
    b.loop.script_lane_duration(30ms);
    int ticks = 0;
    const Ticker ticker(b.loop, 1ms, [&](const Tick&) { ++ticks; });
    for (double value : {1.0, 2.0, 3.0, 4.0}) CHECK(b.output.set(value).has_value());
    b.loop.advance(59ms);
    CHECK(ticks == 60);
    CHECK(ticker.missed() == 0);
    CHECK(b.told() == Lines{"set 2 > - by program: replaced by a newer value before the device was ready",
                            "set 3 > - by program: replaced by a newer value before the device was ready",
                            "set 1 > 1 by program"});
    b.loop.advance(1ms);
    CHECK(b.told() == Lines{"set 4 > 4 by program"});
    CHECK(b.took == std::vector<double>{0, 0, 0.03, 0.06});
    CHECK(b.device.did == Lines{"open 0", "set 1", "set 4"});

    Feed<Air> air(b.loop, {.name = "air"});
    Device other;
    Output follows(b.loop, {.name = "f", .on = "air"}, other.make());
    for (double value : {1.0, 2.0, 3.0, 4.0}) {
      air.publish({value});
      b.loop.advance(1ms);
    }
    b.loop.advance(100ms);
    CHECK(other.did == Lines{"open 0", "set 1", "set 4"});
    CHECK(follows.counts().filtered == 2);
    CHECK(follows.counts().published == 3);
  }

  TEST_CASE("US-35 a value holds for its lease, and setting it again extends that") {
    Bench b;
    b.make({.lease = 100ms});
    CHECK(b.output.set(1).has_value());
    b.loop.advance(90ms);
    CHECK(b.output.set(1).has_value());
    b.loop.advance(99ms);
    CHECK(b.output.value() == 1);
    b.loop.advance(1ms);
    CHECK(b.output.value() == 0);
    CHECK(b.told() == Lines{"start 0 > 0", "set 1 > 1 by program", "lease 0 > 0"});
    CHECK(b.output.health() == Health::degraded);
    CHECK(b.errors == Lines{"no program or command has set it for 100 ms"});
    CHECK(b.output.set(1).has_value());
    b.loop.advance(1ms);
    CHECK(b.output.health() == Health::ok);
    CHECK(b.output.value() == 1);
  }

  TEST_CASE("US-35 the end of a lease is told when the safe value is asked for, and does not say that it is there") {
    Bench b;
    b.make({.lease = 100ms});
    Lines told;
    b.loop.on_error([&](const ErrorReport& report) {
      told.push_back(report.error.what + (b.output.is_safe() ? ": it is safe" : ": it is not yet"));
    });
    b.output.set(1).or_throw();
    b.loop.advance(1ms);
    b.loop.script_lane_duration(30ms);
    b.loop.advance(100ms);
    CHECK(told == Lines{"the output is being set to its safe value: it is not yet"});
    b.loop.advance(30ms);
    CHECK(b.output.is_safe());
  }

  TEST_CASE("US-35 what is disarmed has no lease") {
    Bench b;
    b.make({.lease = 100ms, .armed = Arming::by_command});
    b.output.arm("me").or_throw();
    b.output.set(1).or_throw();
    b.loop.advance(50ms);
    b.output.disarm("me").or_throw();
    b.loop.advance(1s);
    CHECK(b.errors.empty());
    CHECK(b.output.health() == Health::ok);
    CHECK(b.told() ==
          Lines{"start 0 > 0, disarmed", "arm 0 > 0 by me", "set 1 > 1 by program", "disarm 0 > 0 by me, disarmed"});
    // One whose lease is over is well again when it is disarmed, and has a new one when it is set again.
    b.output.arm("me").or_throw();
    b.output.set(1).or_throw();
    b.loop.advance(200ms);
    CHECK(b.output.health() == Health::degraded);
    b.output.disarm("me").or_throw();
    b.loop.advance(1ms);
    CHECK(b.output.health() == Health::ok);
    b.output.arm("me").or_throw();
    b.output.set(1).or_throw();
    b.loop.advance(99ms);
    CHECK(b.output.value() == 1);
    b.loop.advance(1ms);
    CHECK(b.output.value() == 0);
  }

  TEST_CASE("US-35 an output follows a topic, is safe while that is stale or fails, and follows it again") {
    Bench b;
    Feed<Air> air(b.loop, {.name = "air"});
    b.make({.on = "air", .expression = "1 / temperature > 0.04", .max_age = 1s});
    (void)b.told();
    const auto feed = [&](double temperature) {
      air.publish({temperature});
      b.loop.advance(100ms);
    };
    feed(30);
    feed(20);
    feed(20);
    CHECK(b.told() == Lines{"input 1 > 1 by air"});  // it was off already
    b.loop.advance(899ms);
    CHECK(b.output.value() == 1);
    b.loop.advance(1ms);
    CHECK(b.told() == Lines{"stale 0 > 0 by air"});
    CHECK(b.output.health() == Health::degraded);
    feed(20);
    CHECK(b.told() == Lines{"input 1 > 1 by air"});
    CHECK(b.output.health() == Health::ok);
    feed(0);
    CHECK(b.told() == Lines{"stale 0 > 0 by air"});
    feed(0);
    CHECK(b.told().empty());
    feed(20);
    CHECK(b.told() == Lines{"input 1 > 1 by air"});
    CHECK(b.errors.size() == 2);
    CHECK(b.output.set(1).error().why == "the output follows the topic \"air\"");
    CHECK(b.output.counts().repeated == 2);  // the first, which was off, and the third
  }

  TEST_CASE("US-35 a topic that never comes is told, and the only number of a topic needs no expression") {
    Bench b;
    b.make({.on = "air", .max_age = 1s});
    b.loop.advance(1s);
    CHECK(b.output.health() == Health::degraded);
    CHECK(b.errors == Lines{"the topic \"air\" has had no event for 1 s"});
    Feed<Air> air(b.loop, {.name = "air"});
    air.publish({0.25});
    b.loop.advance(1ms);
    CHECK(b.output.value() == 0.25);
    CHECK(b.output.health() == Health::ok);
  }

  TEST_CASE("US-35 an output is armed and disarmed, both are recorded, and it is safe while it is not") {
    Bench b;
    b.make({.armed = Arming::by_command});
    CHECK(b.output.set(1, "me").error().code == Errc::not_permitted);
    CHECK(b.told() == Lines{"start 0 > 0, disarmed", "set 1 > - by me, disarmed: it is disarmed"});
    CHECK(b.output.arm("operator").has_value());
    CHECK(b.output.arm("operator").has_value());
    CHECK(b.output.set(1, "me").has_value());
    b.loop.advance(1ms);
    CHECK(b.output.is_armed());
    CHECK(b.told() == Lines{"arm 0 > 0 by operator", "set 1 > 1 by me"});
    CHECK(b.output.disarm("operator").has_value());
    CHECK(b.output.disarm("operator").has_value());
    b.loop.advance(1ms);
    CHECK(b.told() == Lines{"disarm 0 > 0 by operator, disarmed"});
    CHECK(b.device.did == Lines{"open 0", "set 1", "set 0"});

    Feed<Air> air(b.loop, {.name = "air"});
    Device other;
    Output follows(b.loop, {.name = "f", .on = "air", .armed = Arming::by_command}, other.make());
    air.publish({1});
    b.loop.advance(1ms);
    CHECK(other.did == Lines{"open 0"});
    follows.arm("operator").or_throw();
    b.loop.advance(1ms);
    CHECK(other.did == Lines{"open 0"});  // the next value of the topic counts
    air.publish({1});
    b.loop.advance(1ms);
    CHECK(other.did == Lines{"open 0", "set 1"});
  }

  TEST_CASE("US-35 an actuator that refuses a value itself keeps its device, which is set safe") {
    Bench b;
    b.make({});
    b.device.most = 1;
    b.output.set(1).or_throw();
    b.loop.advance(1ms);
    b.output.set(2).or_throw();
    b.loop.advance(1ms);
    CHECK(b.output.value() == 0);
    CHECK(b.output.health() == Health::ok);
    CHECK(b.errors == Lines{"it is too much"});
    CHECK(b.device.did == Lines{"open 0", "set 1", "set 2 refused", "set 0"});
  }

  TEST_CASE("US-35 a device that fails is told once, and set safe as soon as it can be") {
    Bench b;
    b.make({});
    b.output.set(1).or_throw();
    b.loop.advance(1ms);
    b.device.fails = true;
    b.output.set(2).or_throw();
    b.loop.advance(1ms);
    CHECK(b.output.health() == Health::faulted);
    CHECK_FALSE(b.output.value().has_value());
    CHECK(b.errors == Lines{"it is broken"});
    CHECK(b.output.set(2).error().code == Errc::io_failed);
    b.loop.advance(2500ms);
    CHECK(b.errors.size() == 1);
    b.device.fails = false;
    b.loop.advance(1s);
    CHECK(b.output.value() == 0);
    CHECK(b.output.health() == Health::ok);
    CHECK(b.device.did == Lines{"open 0", "set 1", "set 2 failed", "gone", "open 0 failed", "open 0 failed",
                                "open 0 failed", "open 0"});
    CHECK(b.told() == Lines{"start 0 > 0", "set 1 > 1 by program", "set 2 > - by program: it is broken",
                            "failure 0 > -: it is broken", "set 2 > - by program: the device has failed",
                            "failure 0 > -: it is broken", "failure 0 > -: it is broken", "failure 0 > 0"});
  }

  TEST_CASE("US-35 what is asked for while a value is on its way is not lost when the device does not take that") {
    Bench b;
    b.make({});
    b.loop.script_lane_duration(30ms);
    const auto set = [&](double value, const char* by) {
      b.output.set(value, by).or_throw();
      b.loop.advance(1ms);
    };
    // The same value, twice: the first order fails, and the second is done after the safe value.
    b.device.fails = true;
    set(1, "apogee");
    set(1, "descent");
    b.device.fails = false;
    b.loop.advance(2s);
    CHECK(b.output.value() == 1);
    CHECK(b.output.health() == Health::ok);
    CHECK(b.told() ==
          Lines{"start 0 > 0", "set 1 > - by apogee: it is broken", "failure 0 > 0", "set 1 > 1 by descent"});
    CHECK(b.device.did == Lines{"open 0", "set 1 failed", "gone", "open 0", "set 1"});
    // When the device takes the first, the second is a repetition.
    set(2, "first");
    set(2, "second");
    set(2, "third");
    b.loop.advance(100ms);
    CHECK(b.told() == Lines{"set 2 > 2 by first"});
    CHECK(b.output.counts().repeated == 2);
    // Another value, and one that comes while the safe value is on its way.
    for (const bool is_later : {false, true}) {
      b.device.fails = true;
      set(3, "first");
      b.device.fails = false;
      if (is_later) b.loop.advance(40ms);
      set(4, "second");
      b.loop.advance(2s);
      CHECK(b.output.value() == 4);
      CHECK(b.told() == Lines{"set 3 > - by first: it is broken", "failure 0 > 0", "set 4 > 4 by second"});
    }
    // A device that does not even take its safe value: it is told, and nothing is set later.
    b.device.fails = true;
    set(5, "first");
    set(5, "second");
    b.loop.advance(100ms);
    b.device.fails = false;
    b.loop.advance(2s);
    CHECK(b.output.value() == 0);
    CHECK(b.told() == Lines{"set 5 > - by first: it is broken", "failure 0 > -: it is broken",
                            "set 5 > - by second: the device failed", "failure 0 > 0"});
    // Nor when it is disarmed meanwhile.
    b.device.fails = true;
    set(6, "first");
    set(6, "second");
    b.device.fails = false;
    b.output.disarm("me").or_throw();
    b.loop.advance(2s);
    CHECK(b.output.value() == 0);
  }

  TEST_CASE("US-35 a device that hangs is given up, and the loop goes on") {
    Bench b;
    b.make({});
    b.loop.script_lane_duration(10s);
    b.output.set(1).or_throw();
    b.loop.advance(1900ms);
    CHECK(b.errors.empty());
    b.loop.advance(200ms);
    CHECK(b.output.health() == Health::faulted);
    CHECK_FALSE(b.output.value().has_value());
    REQUIRE(!b.errors.empty());
    CHECK(b.errors.back().find("did not return within 2 s") != std::string::npos);
  }

  TEST_CASE("US-35 the end of the loop, stop and close set the safe value, and what is kept stays as it is") {
    Bench b;
    b.make({});
    Device relay, other;
    Output kept(b.loop, {.name = "kept", .keep = true}, relay.make());
    Output stopped(b.loop, {.name = "stopped"}, other.make());
    CHECK(relay.did == Lines{"open kept"});
    CHECK_FALSE(kept.value().has_value());
    b.output.set(1).or_throw();
    kept.set(1).or_throw();
    stopped.set(1).or_throw();
    b.loop.advance(1ms);
    stopped.stop();
    CHECK(other.did == Lines{"open 0", "set 1", "set 0", "gone"});
    CHECK(stopped.set(1).error().code == Errc::closed);
    stopped.start();
    CHECK(other.did.back() == "open 0");
    CHECK(b.told() == Lines{"start 0 > 0", "set 1 > 1 by program"});
    CHECK(b.loop.close(1s) == 0);
    CHECK(b.changes == Lines{"stop 0 > 0"});
    CHECK(b.device.did == Lines{"open 0", "set 1", "set 0", "gone"});
    CHECK(relay.did == Lines{"open kept", "set 1", "gone"});
    CHECK(relay.value == 1);
    CHECK(b.loop.runtime().balances());
  }

  TEST_CASE("US-35 an output that cannot be taken throws, and one that was made before is set safe") {
    Bench b;
    Device first;
    {
      Output one(b.loop, {.name = "one", .safe = 1}, first.make());
      b.device.fails = true;
      CHECK_THROWS_WITH_AS(b.make({}), doctest::Contains("it is broken"), SetupError);
    }
    CHECK(first.did == Lines{"open 1", "set 1", "gone"});
    b.device.fails = false;
    b.make({});  // its name is free again
    CHECK_THROWS_AS(Output(b.loop, {.name = "x", .expression = "a"}, first.make()), SetupError);
    CHECK_THROWS_AS(Output(b.loop, {.name = "x", .safe = std::numeric_limits<double>::infinity()}, first.make()),
                    SetupError);
    CHECK_THROWS_AS(Output(b.loop, {.name = "x", .on = "air", .lease = 1s}, first.make()), SetupError);
    CHECK_THROWS_AS(Output(b.loop, {.name = "x", .on = "air", .expression = "1 +"}, first.make()), SetupError);
  }

  TEST_CASE("US-35 hysteresis switches a fan at two thresholds") {
    Bench b;
    Feed<Air> air(b.loop, {.name = "air"});
    b.make({.on = "air", .hysteresis = HysteresisConfig{.on = 28, .off = 26}});
    for (double temperature : {25.0, 27.9, 28.0, 27.0, 28.5, 26.1, 26.0, 27.5, 29.0}) {
      air.publish({temperature});
      b.loop.advance(1s);
    }
    CHECK(b.device.did == Lines{"open 0", "set 1", "set 0", "set 1"});
  }

  TEST_CASE("US-35 a controller brings a simulated oven to its set point, also after it was disarmed") {
    Bench b;
    Feed<Air> oven(b.loop, {.name = "oven"});
    b.make({.on = "oven", .pid = PidConfig{.setpoint = 60, .kp = 0.05, .ki = 0.002}});
    double temperature = 20;
    const auto run = [&](int seconds) {
      double highest = 0;
      for (int i = 0; i < seconds; ++i) {  // heats by 1 K/s at most, loses 1 % of the difference to 20 degrees
        temperature += b.device.value.value_or(0) - 0.01 * (temperature - 20);
        highest = std::max(highest, temperature);
        oven.publish({temperature});
        b.loop.advance(1s);
      }
      return highest;
    };
    CHECK(run(600) < 63);
    CHECK(temperature == doctest::Approx(60).epsilon(0.01));
    b.output.disarm("me").or_throw();
    b.loop.advance(1ms);
    CHECK(b.device.value == 0);
    run(100);
    CHECK(temperature < 40);
    b.output.arm("me").or_throw();
    run(1);
    CHECK(b.device.value == 0);  // it goes on from what the device has
    CHECK(run(900) < 63);
    CHECK(temperature == doctest::Approx(60).epsilon(0.01));
  }

  TEST_CASE("US-35 a device that is absent or mute at the start is tried again, unless it is required") {
    for (const Errc code : {Errc::not_found, Errc::timed_out}) {
      Bench b;
      bool is_there = false;
      struct Absent final : Actuator {
        Absent(Errc code_, const bool& is_there_) : code(code_), is_there(is_there_) {}
        Result<void> open(std::optional<double>) override {
          if (is_there) return {};
          return Error{code, "cannot open", "", "it is not there", ""};
        }
        Result<void> set(double) override { return {}; }
        Errc code;
        const bool& is_there;
      };
      const MakeActuator make = [&] { return std::make_unique<Absent>(code, is_there); };
      CHECK_THROWS_AS(Output(b.loop, {.name = "o", .required = true}, make), SetupError);
      b.output = Output(b.loop, {.name = "o"}, make);
      CHECK(b.output.health() == Health::faulted);
      b.loop.advance(2s);
      CHECK_FALSE(b.output.value().has_value());
      is_there = true;
      b.loop.advance(2s);
      CHECK(b.output.value() == 0);
      CHECK(b.output.health() == Health::ok);
    }
  }

  TEST_CASE("US-35 a device that answers each time is not told to be mute, however often it is set") {
    Bench b;
    Feed<Air> air(b.loop, {.name = "air"});
    b.loop.script_lane_duration(30ms);
    b.make({.on = "air"});
    for (int i = 1; i <= 500; ++i) {
      air.publish({static_cast<double>(i)});
      b.loop.advance(20ms);
    }
    CHECK(b.errors.empty());
    CHECK(b.device.did.size() > 300);
    // One that does not answer is told once.
    b.loop.script_lane_duration(1h);
    air.publish({0.5});
    b.loop.advance(2s);
    CHECK(b.errors.empty());
    b.loop.advance(2s);
    CHECK(b.errors.size() == 1);
  }

  TEST_CASE("US-35 US-33 what follows an alarm of a tier is safe while that tier hangs, and follows it again") {
    Bench b;
    Tier fast(b.loop, {.name = "fast", .hold_limit = 1h});
    Feed<Air> air(b.loop, {.name = "air"});
    LimitSensor alarm(fast.loop(), {.name = "hot"}, {.on = "air", .high = 30, .silence = 0s});
    b.make({.on = "hot", .expression = "is_active == 0", .max_age = 1s});
    b.loop.advance(10ms);
    air.publish({20});
    b.loop.advance(1min);
    CHECK(b.output.value() == 1);
    const auto hang = [&](Duration time) {  // in a callback of the tier
      fast.loop().post([&, time] { b.loop.manual_clock().pass(time); });
    };
    hang(500ms);
    b.loop.advance(5s);
    CHECK(b.device.did == Lines{"open 0", "set 1"});
    hang(10s);
    b.loop.advance(700ms);
    CHECK(b.output.value() == 1);
    b.loop.advance(1s);
    CHECK(b.output.value() == 0);
    REQUIRE(b.errors.size() == 1);
    CHECK(b.errors[0] == "loop fast has not turned for 1 s, so changes of the topic are unknown");
    air.publish({40});  // which the tier does not see yet
    b.loop.advance(1s);
    air.publish({20});
    b.loop.advance(5s);
    CHECK(b.output.value() == 0);
    b.loop.advance(5s);
    CHECK(b.output.value() == 1);
    CHECK(b.output.health() == Health::ok);
  }

  TEST_CASE("US-35 a controller without an integral has its value again after stale input, and after arming") {
    for (const Arming armed : {Arming::at_start, Arming::by_command}) {
      Bench b;
      Feed<Air> air(b.loop, {.name = "air"});
      b.make({.on = "air", .pid = PidConfig{.setpoint = 20, .kp = 0.1}, .max_age = 500ms, .armed = armed});
      const auto brings = [&](double temperature) {
        air.publish({temperature});
        b.loop.advance(100ms);
        return b.device.value;
      };
      CHECK(brings(15) == (armed == Arming::at_start ? 0.5 : 0.0));
      if (armed == Arming::by_command) b.output.arm("me").or_throw();
      CHECK(brings(15) == 0.5);
      b.loop.advance(2s);
      CHECK(b.device.value == 0.0);
      CHECK(brings(15) == 0.5);
      CHECK(brings(10) == 1.0);
    }
  }

  TEST_CASE("US-35 the set point of a controller can be changed while it runs, without a step") {
    Bench b;
    Feed<Air> air(b.loop, {.name = "air"});
    b.make({.on = "air", .pid = PidConfig{.setpoint = 20, .kp = 0.1, .ki = 0.01}});
    const auto brings = [&](double temperature) {
      air.publish({temperature});
      b.loop.advance(1s);
      return b.device.value.value_or(-1);
    };
    brings(18);
    const double before = brings(18);
    b.output.change_setpoint(25).or_throw();
    CHECK(brings(18) == doctest::Approx(before + 0.07));
    CHECK_FALSE(b.output.change_setpoint(std::nan("")));
    CHECK_FALSE(b.output.change_pid({.setpoint = 20, .kp = 1, .least = 1, .most = 1}));
    CHECK(brings(18) == doctest::Approx(before + 0.14));
    b.output.close();
    CHECK(b.output.change_setpoint(20).error().code == Errc::closed);
    b.make({});
    CHECK(b.output.change_setpoint(20).error().code == Errc::bad_argument);
  }
}
