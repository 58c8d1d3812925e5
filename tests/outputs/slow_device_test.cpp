// Outputs whose devices are slow, while the loop turns: in reloads and at their end, in virtual time.
#include <doctest/doctest.h>

#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "fsm/configured.hpp"
#include "outputs/memory_actuator.hpp"
#include "outputs/output_log.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/change.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/process/expression.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace std::chrono_literals;
using outputs_test::Device;
using outputs_test::DeviceConfig;
using outputs_test::OutputLog;

namespace {

using Lines = std::vector<std::string>;
constexpr Duration slow = 1500ms;

struct Number {
  double value = 0;
  RTDATA_FIELDS(Number, (value))
};
struct NumberConfig {
  bool breaks = false;
  friend constexpr auto parameters(type_tag<NumberConfig>) {
    return parameter_list(parameter("breaks", &NumberConfig::breaks, "it cannot be made"));
  }
};

/// A system with a sensor that is read each 10 ms, and outputs a and b with the devices A and B, each of which takes
/// `slow` for whatever it is told.
struct Bench {
  std::map<std::string, Device> devices;
  Registry registry = standard_registry();
  Loop loop{Loop::Manual{}};
  OutputLog log{loop, "b"};
  std::optional<System> system;

  explicit Bench(const std::string& parts) {
    be_quiet(loop);
    registry.add_sensor<NumberConfig>(
        "number", "a number", [](const NumberConfig&) { return Result(description_of<Number>()); },
        [](Loop& its_loop, const SensorConfig& common, const NumberConfig& config) {
          if (config.breaks) throw SetupError({Errc::io_failed, "cannot make it", "the device", "it breaks", ""});
          return Sensor<Number>(its_loop, common, [] { return Number{1}; });
        });
    registry.add_output<DeviceConfig>(
        "memory", "a device of memory", [this](const DeviceConfig& config) { return devices[config.device].make()(); },
        [](PartPlan& part, const DeviceConfig& config) {
          part.place = {"memory", "device " + config.device, ""};
        });
    system.emplace(loop, registry, planned(parts));
    loop.advance(0ms);
    loop.script_lane_duration(slow);
  }
  static std::string output(const std::string& name, const std::string& device, const std::string& more = "") {
    return R"({"name": ")" + name + R"(", "type": "memory", "device": ")" + device + "\"" + more + "}";
  }
  static std::string outputs(const std::string& all) { return "\"outputs\": [" + all + "]"; }
  SystemPlan planned(const std::string& parts, const std::string& sensors = "") const {
    SystemPlan plan = plan_system(
        registry, parse_config(R"({"sensors": [{"name": "s", "type": "number", "rate": "100 Hz"})" + sensors + "], " +
                                   parts + "}",
                               "f.json"));
    REQUIRE_MESSAGE(plan.good(), plan.report());
    return plan;
  }
  /// With turns of the loop in between, in steps of 5 ms; returns how much virtual time that took.
  Duration apply(const SystemPlan& next, const std::function<void(Duration)>& meanwhile = {}) {
    StepwiseChange change(*system, next);
    const MonotonicTime began = loop.now();
    while (change.step(2ms)) {
      loop.advance(change.is_waiting() ? 5ms : 0ns);
      if (meanwhile) meanwhile(loop.now() - began);
    }
    CHECK(change.is_applied());
    return loop.now() - began;
  }
  Output& output(const std::string& name) const { return system->parts().get<Output>("output", name); }
  /// Takes the time of its device.
  void set(const std::string& name, double value) {
    output(name).set(value, "operator").or_throw();
    loop.advance(slow);
    CHECK(output(name).value() == value);
  }
  Lines did(const std::string& device) { return std::exchange(devices[device].did, {}); }
  /// The sensor was read each 10 ms since it was made, and none of that was missed.
  bool has_all_ticks() {
    const auto counts = system->sensor("s").status().counts;
    const auto due = static_cast<std::uint64_t>((loop.now() - began_) / 10ms) + 1;
    CHECK(counts.missed == 0);
    CHECK(counts.taken == due);
    return counts.missed == 0 && counts.taken == due;
  }
  const MonotonicTime began_ = loop.now();
};

}  // namespace

TEST_SUITE("outputs") {
  TEST_CASE(
      "US-35 US-5 a reload that removes a slow output gives its device back while the sensors of its loop go on") {
    Bench bench(Bench::outputs(Bench::output("a", "A") + "," + Bench::output("b", "B")));
    bench.set("b", 1);
    CHECK(bench.did("B") == Lines{"open 0", "set 1"});
    std::optional<Result<void>> refused;
    const Duration took = bench.apply(bench.planned(Bench::outputs(Bench::output("a", "A"))), [&](Duration since) {
      if (since < 1s || refused) return;
      refused = bench.output("b").set(2, "operator");
      CHECK(bench.output("b").arm("operator").error().code == Errc::busy);
    });
    CHECK(took == slow);
    CHECK(bench.system->parts().find<Output>("output", "b") == nullptr);
    CHECK(bench.did("B") == Lines{"set 0", "gone"});
    CHECK(bench.did("A") == Lines{"open 0"});  // it was not touched
    REQUIRE(refused);
    CHECK(refused->error().code == Errc::busy);
    CHECK(bench.log.lines ==
          Lines{"start 0 done", "set 1 done", "set 2 failed: its device is being released", "stop 0 done"});
    CHECK(bench.has_all_ticks());
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE(
      "US-35 US-5 a slow output that a reload changes is safe before its device is taken again, also by another") {
    Bench bench(Bench::outputs(Bench::output("a", "A") + "," + Bench::output("b", "B")));
    bench.set("a", 1);
    bench.set("b", 1);
    bench.did("A");
    bench.did("B");
    // `a` is made anew; `c` has the device of `b`.
    const Duration took = bench.apply(bench.planned(
        Bench::outputs(Bench::output("a", "A", R"(, "watchdog": "1 s")") + "," + Bench::output("c", "B"))));
    CHECK(took == 2 * slow);  // both devices are given back at once, and then taken at once
    CHECK(bench.did("A") == Lines{"set 0", "gone", "open 0"});
    CHECK(bench.did("B") == Lines{"set 0", "gone", "open 0"});
    CHECK(bench.output("a").value() == 0);
    CHECK(bench.output("c").value() == 0);
    bench.set("c", 1);
    CHECK(bench.has_all_ticks());
    CHECK(bench.loop.runtime().balances());
  }

  TEST_CASE("US-35 US-5 a value that is on its way to a slow output when a reload ends it comes before the safe one") {
    Bench bench(Bench::outputs(Bench::output("b", "B")));
    bench.output("b").set(1, "operator").or_throw();
    bench.output("b").set(2, "operator").or_throw();
    bench.loop.advance(1s);
    CHECK(bench.apply(bench.planned(Bench::outputs(""))) == 2 * slow - 1s);
    CHECK(bench.did("B") == Lines{"open 0", "set 1", "set 0", "gone"});
    CHECK(bench.log.lines == Lines{"start 0 done", "set 1 failed: the output is being closed",
                                   "set 2 failed: the output is being closed", "stop 0 done"});
    CHECK(bench.has_all_ticks());
  }

  TEST_CASE("US-35 US-5 a reload that fails after slow devices were given back brings their outputs back") {
    Bench bench(Bench::outputs(Bench::output("b", "B")));
    bench.set("b", 1);
    bench.did("B");
    const SystemPlan broken = bench.planned(Bench::outputs(Bench::output("b", "B", R"(, "watchdog": "1 s")")),
                                            R"(, {"name": "t", "type": "number", "rate": "1 Hz", "breaks": true})");
    const MonotonicTime began = bench.loop.now();
    CHECK_THROWS_WITH_AS(bench.apply(broken), doctest::Contains("it breaks"), SetupError);
    CHECK(bench.loop.now() - began == 2 * slow);  // the loop turns while it is taken again, too
    CHECK(bench.did("B") == Lines{"set 0", "gone", "open 0"});
    CHECK(bench.output("b").is_armed());
    bench.set("b", 1);
    // A device that has gone meanwhile is as one that is absent at the start: it is tried again.
    CHECK_THROWS_WITH_AS(
        bench.apply(broken, [&](Duration) { bench.devices["B"].fails = bench.devices["B"].did.back() == "gone"; }),
        doctest::Contains("but not output b ("), SetupError);
    CHECK(bench.output("b").health() == Health::faulted);
    bench.devices["B"].fails = false;
    bench.loop.advance(1s + slow);
    CHECK(bench.output("b").health() == Health::ok);
    bench.set("b", 1);
    CHECK(bench.has_all_ticks());
  }

  TEST_CASE("US-35 what ends in the middle of a reload leaves the device of a slow output safe, once") {
    for (const Duration after : {Duration{0}, Duration{1s}}) {
      CAPTURE(after);
      Bench bench(Bench::outputs(Bench::output("b", "B")));
      bench.set("b", 1);
      bench.did("B");
      const SystemPlan next = bench.planned(Bench::outputs(""));
      {
        StepwiseChange change(*bench.system, next);
        for (int i = 0; i < 3; ++i) CHECK(change.step(2ms));
        CHECK(change.is_waiting());
        bench.loop.advance(after);
      }
      bench.system.reset();
      CHECK(bench.did("B") == Lines{"set 0", "gone"});
      bench.loop.advance(10s);
      CHECK(bench.did("B").empty());
      CHECK(bench.log.lines == Lines{"start 0 done", "set 1 done"});  // of what was closed no event comes later
    }
  }

  TEST_CASE("US-35 US-41 what a machine has set holds over a reload with slow devices, while its lease lasts") {
    const auto parts = [](const std::string& more) {
      return Bench::outputs(Bench::output("igniter", "I", R"(, "lease": "1 s")" + more) + "," +
                            Bench::output("b", "B", more)) +
             R"(, "machines": [{"name": "m", "start": "pad", "states": [{"name": "pad"},
          {"name": "fire", "set": [{"output": "igniter"}, {"output": "b", "value": 2}]},
          {"name": "coast", "final": true, "set": [{"output": "b", "value": 3}]}],
          "transitions": [{"from": "pad", "to": "fire", "event": "go"}, {"from": "fire", "to": "coast", "event": "on"}]}])";
    };
    Bench bench(parts(""));
    bench.loop.script_lane_duration(0ms);
    bench.system->parts().get<fsm::ConfiguredMachine>("machine", "m").raise("go").or_throw();
    bench.loop.advance(10ms);
    CHECK(bench.did("I") == Lines{"open 0", "set 1"});
    CHECK(bench.did("B") == Lines{"open 0", "set 2"});
    bench.loop.script_lane_duration(slow);
    CHECK(bench.apply(bench.planned(parts(R"(, "watchdog": "1 s")"))) == 2 * slow);
    bench.loop.advance(slow);
    // The igniter's lease was over before there was another in its place.
    CHECK(bench.did("I") == Lines{"set 0", "gone", "open 0"});
    CHECK(bench.did("B") == Lines{"set 0", "gone", "open 0", "set 2"});
    CHECK(bench.has_all_ticks());
  }

  TEST_CASE("US-35 US-5 a slow output that a reload adds is taken while the sensors go on; what it is set to waits") {
    for (const bool closes_something : {false, true}) {
      CAPTURE(closes_something);
      Bench bench(Bench::outputs(Bench::output("a", "A") + (closes_something ? "," + Bench::output("c", "C") : "")));
      bool is_set = false, is_slow = false;
      const Duration took = bench.apply(
          bench.planned(Bench::outputs(Bench::output("a", "A") + "," + Bench::output("b", "B"))), [&](Duration since) {
            Output* const b = bench.system->parts().find<Output>("output", "b");
            if (b == nullptr) return;
            CHECK_FALSE(b->is_safe());
            is_slow = is_slow || b->health() == Health::degraded;
            if (is_set) return;
            is_set = true;
            CHECK(b->set(1, "operator").has_value());
            CHECK(b->set(2, "operator").has_value());
            CHECK(since == (closes_something ? slow : 0s) + 5ms);
          });
      CHECK(took == (closes_something ? 2 * slow : slow));
      CHECK(is_set);
      CHECK(is_slow);
      bench.loop.advance(slow);
      CHECK(bench.did("B") == Lines{"open 0", "set 2"});
      CHECK(bench.output("b").value() == 2);
      CHECK(bench.output("b").health() == Health::ok);
      CHECK(bench.log.lines ==
            Lines{"set 1 failed: replaced by a newer value before the device was ready", "start 0 done", "set 2 done"});
      CHECK(bench.did("A") == Lines{"open 0"});
      CHECK(bench.has_all_ticks());
      CHECK(bench.loop.runtime().balances());
    }
  }

  TEST_CASE(
      "US-35 US-5 a slow device that a reload cannot take brings back what was before, and says where it stands") {
    for (const bool closes_something : {false, true}) {
      CAPTURE(closes_something);
      const std::string before = Bench::output("a", "A") + (closes_something ? "," + Bench::output("c", "C") : "");
      Bench bench(Bench::outputs(before));
      bench.devices["B"].fails = true;
      const SystemPlan next = bench.planned(Bench::outputs(Bench::output("a", "A") + ",\n" + Bench::output("b", "B")));
      CHECK_THROWS_WITH_AS(bench.apply(next), doctest::Contains("f.json:2:1: output b"), SetupError);
      CHECK_THROWS_WITH_AS(bench.apply(next), doctest::Contains("it is broken"), SetupError);
      CHECK(bench.system->parts().find<Output>("output", "b") == nullptr);
      CHECK(bench.did("A") == Lines{"open 0"});
      if (closes_something)
        CHECK(bench.did("C") == Lines{"open 0", "set 0", "gone", "open 0", "set 0", "gone", "open 0"});
      bench.devices["B"].fails = false;
      bench.apply(next);
      CHECK(bench.output("b").value() == 0);
      CHECK(bench.has_all_ticks());
    }
  }

  TEST_CASE("US-35 all outputs are set safe at once, while the loop turns") {
    Bench bench(Bench::outputs(Bench::output("a", "A") + "," + Bench::output("b", "B")));
    bench.output("a").set(1, "operator").or_throw();
    bench.output("b").set(1, "operator").or_throw();
    bench.loop.advance(slow);
    bench.loop.script_lane_duration(4s);
    std::optional<MonotonicTime> ended;
    const MonotonicTime began = bench.loop.now();
    bench.system->finish_outputs([&] { ended = bench.loop.now(); });
    CHECK_FALSE(ended);
    bench.loop.advance(10s);
    REQUIRE(ended);
    CHECK(*ended - began == 4s);
    CHECK(bench.did("A") == Lines{"open 0", "set 1", "set 0", "gone"});
    CHECK(bench.did("B") == Lines{"open 0", "set 1", "set 0", "gone"});
    CHECK(bench.has_all_ticks());
    CHECK(bench.output("a").set(1, "operator").error().code == Errc::busy);
    bool is_done = false;
    bench.system->finish_outputs([&] { is_done = true; });
    bench.loop.advance(0ms);
    CHECK(is_done);
    bench.system.reset();
    CHECK(bench.did("A").empty());
  }

  TEST_CASE("US-35 an output gives its device back without waiting, and is closed afterwards") {
    Device device;
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    loop.script_lane_duration(100ms);
    OutputLog log(loop, "o");
    Output output(loop, {.name = "o"}, device.make());
    output.set(1).or_throw();
    loop.advance(50ms);
    bool is_done = false;
    output.finish([&] { is_done = true; });
    loop.advance(149ms);
    CHECK_FALSE(is_done);
    loop.advance(1ms);
    CHECK(is_done);
    CHECK(device.did == Lines{"open 0", "set 1", "set 0", "gone"});
    CHECK(log.lines == Lines{"start 0 done", "set 1 failed: the output is being closed", "stop 0 done"});
    output.close();
    CHECK(device.did.size() == 4);
    CHECK_FALSE(output.is_armed());
  }

  TEST_CASE("US-35 a device that hangs when it is given back is given up, and that is told") {
    Device device;
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    OutputLog log(loop, "o");
    Output output(loop, {.name = "o"}, device.make());
    loop.script_lane_duration(1h);
    bool is_done = false;
    const MonotonicTime began = loop.now();
    output.finish([&] {
      is_done = true;
      CHECK(loop.now() - began == 5s);
    });
    loop.advance(10s);
    CHECK(is_done);
    CHECK(output.has_ended_unsafe());
    CHECK(output.health() == Health::faulted);
    CHECK(log.lines.back().find("stop 0 failed: its device did not return within 5 s") == 0);
  }
}
