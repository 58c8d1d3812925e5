#include "rtdata/sensors/trigger.hpp"

#include <doctest/doctest.h>

#include <numeric>
#include <string>
#include <vector>

#include "fsm/configured.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/change.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/process/expression.hpp"
#include "rtdata/sensors/limit.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace std::chrono_literals;

namespace {

struct Thrust {
  double value = 0;
  text<8> note = {};
  RTDATA_FIELDS(Thrust, (value, "N"), (note))
};
struct Button {
  bool pressed = false;
  RTDATA_FIELDS(Button, (pressed))
};

/// Of the numbers from one to another.
std::vector<double> numbers(int first, int last) {
  std::vector<double> all(static_cast<std::size_t>(last - first + 1));
  std::iota(all.begin(), all.end(), first);
  return all;
}

/// A feed of 1, 2, 3 and so on, one each 100 ms, with a trigger and what that passes on.
struct TriggerBench {
  explicit TriggerBench(TriggerConfig config) : loop(Loop::Manual{}) {
    be_quiet(loop);
    thrust = Feed<Thrust>(loop, {.name = "thrust"});
    button = Feed<Button>(loop, {.name = "button"});
    config.on = "thrust";
    if (config.when.find("button") != std::string::npos) config.with = {"button"};
    trigger = TriggerSensor(loop, {.name = "burn"}, std::move(config));
    trigger.on_error([this](const ErrorReport& report) { errors.push_back(report.error.why); });
    seen = loop.subscribe<Thrust>("burn", [this](const Event<Thrust>& event) {
      values.push_back(event->value);
      times.push_back(event.time);
      notes_are_right = notes_are_right && event->note == std::to_string(static_cast<int>(event->value));
    });
  }
  void run(int events) {
    for (int i = 0; i < events; ++i) {
      loop.advance(100ms);
      ++last;
      thrust.publish({static_cast<double>(last), text<8>(std::to_string(last))});
      sent.push_back(loop.time());
      loop.advance(0ms);
    }
  }
  void press(bool pressed) {
    button.publish({pressed});
    loop.advance(0ms);
  }
  SensorCounts counts() const { return trigger.status().counts; }
  /// Each once, in order, with the times that they had.
  bool has_times() const {
    for (std::size_t i = 0; i < values.size(); ++i)
      if (times[i] != sent[static_cast<std::size_t>(values[i]) - 1]) return false;
    return notes_are_right;
  }

  Loop loop;
  Feed<Thrust> thrust;
  Feed<Button> button;
  TriggerSensor trigger;
  Subscription seen;
  std::vector<double> values;
  std::vector<Time> times, sent;
  std::vector<std::string> errors;
  int last = 0;
  bool notes_are_right = true;
};

}  // namespace

TEST_SUITE_BEGIN("sensors");

TEST_CASE("US-17 what came before the trigger is passed on, in order, each event once, and all is accounted for") {
  TriggerBench bench({.when = "button.pressed", .before = 1s});
  bench.run(30);
  CHECK(bench.values.empty());
  bench.press(true);  // at the time of 30
  CHECK(bench.values == numbers(20, 30));
  bench.run(5);
  CHECK(bench.values == numbers(20, 35));
  CHECK(bench.has_times());
  CHECK(bench.counts().published == 16);
  CHECK(bench.counts().filtered == 19);
  CHECK(bench.counts().received == 35);
  CHECK(bench.loop.runtime().balances());
  CHECK_FALSE(bench.loop.runtime().has_loss());
  bench.press(false);
  bench.run(5);
  CHECK(bench.values == numbers(20, 35));
  bench.press(true);  // again: nothing twice, and nothing of the first time
  CHECK(bench.values == numbers(20, 40));
  bench.press(false);
  bench.run(30);
  bench.press(true);
  std::vector<double> all = numbers(20, 40);
  for (const double number : numbers(60, 70)) all.push_back(number);
  CHECK(bench.values == all);
  CHECK(bench.has_times());
  CHECK(bench.counts().received == 70);
  CHECK(bench.counts().published + bench.counts().filtered == 70);
  CHECK(bench.errors.empty());
  CHECK(bench.loop.runtime().balances());
}

TEST_CASE(
    "US-17 the condition of a trigger may be of the events themselves, which then begin with the one that makes it") {
  TriggerBench bench({.when = "value >= 5 and value < 8"});
  bench.run(10);
  CHECK(bench.values == numbers(5, 7));
  TriggerBench before({.when = "thrust.value >= 5 and thrust.value < 8", .before = 200ms});
  before.run(10);
  CHECK(before.values == numbers(3, 7));
}

TEST_CASE("US-17 a ring that is longer than the run passes on everything") {
  TriggerBench bench({.when = "button.pressed", .before = 1h});
  bench.run(50);
  bench.press(true);
  CHECK(bench.values == numbers(1, 50));
  CHECK(bench.counts().filtered == 0);
}

TEST_CASE("US-17 what is in the ring at the end is filtered, and a start begins with an empty one") {
  TriggerBench bench({.when = "button.pressed", .before = 1s});
  bench.run(25);
  CHECK(bench.counts().received == 14);  // the others are in the ring
  bench.trigger.stop();
  CHECK(bench.counts().received == 25);
  CHECK(bench.counts().filtered == 25);
  bench.press(true);
  bench.run(5);  // 26 to 30
  CHECK(bench.values.empty());
  CHECK(bench.counts().received == 25);
  bench.trigger.start();
  bench.run(2);
  CHECK(bench.values.empty());  // the button has not said anything since
  bench.press(true);
  CHECK(bench.values == numbers(31, 32));
  CHECK(bench.loop.runtime().balances());
}

TEST_CASE("US-17 many events are passed on in parts, before those that come meanwhile; an end passes on the rest") {
  for (const bool is_stopped : {false, true}) {
    CAPTURE(is_stopped);
    TriggerBench bench({.when = "button.pressed", .before = 1h});
    bench.run(2500);
    bench.button.publish({true});
    bench.loop.poll();
    CHECK(bench.counts().published == 500);
    bench.button.publish({false});  // what was there when it held is passed on all the same
    if (is_stopped) bench.loop.drain(1s, [](std::uint64_t) {});
    bench.run(is_stopped ? 0 : 1);
    CHECK(bench.counts().published == 2500);
    if (!is_stopped) CHECK(bench.values == numbers(1, 2500));
    CHECK(bench.loop.runtime().balances());
  }
}

TEST_CASE("US-17 a ring that is too small says so once, and how far back it goes; it costs the oldest only") {
  TriggerBench bench({.when = "button.pressed", .before = 10s, .events = 20, .age = 1h});
  bench.run(20);
  CHECK(bench.errors.empty());
  bench.run(30);
  REQUIRE(bench.errors.size() == 1);
  CHECK(bench.errors[0] == "the ring is full with 20 events: they reach back 2 s, not 10 s");
  CHECK(bench.trigger.health() == Health::degraded);
  bench.press(true);
  CHECK(bench.values == numbers(31, 50));
  CHECK(bench.counts().filtered == 30);
  bench.press(false);
  bench.loop.advance(60s);
  bench.run(3);
  CHECK(bench.errors.size() == 1);
  CHECK(bench.loop.runtime().balances());
  // One that comes while the ring passes on its events is among them.
  TriggerBench small({.when = "value >= 10", .before = 10s, .events = 1});
  small.run(12);
  CHECK(small.values == numbers(10, 12));
}

TEST_CASE("a trigger that the handler of its report stops takes no further event, and starts with an empty ring") {
  TriggerBench bench({.when = "button.pressed", .before = 10s, .events = 5});
  bench.trigger.on_error([&](const ErrorReport&) { bench.trigger.stop(); });
  bench.button.publish({false});
  bench.run(6);  // the ring is full with the sixth
  CHECK_FALSE(bench.trigger.is_running());
  CHECK(bench.counts().filtered == bench.counts().received);
  bench.trigger.start();
  bench.press(true);
  CHECK(bench.values.empty());
  bench.run(1);
  CHECK(bench.values == numbers(7, 7));
  bench.loop.close(1s);
  CHECK(bench.loop.runtime().balances());
}

TEST_CASE("US-17 a condition without a value holds nothing open, and is told") {
  TriggerBench bench({.when = "button.pressed", .before = 1s, .age = 2s});
  bench.run(10);
  CHECK(bench.errors.empty());  // it may still come
  bench.run(15);
  REQUIRE(bench.errors.size() == 1);
  CHECK(bench.errors[0] == "`when` has no value: the topic \"button\" has had no event yet");
  CHECK(bench.trigger.health() == Health::degraded);
  bench.press(true);
  CHECK(bench.trigger.health() == Health::ok);
  CHECK(bench.values == numbers(15, 25));
  bench.run(30);  // 2 s after it was pressed
  CHECK(bench.values == numbers(15, 45));
  REQUIRE(bench.errors.size() == 2);
  CHECK(bench.errors[1].find("has had no event for more than 2 s") != std::string::npos);

  TriggerBench failing({.when = "1 / (value - 3) > 0", .before = 0s});
  failing.run(5);
  CHECK(failing.values == numbers(4, 5));
  REQUIRE(failing.errors.size() == 1);
  CHECK(failing.errors[0].find("`when` fails: division by zero") == 0);
  CHECK(failing.trigger.health() == Health::ok);

  TriggerBench unknown({.when = "thrust.valeu > 1", .before = 0s});
  unknown.run(5);
  REQUIRE(unknown.errors.size() == 1);
  CHECK(unknown.errors[0] == "`when` has no value: the topic \"thrust\" has no number `thrust.valeu`");
  CHECK(unknown.loop.runtime().balances());
}

TEST_CASE("US-17 making a trigger refuses what cannot work") {
  Loop loop{Loop::Manual{}};
  const Feed<Thrust> thrust(loop, {.name = "thrust"});
  const auto made = [&](TriggerConfig config, FeedConfig feed = {.name = "burn"}) {
    TriggerSensor(loop, std::move(feed), std::move(config));
  };
  CHECK_THROWS_WITH_AS(made({.on = "thurst", .when = "1"}), doctest::Contains("no topic \"thurst\" yet"), SetupError);
  CHECK_THROWS_WITH_AS(made({.on = "a b#", .when = "1"}), doctest::Contains("is not a topic"), SetupError);
  CHECK_THROWS_WITH_AS(made({.on = "thrust", .with = {"thrust"}, .when = "1"}), doctest::Contains("twice"), SetupError);
  CHECK_THROWS_WITH_AS(made({.on = "thrust", .when = "1", .events = 4'000'000'000}),
                       doctest::Contains("takes more memory than this machine has"), SetupError);
  CHECK_THROWS_AS(made({.on = "thrust", .when = "value >"}), ExpressionError);
  made({.on = "thrust", .when = "value > 1"});  // nothing is left behind
}

TEST_CASE("US-17 check finds the mistakes of a trigger, with their columns") {
  const auto problems = [](const std::string& trigger) {
    std::vector<std::string> lines;
    for (const Problem& problem :
         plan_system(standard_registry(),
                     parse_config(R"({"sensors": [{"name": "load", "type": "host", "quantity": "load", "rate": "10 Hz"},
 {"name": "kept", "type": "trigger", )" +
                                      trigger + "}]}",
                                  "f.json"))
             .problems)
      lines.push_back(problem.text());
    return lines;
  };
  const auto is_refused = [&](const std::string& trigger, const std::string& why) {
    const auto found = problems(trigger);
    for (const std::string& problem : found)
      if (found.size() != 1 || problem.find(why) == std::string::npos) MESSAGE(problem);
    return found.size() == 1 && found[0].find(why) != std::string::npos;
  };
  CHECK(problems(R"("on": "load", "when": "minutes_1 > 1", "before": "10 s")").empty());
  CHECK(is_refused(R"("on": "load")", "when"));
  CHECK(is_refused(R"("when": "minutes_1 > 1")", "on"));
  CHECK(is_refused(R"("on": "laod", "when": "1")", "did you mean \"load\"?"));
  CHECK(is_refused(R"("on": "load", "when": "minute_1 > 1")", "f.json:2"));
  CHECK(is_refused(R"("on": "load", "when": "minutes_1 >")", "f.json:2"));
  CHECK(is_refused(R"("on": "load", "with": ["load"], "when": "minutes_1 > 1")", "is listed twice"));
  CHECK(is_refused(R"("on": "load", "when": "minutes_1 > 1", "before": "2 d")", "before"));
  CHECK(is_refused(R"("on": "load", "when": "minutes_1 > 1", "events": 0)", "events"));
  CHECK(is_refused(
      R"("on": "load", "when": "minutes_1 > 1", "process": {"minutes_1": {"filters": [{"type": "throttle", "time": "1 s"}]}})",
      "set `process` of the sensor"));
  CHECK(is_refused(R"("on": "kept", "when": "1")", "kept"));

  // Its topic carries what that of `on` does: also what looks at it is checked.
  const std::string good = R"("on": "load", "when": "minutes_1 > 1"}, )";
  const auto beside = [&](const std::string& part) { return good + part.substr(0, part.size() - 1); };
  for (const std::string on : {"kept", "again"}) {
    CAPTURE(on);
    const std::string again = R"({"name": "again", "type": "trigger", "on": "kept", "when": "minutes_5 > 1"}, )";
    const std::string limit = R"({"name": "high", "type": "limit", "on": ")" + on + R"(", "high": 1, "field": )";
    const std::string half = R"({"name": "half", "type": "derived", "on": ")" + on + R"(", "expression": )";
    CHECK(problems(beside(again + limit + R"("minutes_1"})")).empty());
    CHECK(is_refused(beside(again + limit + R"("minute_1"})"), "did you mean \"minutes_1\"?"));
    CHECK(problems(beside(again + half + R"("minutes_15 / 2"})")).empty());
    CHECK(is_refused(beside(again + half + R"("minute_15 / 2"})"), "minute_15"));
  }
  CHECK(
      is_refused(beside(R"({"name": "again", "type": "trigger", "on": "kept", "when": "minute_5 > 1"})"), "minute_5"));
}

TEST_CASE("US-17 a reload leaves a trigger untouched, or makes it anew with an empty ring") {
  const Registry registry = standard_registry();
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  const auto plan = [&](const std::string& before, const std::string& rate) {
    return plan_system(registry, parse_config(R"({"sensors": [
        {"name": "load", "type": "host", "quantity": "load", "rate": "10 Hz"},
        {"name": "other", "type": "host", "quantity": "load", "rate": ")" +
                                                  rate + R"("},
        {"name": "kept", "type": "trigger", "on": "load", "with": ["work"], "when": "work.busy", "before": ")" +
                                                  before + R"("}],
      "machines": [{"name": "work", "start": "idle", "states": [{"name": "idle"}, {"name": "busy"}],
        "transitions": [{"from": "idle", "to": "busy", "event": "go"}, {"from": "busy", "to": "idle", "event": "stop"}]}]})",
                                              "f.json"));
  };
  System system(loop, registry, plan("1 h", "1 Hz"));
  const auto kept = [&] { return system.parts().get<AnySensor>("sensor", "kept").status().counts; };
  loop.advance(2050ms);
  CHECK(kept().received == 0);
  CHECK(system.apply(plan("1 h", "2 Hz")).refused() == 0);  // another sensor changes
  loop.advance(1s);
  system.parts().get<fsm::ConfiguredMachine>("machine", "work").raise("go").or_throw();
  loop.advance(1ms);
  CHECK(kept().published == 31);
  system.parts().get<fsm::ConfiguredMachine>("machine", "work").raise("stop").or_throw();
  loop.advance(1s);
  CHECK(kept().published == 31);
  CHECK(system.apply(plan("2 h", "2 Hz")).refused() == 0);
  loop.advance(1s);
  system.parts().get<fsm::ConfiguredMachine>("machine", "work").raise("go").or_throw();
  loop.advance(1ms);
  CHECK(kept().published == 41);
  CHECK(loop.runtime().balances());
}

TEST_CASE("a trigger knows an alarm that was raised before it began, and that holds however old it is") {
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  Feed<Thrust> thrust(loop, {.name = "thrust"});
  LimitSensor alarm(loop, {.name = "hot"}, {.on = "thrust", .field = "value", .high = 5, .silence = 0s});
  thrust.publish({10});
  loop.advance(1s);
  TriggerSensor trigger(loop, {.name = "burn"}, {.on = "thrust", .with = {"hot"}, .when = "hot.is_active"});
  int events = 0;
  const auto seen = loop.subscribe<Thrust>("burn", [&](const Event<Thrust>&) { ++events; });
  for (int i = 0; i < 3; ++i) {
    loop.advance(1min);
    thrust.publish({11});
    loop.advance(1ms);
  }
  CHECK(events == 3);
  CHECK(trigger.health() == Health::ok);
  CHECK(trigger.status().counts.lost_is_known);
}

TEST_SUITE_END();
