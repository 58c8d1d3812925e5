#include "rtdata/config/system.hpp"

#include <doctest/doctest.h>

#include <nlohmann/json.hpp>

#include "config/test_types.hpp"
#include "loop/run_until.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using test::Count;

namespace {

Registry registry() {
  Registry registry;
  test::add_test_types(registry);
  return registry;
}

SystemPlan planned(std::string_view text) { return plan_system(registry(), parse_config(text, "f.json")); }

std::string problems_of(std::string_view text) { return planned(text).problems.text(); }

ConfigItem item(std::string_view text) { return parse_config(text, "item.json").or_throw(); }

/// Of a type that is read on a lane.
struct SlowConfig {
  friend constexpr auto parameters(type_tag<SlowConfig>) { return parameter_list(); }
  friend ReadTime read_time(const SlowConfig&) { return {.on_loop = 10us, .on_lane = 8ms, .lane = "chip"}; }
};

/// Of a type of sink that needs a path.
struct KeptConfig {
  std::string path = {};
  SinkConfig sink = {};
  friend constexpr auto parameters(type_tag<KeptConfig>) {
    return parameter_list(parameter("path", &KeptConfig::path, "the file", required),
                          include_member(&KeptConfig::sink));
  }
};

constexpr const char* bench = R"({
  "name": "bench", "notes": "first run",
  "loop": {"hold_limit": "20 ms", "phase_grid": "0 s"},
  "sensors": [
    {"name": "a", "type": "tallied", "rate": "100 Hz", "topic": "count/a"},
    {"name": "b", "type": "tallied", "rate": "10 Hz", "topic": "count/b", "first": 100, "start": false},
    {"name": "c", "type": "fed", "topic": "count/c"}
  ],
  "sinks": [ {"type": "discard", "path": "x.out", "topics": ["count/#"], "queue_bytes": 1048576} ]
})";

/// What a System does, on virtual time.
struct Running {
  explicit Running(std::string_view text = bench) : plan(plan_system(types, parse_config(text, "f.json"))) {}
  Registry types = registry();
  SystemPlan plan;
  Loop loop{Loop::Manual{}, plan.loop_config()};
  System system{loop, types, plan};
  std::vector<std::uint64_t> seen_a, seen_b;
  Subscription on_a = loop.subscribe<Count>("count/a", [this](const Event<Count>& e) { seen_a.push_back(e->number); });
  Subscription on_b = loop.subscribe<Count>("count/b", [this](const Event<Count>& e) { seen_b.push_back(e->number); });
};

}  // namespace

TEST_SUITE("config") {
  TEST_CASE("US-17 a file becomes a running system") {
    Running run;
    CHECK(run.plan.warnings.empty());
    CHECK(run.plan.runtime_config().name == "bench");
    CHECK(run.plan.runtime_config().notes == "first run");
    CHECK(run.plan.runtime_config().configuration == bench);
    CHECK(run.loop.config().hold_limit == std::chrono::milliseconds{20});
    CHECK(run.system.sensor_names() == std::vector<std::string>{"a", "b", "c"});
    CHECK(run.system.sink_names() == std::vector<std::string>{"x.out"});
    run.loop.advance(95ms);
    CHECK(run.seen_a == std::vector<std::uint64_t>{1, 2, 3, 4, 5, 6, 7, 8, 9, 10});
    CHECK(run.seen_b.empty());
    run.loop.close();
    CHECK(run.loop.runtime().balances());
    CHECK(run.loop.runtime().sinks().at(0).counts.stored == 10);
  }

  TEST_CASE("US-9 a configured sensor starts and stops at any time") {
    Running run;
    CHECK_FALSE(run.system.sensor("b").is_running());
    run.system.sensor("b").start();
    run.loop.advance(250ms);
    CHECK(run.seen_b == std::vector<std::uint64_t>{100, 101, 102});
    run.system.sensor("b").stop();
    run.system.sensor("a").stop();
    const auto before = run.seen_a.size();
    run.loop.advance(1s);
    CHECK(run.seen_b.size() == 3);
    CHECK(run.seen_a.size() == before);
    run.system.sensor("b").start();
    run.loop.advance(50ms);
    CHECK(run.seen_b.size() == 4);
  }

  TEST_CASE("US-5 the rate of a configured sensor changes while it runs") {
    Running run;
    run.loop.advance(95ms);
    CHECK(run.seen_a.size() == 10);
    run.system.sensor("a").set_rate(1_kHz);
    run.loop.advance(99ms);
    CHECK(run.seen_a.size() == 110);
  }

  TEST_CASE("US-7 a sensor added to a running system starts at once") {
    Running run;
    run.loop.advance(1s);
    run.system.add_sensor(
        item(R"({"name": "d", "type": "tallied", "rate": "10 Hz", "topic": "count/b", "first": 500})"));
    CHECK(run.system.sensor("d").is_running());
    run.loop.advance(150ms);
    CHECK(run.seen_b == std::vector<std::uint64_t>{500, 501});
  }

  TEST_CASE("US-7 an added sensor with mistakes leaves the system as it was") {
    Running run;
    const auto message = [&](std::string_view text) -> std::string {
      try {
        run.system.add_sensor(item(text));
      } catch (const SetupError& error) {
        return error.what();
      }
      return "";
    };
    CHECK(message(R"({"name": "d", "type": "tallie", "rate": "10 Hz"})").find("\"tallied\"") != std::string::npos);
    CHECK(message(R"({"name": "a", "type": "tallied", "rate": "10 Hz", "topic": "count/a"})")
              .find("there is a sensor \"a\" already, at f.json:5:14") != std::string::npos);
    CHECK(message(R"({"name": "d", "type": "absent", "rate": "10 Hz", "topic": "count/a"})").find("\"level\"") !=
          std::string::npos);
    CHECK(message(R"({"name": "d", "type": "absent", "rate": "10 Hz", "required": true})").find("plug it in") !=
          std::string::npos);
    CHECK(run.system.sensor_names().size() == 3);
    run.loop.advance(95ms);
    CHECK(run.seen_a.size() == 10);
  }

  TEST_CASE("US-8 a removed sensor gives not one more event, and its name is free") {
    Running run;
    run.loop.advance(95ms);
    run.system.remove_sensor("a");
    run.loop.advance(1s);
    CHECK(run.seen_a.size() == 10);
    CHECK_THROWS_WITH_AS((void)run.system.sensor("a"), doctest::Contains("no such sensor"), SetupError);
    run.system.add_sensor(
        item(R"({"name": "a", "type": "tallied", "rate": "100 Hz", "topic": "count/a", "first": 70})"));
    run.loop.advance(5ms);
    CHECK(run.seen_a.back() == 70);
    run.loop.close();
    CHECK(run.loop.runtime().balances());
  }

  TEST_CASE("US-8 a sensor is removed from a handler of its own event") {
    Running run;
    const Subscription remover = run.loop.subscribe("count/a", [&](const EventView& e) {
      if (e.sequence() == 3) run.system.remove_sensor("a");
    });
    run.loop.advance(1s);
    CHECK(run.seen_a.size() == 3);
  }

  TEST_CASE("US-8 sinks are added and removed while the system runs") {
    Running run;
    run.loop.advance(95ms);
    run.system.add_sink(item(R"({"type": "discard", "name": "second", "topics": ["count/a"]})"));
    CHECK_THROWS_WITH_AS(run.system.add_sink(item(R"({"type": "discard", "name": "second"})")),
                         doctest::Contains("already"), ConfigError);
    run.loop.advance(100ms);
    CHECK(run.system.sink("second").counts().offered == 10);
    run.system.remove_sink("second");
    CHECK(run.system.sink_names() == std::vector<std::string>{"x.out"});
    run.loop.close();
    CHECK(run.loop.runtime().balances());
  }

  TEST_CASE("US-17 every mistake of a file is told at once, in its order") {
    const std::string text = problems_of(R"({
  "nam": "bench",
  "log": {"levle": "info", "file": 3},
  "sensors": [
    {"name": "a", "type": "tallied", "rtae": "100 Hz"},
    {"name": "b", "type": "tallie", "rate": "1 Hz"},
    {"name": "c", "type": "tallied", "rate": "100"},
    {"name": "d", "type": "tallied", "rate": "1 Hz", "first": -1},
    {"name": "e e", "type": "tallied", "rate": "1 Hz"},
    {"name": "f", "type": "tallied", "rate": "1 Hz", "topic": "a//b"},
    {"name": "g", "type": "tallied", "rate": "1 Hz", "topic": "$rtdata/x"}
  ],
  "sinks": [
    {"type": "discard", "topics": ["a/#/b", "x y"]},
    {"type": "discard", "queue_bytes": 3},
    {"type": "discard", "when_full": "drop"}
  ]
})");
    std::string places;
    for (std::size_t begin = 0, end; (end = text.find('\n', begin)) != std::string::npos; begin = end + 1) {
      const std::string line = text.substr(begin, end - begin);
      places += line.substr(0, line.find(": ", line.find(": ") + 2)) + "\n";
    }
    CHECK_MESSAGE(places == R"(f.json:2:3: nam
f.json:3:11: log.levle
f.json:3:36: log.file
f.json:5:38: sensors[0].rtae
f.json:6:27: sensors[1].type
f.json:7:46: sensors[2].rate
f.json:8:63: sensors[3].first
f.json:9:14: sensors[4].name
f.json:10:63: sensors[5].topic
f.json:11:63: sensors[6].topic
f.json:14:36: sinks[0].topics[0]
f.json:14:45: sinks[0].topics[1]
f.json:15:40: sinks[1].queue_bytes
f.json:16:38: sinks[2].when_full
)",
                  text);
    CHECK(text.find("(did you mean \"name\"?)") != std::string::npos);
    CHECK(text.find("(did you mean \"rate\"?)") != std::string::npos);
    CHECK(text.find("(did you mean \"tallied\"?)") != std::string::npos);
  }

  TEST_CASE("US-17 names used twice are told with both places") {
    const std::string text = problems_of(R"({"sensors": [
  {"name": "a", "type": "tallied", "rate": "1 Hz"},
  {"name": "a", "type": "tallied", "rate": "1 Hz", "topic": "b"}],
 "sinks": [
  {"type": "discard", "path": "out"},
  {"type": "discard", "path": "./out"},
  {"type": "discard"}, {"type": "discard"}]})");
    CHECK(text ==
          "f.json:3:12: sensors[1].name: there is a sensor \"a\" already, at f.json:2:12; give each a `name` of its "
          "own [duplicate-name]\n"
          "f.json:6:31: sinks[1].path: the sink at f.json:5:3 writes \"out\" already; two writers on one file destroy "
          "it; choose another [duplicate-path]\n"
          "f.json:7:24: sinks[3]: there is a sink \"discard\" already, at f.json:7:3; give each a `name` of its own "
          "[duplicate-name]\n");
  }

  TEST_CASE("US-17 what is wrong between items is told though one of them has a mistake of its own") {
    const std::string text = problems_of(R"({"sensors": [
  {"name": "a", "type": "tallied", "rate": "2 MHz", "tier": "fast"},
  {"name": "a", "type": "tallied", "rate": "1 Hz"},
  {"name": "A", "type": "tallied", "rate": "1 Hz"},
  {"name": "b", "type": "tallied", "rate": "1 Hz", "topic": "x"},
  {"name": "c", "type": "tallie", "rate": "1 Hz", "topic": "x"},
  {"name": "d", "type": "absent", "rate": "1 Hz", "topic": "x"}],
 "sinks": [
  {"type": "discard", "path": "out", "queue_bytes": 3},
  {"type": "discard", "path": "out"},
  {"type": "discard", "name": "s", "when_full": "drop"},
  {"type": "discard", "name": "s"}]})");
    for (const char* part : {
             "f.json:2:44: sensors[0].rate: 2 MHz is out of range",
             "f.json:2:61: sensors[0].tier: there is no tier \"fast\"",
             "f.json:3:12: sensors[1].name: there is a sensor \"a\" already, at f.json:2:12",
             "f.json:4:12: sensors[2].name: the topic \"A\" differs in case only from \"a\", at f.json:2:12",
             "f.json:6:25: sensors[4].type: there is no sensor type \"tallie\"",
             "f.json:7:60: sensors[5].topic: the topic \"x\" carries \"count\" of sensor b, at f.json:5:61",
             "f.json:9:53: sinks[0].queue_bytes: 3 By is out of range",
             "f.json:10:31: sinks[1].path: the sink at f.json:9:3 writes \"out\" already",
             "f.json:11:49: sinks[2].when_full: expected one of",
             "f.json:12:31: sinks[3].name: there is a sink \"s\" already, at f.json:11:31",
         })
      CHECK_MESSAGE(text.find(part) != std::string::npos, part);
    CHECK(std::count(text.begin(), text.end(), '\n') == 10);
  }

  TEST_CASE("US-17 a topic that an item with mistakes shares is compared among the others") {
    CHECK(problems_of(R"({"sensors": [
  {"name": "a", "type": "tallie", "rate": "1 Hz", "topic": "x"},
  {"name": "b", "type": "tallied", "rate": "1 Hz", "topic": "x"},
  {"name": "c", "type": "absent", "rate": "1 Hz", "topic": "x"}]})")
              .find("f.json:4:60: sensors[2].topic: the topic \"x\" carries \"count\" of sensor b, at f.json:3:61") !=
          std::string::npos);
  }

  TEST_CASE("US-17 a sink that must have a path is refused with an empty one, on its own and when added") {
    const char* const text = R"({"type": "kept", "path": "", "queue_bytes": 3})";
    Registry types = registry();
    types.add_sink<KeptConfig>(
        "kept", "needs a path", [](const KeptConfig& config) { return config.path; },
        [](Loop& loop, const KeptConfig& config) {
          return Sink(loop, config.sink, std::make_unique<test::Discard>(test::DiscardConfig{}));
        });
    const std::string document = R"({"sensors": [], "sinks": [)" + std::string(text) + "]}";
    const std::string told = plan_system(types, parse_config(document, "f.json")).problems.text();
    CHECK(told.find("f.json:1:52: sinks[0].path: it is empty, and must not be [bad-value]\n") != std::string::npos);
    CHECK(told.find("sinks[0].queue_bytes") != std::string::npos);
    Loop loop{Loop::Manual{}};
    System system(loop, types, parse_config("{}", "f.json"));
    CHECK_THROWS_WITH_AS(system.add_sink(item(R"({"type": "kept", "path": ""})")), doctest::Contains("it is empty"),
                         ConfigError);
    CHECK(problems_of(R"({"sinks": [{"type": "discard", "path": ""}]})") == "");  // it may do without
  }

  TEST_CASE("US-17 two payloads on one topic are told with both places before anything starts") {
    const std::string text = problems_of(R"({"sensors": [
  {"name": "a", "type": "tallied", "rate": "1 Hz", "topic": "x"},
  {"name": "b", "type": "absent", "rate": "1 Hz", "topic": "x"},
  {"name": "c", "type": "tallied", "rate": "1 Hz", "topic": "X"},
  {"name": "d", "type": "fed", "topic": "x"}]})");
    CHECK(text.starts_with(
        "f.json:3:60: sensors[1].topic: the topic \"x\" carries \"count\" of sensor a, at f.json:2:61, and "
        "\"level\" of this one; "));
    CHECK(text.find("f.json:4:61: sensors[2].topic: the topic \"X\" differs in case only from \"x\", at f.json:2:61 "
                    "[bad-name]\n") != std::string::npos);
    CHECK(text.find("sensors[3]") == std::string::npos);  // the same payload may share a topic
  }

  TEST_CASE("US-33 tiers are made from a file, with sensors on them") {
    Loop loop;
    const SystemPlan plan = planned(
        R"({"tiers": {"fast": {"policy": "fifo", "priority": 10, "cpu": 0, "spin": "50 us"}, "slow": {}},
      "sensors": [{"name": "a", "type": "tallied", "rate": "500 Hz", "tier": "fast"},
                  {"name": "b", "type": "tallied", "rate": "100 Hz", "tier": "slow"},
                  {"name": "c", "type": "tallied", "rate": "100 Hz"}],
      "sinks": [{"type": "discard"}]})");
    CHECK(plan.problems.text() == "");
    CHECK(plan.warnings.text() == "");
    System system(loop, registry(), plan);
    CHECK(system.tier("fast").config().policy == SchedulingPolicy::fifo);
    CHECK(system.tier("fast").config().cpus == std::vector<int>{0});
    CHECK(system.tier("fast").config().spin == 50us);
    CHECK_THROWS_AS(system.tier("fats"), SetupError);
    std::map<std::string, std::uint64_t> seen;
    auto subscription = loop.subscribe("#", [&](const EventView& event) { ++seen[std::string(event.origin())]; });
    CHECK(run_until(loop, [&] { return seen.size() == 3; }));
    CHECK(system.sensor("a").is_running());
    system.sensor("a").set_rate(100_Hz);
    CHECK(system.sensor("a").rate() == 100_Hz);
    CHECK_THROWS_AS(system.sensor("a").set_rate({}), SetupError);
    system.sensor("b").stop();
    const std::uint64_t taken = system.sensor("b").counts().taken;
    loop.run_for(50ms);
    CHECK(system.sensor("b").counts().taken == taken);
    system.remove_sensor("a");
    loop.close();
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("US-33 mistakes of tiers are told with their places") {
    CHECK(
        problems_of(R"({"tiers": {"fast": {"policy": "fifo"}, "slow": {"priority": 3}, "odd": {"cpu": 1, "cpus": [0]},
 "wrong": {"policy": "realtime"}},
 "sensors": [{"name": "a", "type": "tallied", "rate": "1 Hz", "tier": "fsat"}]})") ==
        "f.json:1:31: tiers.fast.policy: policy \"fifo\" needs a `priority` from 1 to 99 [bad-value]\n"
        "f.json:1:61: tiers.slow.priority: only the policies \"fifo\" and \"rr\" have a priority [bad-value]\n"
        "f.json:1:80: tiers.odd.cpu: give `cpu` or `cpus`, not both [bad-value]\n"
        "f.json:2:22: tiers.wrong.policy: expected one of other, fifo, rr, got the string \"realtime\" "
        "[unknown-choice]\n"
        "f.json:3:71: sensors[0].tier: there is no tier \"fsat\" in `tiers` (did you mean \"fast\"?) [unknown-tier]\n");
    CHECK(
        problems_of(R"({"tiers": {"main": {}, "": {"polcy": "fifo"}, "a\nb": {}, "good": {}},
 "sensors": [{"name": "a", "type": "tallied", "rate": "1 Hz", "tier": "c\nd"}]})") ==
        "f.json:1:12: tiers.main: the main loop has that name; give the tier another [bad-name]\n"
        "f.json:1:24: tiers[\"\"]: a name has 1 to 200 characters of UTF-8 and no control characters [bad-name]\n"
        "f.json:1:29: tiers[\"\"].polcy: unknown key (did you mean \"policy\"?) [unknown-key]\n"
        "f.json:1:47: tiers[\"a\\nb\"]: a name has 1 to 200 characters of UTF-8 and no control characters [bad-name]\n"
        "f.json:2:71: sensors[0].tier: there is no tier \"c\\nd\" in `tiers` [unknown-tier]\n");
    CHECK(
        planned(
            R"({"tiers": {"idle": {}}, "sensors": [{"name": "a", "type": "tallied", "rate": "1 Hz"}], "sinks": [{"type": "discard"}]})")
            .warnings.text() == "f.json:1:20: tiers.idle: no sensor runs on tier \"idle\" [unused-tier]\n");
  }

  TEST_CASE(
      "NFR-4 the load of each loop is known from the file, and too much of it is a warning at the sensor that takes "
      "most") {
    const SystemPlan good = planned(R"({"tiers": {"fast": {}, "idle": {}}, "sensors": [
 {"name": "a", "type": "tallied", "rate": "500 Hz", "tier": "fast", "read_time": "1.4 ms"},
 {"name": "b", "type": "tallied", "rate": "500 Hz", "tier": "fast", "hold": "100 us"},
 {"name": "c", "type": "tallied", "rate": "1 Hz", "tier": "fast"},
 {"name": "d", "type": "tallied", "rate": "100 Hz", "hold": "5 ms"},
 {"name": "e", "type": "fed"}], "sinks": [{"type": "discard"}]})");
    REQUIRE(good.loads().size() == 2);
    CHECK(good.loads()[0].text() == "main: 1 sensor, worst 5 ms of 10 ms, 50 %");
    CHECK(good.loads()[1].text() == "fast: 3 sensors, worst 1.5 ms of 2 ms, 75 % (2 of 3 declared)");
    CHECK(good.warnings.size() == 1);  // of the idle tier

    const SystemPlan bad = planned(R"({"tiers": {"fast": {}}, "sensors": [
 {"name": "a", "type": "tallied", "rate": "500 Hz", "tier": "fast", "hold": "200 us"},
 {"name": "b", "type": "tallied", "rate": "500 Hz", "tier": "fast", "hold": "1.6 ms"},
 {"name": "d", "type": "tallied", "rate": "100 Hz", "phase": "5 ms", "read_time": "5 ms"},
 {"name": "e", "type": "tallied", "rate": "100 Hz", "read_time": "4 ms"}], "sinks": [{"type": "discard"}]})");
    CHECK(bad.good());
    REQUIRE(bad.warnings.size() == 2);
    const std::string warnings = bad.warnings.text();
    CHECK(
        warnings.find("f.json:3:43: sensors[1].rate: the readings of tier \"fast\" take too much of its time (fast: 2 "
                      "sensors, worst 1.8 ms "
                      "of 2 ms, 90 %), this one most; lower the rates") != std::string::npos);
    CHECK(
        warnings.find("f.json:4:43: sensors[2].rate: the readings of the main loop take too much of its time (main: 2 "
                      "sensors, worst 9 ms "
                      "of 10 ms, 90 %)") != std::string::npos);
    CHECK(bad.warnings.begin()->id == "overloaded-loop");

    CHECK(problems_of(R"({"sensors": [{"name": "a", "type": "tallied", "rate": "1 Hz", "read_time": "0 s"}]})") != "");
    CHECK(problems_of(R"({"sensors": [{"name": "a", "type": "tallied", "rate": "1 Hz", "read_time": 3}]})") != "");
  }

  TEST_CASE("NFR-4 a device whose lane cannot be as fast as its sensors is a warning") {
    Registry types = registry();
    types.add_sensor<SlowConfig>(
        "slow", "is read on a lane", [](const SlowConfig&) { return description_of<Count>(); },
        [](Loop& loop, const SensorConfig& common, const SlowConfig&) {
          return Sensor<Count>(loop, common, [] { return Count{1}; });
        });
    const SystemPlan plan = plan_system(types, parse_config(R"({"sensors": [
 {"name": "a", "type": "slow", "rate": "50 Hz"},
 {"name": "b", "type": "slow", "rate": "100 Hz", "read_time": "5 ms"}], "sinks": [{"type": "discard"}]})",
                                                            "f.json"));
    REQUIRE(plan.warnings.size() == 1);
    CHECK(plan.warnings.begin()->id == "overloaded-lane");
    CHECK(plan.warnings.begin()->text().find(
              "f.json:3:40: sensors[1].rate: a device cannot be read this often (lane chip: 2 sensors, 90 %)") == 0);
    CHECK(plan.loads()[0].worst == 15us);  // they come back at different times
  }

  TEST_CASE("US-17 what is probably not meant is a warning") {
    CHECK(planned(R"({"sensors": [{"name": "pressure", "type": "tallied", "rate": "1 Hz"}],
  "sinks": [{"type": "discard", "topics": ["presure", "pressure"]}]})")
              .warnings.text() ==
          "f.json:2:44: sinks[0].topics[0]: no sensor of this file publishes on \"presure\" (did you mean "
          "\"pressure\"?) [matches-nothing]\n");
    // All that a sink takes is mistyped: nothing would be kept.
    CHECK(planned(R"({"sensors": [{"name": "pressure", "type": "tallied", "rate": "1 Hz"}],
  "sinks": [{"type": "discard", "topics": ["presure"]}]})")
              .warnings.text() ==
          "f.json:2:44: sinks[0].topics[0]: no sensor of this file publishes on \"presure\", and nothing goes to this "
          "sink (did you mean \"pressure\"?) [matches-nothing]\n");
    const SystemPlan empty = planned(R"({"sensors": []})");
    CHECK(empty.good());
    CHECK(empty.warnings.text() ==
          "f.json:1:13: sensors: there are no sensors: nothing will be recorded [no-sensors]\n");
    CHECK(planned("{}").warnings.size() == 1);
  }

  TEST_CASE("US-17 what is no object, or no file, is told") {
    CHECK(problems_of("[]") != "");
    CHECK(problems_of("3") != "");
    CHECK(problems_of("null") != "");
    CHECK(problems_of("") != "");
    CHECK(problems_of(R"({"sensors": {}, "sinks": 3})").find("sinks") != std::string::npos);
    CHECK(problems_of(R"({"sensors": [3]})").find("sensors[0]") != std::string::npos);
    CHECK_FALSE(plan_system(registry(), load_config("/nonexistent/f.json")).good());
  }

  TEST_CASE("US-17 a plan with problems makes nothing") {
    const Registry types = registry();
    Loop loop{Loop::Manual{}};
    CHECK_THROWS_AS(System(loop, types, planned(R"({"sensors": [{"name": "a", "type": "tallied"}]})")), ConfigError);
    CHECK(loop.runtime().sensors().empty());
  }

  TEST_CASE("US-17 an error of making a sensor says where it is configured, and leaves nothing behind") {
    const Registry types = registry();
    Loop loop{Loop::Manual{}};
    const SystemPlan plan = planned(R"({"sensors": [{"name": "a", "type": "tallied", "rate": "1 Hz"},
  {"name": "b", "type": "absent", "rate": "1 Hz", "required": true}], "sinks": [{"type": "discard"}]})");
    CHECK_THROWS_WITH_AS(
        System(loop, types, plan),
        "cannot open the device: f.json:2:3: sensor b: /dev/absent: No such file or directory: plug it in [not-found]",
        SetupError);
    CHECK(loop.runtime().sensors().empty());
  }

  TEST_CASE("US-17 a name with control characters is refused, whatever it is the name of") {
    // An escape sequence, and the single character that begins one, too.
    for (const std::string bad : {R"(a\u001b[31mb)", R"(a\u009b31mb)", R"(a\nb)", R"(a\u007f)"}) {
      CAPTURE(bad);
      const std::string sensor = R"({"name": "a", "type": "tallied", "rate": "1 Hz"})";
      const auto refuses = [&](const std::string& text, const char* at) {
        CAPTURE(text);
        const std::string told = problems_of(text);
        CHECK(told.find(at) != std::string::npos);
        CHECK(told.find("control characters") != std::string::npos);
        CHECK(told.find('\x1b') == std::string::npos);
      };
      refuses(R"({"name": ")" + bad + R"(", "sensors": [)" + sensor + "]}", "name");
      refuses(R"({"sensors": [{"name": ")" + bad + R"(", "type": "tallied", "rate": "1 Hz"}]})", "sensors[0].name");
      refuses(R"({"sensors": [)" + sensor + R"(], "sinks": [{"type": "discard", "name": ")" + bad + "\"}]}",
              "sinks[0].name");
      refuses(R"({"buses": {")" + bad + R"(": {"type": "loopback"}}, "sensors": [)" + sensor + "]}", "buses");
      refuses(R"({"tiers": {")" + bad + R"(": {}}, "sensors": [)" + sensor + "]}", "tiers");
    }
  }

  TEST_CASE("US-22 the schema covers the whole document") {
    const auto schema = nlohmann::json::parse(registry().schema());
    CHECK(schema["properties"]["log"]["properties"].contains("level"));
    CHECK(schema["properties"]["sensors"]["items"]["properties"]["type"]["enum"] ==
          nlohmann::json{"tallied", "absent", "fed", "wired"});
    CHECK(schema["properties"]["sinks"]["items"]["allOf"][0]["then"]["properties"].contains("queue_bytes"));
    CHECK_FALSE(schema["properties"]["sensors"]["items"]["allOf"][2]["then"]["properties"].contains("rate"));
    CHECK(schema["additionalProperties"] == false);
  }
}
