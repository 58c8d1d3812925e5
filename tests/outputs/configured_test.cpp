// Outputs of configurations: what check says, reloads, and the program, which is killed while one is on.
#include <doctest/doctest.h>
#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "app/control/commands.hpp"
#include "app/process.hpp"
#include "app/runtime_folder.hpp"
#include "fsm/configured.hpp"
#include "outputs/memory_actuator.hpp"
#include "outputs/terminal.hpp"
#include "paths.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/change.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/outputs/guard.hpp"
#include "rtdata/process/expression.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace std::chrono_literals;
using outputs_test::Device;
using outputs_test::DeviceConfig;
using outputs_test::Terminal;
using test::Folder;
using test::Process;

namespace {

using Lines = std::vector<std::string>;

struct Devices {
  std::map<std::string, Device> all;
  Registry registry = standard_registry();
  Devices() {
    registry.add_output<DeviceConfig>(
        "memory", "a device of memory", [this](const DeviceConfig& config) { return all[config.device].make()(); },
        [](PartPlan& plan, const DeviceConfig& config) {
          plan.place = {"memory", "device " + config.device, ""};
        });
  }
};

constexpr const char* load = R"("sensors": [{"name": "load", "type": "host", "quantity": "load", "rate": "10 Hz"}])";

/// The problems of a file with these outputs and a sensor `load`, each as "id line:column message".
Lines problems_of(const std::string& outputs) {
  const std::string text = "{" + std::string(load) + ",\n \"outputs\": [" + outputs + "]}";
  Lines lines;
  for (const Problem& problem : plan_system(standard_registry(), parse_config(text, "f.json")).problems)
    lines.push_back(problem.id + " " + problem.text());
  return lines;
}
/// Whether there is one problem, with this in it.
bool is_refused(const std::string& outputs, const std::string& why) {
  const Lines problems = problems_of(outputs);
  for (const std::string& problem : problems) CAPTURE(problem);
  const bool is_so = problems.size() == 1 && problems[0].find(why) != std::string::npos;
  for (const std::string& problem : problems)
    if (!is_so) MESSAGE(problem);
  return is_so;
}

}  // namespace

TEST_SUITE("outputs") {
  TEST_CASE("US-35 check finds the mistakes of outputs") {
    const std::string pwm = R"({"name": "fan", "type": "pwm", )";
    CHECK(problems_of(pwm + R"("on": "load", "expression": "minutes_1 > 2"})").empty());
    CHECK(is_refused(pwm + R"("safe": 2})", "2 is not a value for the device: from 0 to 1"));
    CHECK(is_refused(pwm + R"("on": "lod", "expression": "1"})", "lod"));
    CHECK(is_refused(pwm + R"("on": "load", "expression": "minutes_1 >"})", "f.json:2"));
    CHECK(is_refused(pwm + R"("on": "load", "expression": "minute_1 > 2"})", "minute_1"));
    CHECK(is_refused(pwm + R"("expression": "minutes_1 > 2"})", "need `on`, the topic"));
    CHECK(is_refused(pwm + R"("on": "load", "expression": "minutes_1", "lease": "1 s"})", "max_age"));
    CHECK(
        is_refused(pwm + R"("on": "load", "expression": "minutes_1", "hysteresis": {"on": 1, "off": 1}})", "the same"));
    CHECK(is_refused(pwm + R"("on": "load", "expression": "minutes_1", "pid": {"setpoint": 1}})", "all gains are 0"));
    CHECK(is_refused(pwm + R"("armed": "never"})", "armed"));
    CHECK(is_refused(pwm + R"("chanel": 1})", "channel"));
    CHECK(is_refused(R"({"name": "fan", "type": "pwm"}, {"name": "other", "type": "pwm"})", "duplicate-place"));
    CHECK(is_refused(R"({"name": "fan", "type": "pwm"}, {"name": "fan", "type": "pwm", "channel": 1})", "duplicate"));
    CHECK(is_refused(R"({"name": "x", "type": "serial", "device": "/dev/ttyX"},
                        {"name": "y", "type": "serial", "device": "/dev/ttyX"})",
                     "duplicate-place"));
    if (!standard_registry().outputs().find("gpio")) return;
    CHECK(is_refused(R"({"name": "x", "type": "gpio", "line": 3, "safe": 0.5})", "0 or 1"));
    CHECK(is_refused(R"({"name": "x", "type": "gpio", "line": "A"}, {"name": "y", "type": "gpio", "line": "A"})",
                     "duplicate-place"));
    const std::string both = R"({"sensors": [{"name": "b", "type": "edge", "line": "A"}],
        "outputs": [{"name": "x", "type": "gpio", "line": "A"}]})";
    CHECK(plan_system(standard_registry(), parse_config(both, "f.json")).problems.size() == 1);
  }

  TEST_CASE("US-35 check refuses what the guard does not take: more than 1024 outputs, or 64 KiB of one") {
    const auto pwm = [](std::size_t count) {
      std::string all;
      for (std::size_t i = 0; i < count; ++i)
        all += (i > 0 ? "," : "") + std::string(R"({"name": "p)") + std::to_string(i) +
               R"(", "type": "pwm", "channel": )" + std::to_string(i) + "}";
      return all;
    };
    CHECK(problems_of(pwm(OutputGuard::most_outputs)).empty());
    CHECK(is_refused(pwm(OutputGuard::most_outputs + 2),
                     "more outputs than the guard of outputs accepts, which is 1024"));
    const auto serial = [](std::size_t bytes) {
      return R"({"name": "s", "type": "serial", "device": "/dev/ttyX", "text": ")" + std::string(bytes, 'x') +
             R"({value}"})";
    };
    CHECK(problems_of(serial(OutputGuard::most_bytes - 2000)).empty());
    CHECK(is_refused(serial(OutputGuard::most_bytes), "more than 64 KiB of settings"));
  }

  TEST_CASE("US-35 check refuses a text that is the same for each value, and two values with one word") {
    const std::string serial = R"({"name": "s", "type": "serial", "device": "/dev/ttyX", )";
    for (const char* text : {"on\\n", "{Value}\\n", ""})
      CHECK(is_refused(serial + R"("text": ")" + text + "\"}", "every value would send the same text"));
    CHECK(is_refused(serial + R"("words": {"0": "a", "0.5": "b", "1": "a"}})",
                     "0 and 1 are both written \"a\": the device could not distinguish them"));
    CHECK(problems_of(serial + R"("words": {"0": "a", "1": "b"}})").empty());
    CHECK(problems_of(serial + R"("words_hex": {"0": "a0 01", "1": "A002"}, "answer_hex": "06"})").empty());
    CHECK(is_refused(serial + R"("words_hex": {"0": "a0", "1": "xy"}})", "\"xy\": these are not bytes"));
    CHECK(is_refused(serial + R"("words_hex": {"0": "a0", "1": "a0"}})", "the device could not distinguish them"));
    CHECK(is_refused(serial + R"("words_hex": {"0": "a0"}, "text": "{value}"})", "there is also a `text` or `words`"));
    CHECK(is_refused(serial + R"("answer": "OK", "answer_hex": "06"})", "there is also an `answer`"));
  }

  TEST_CASE("US-35 US-41 check finds the mistakes of machines that set outputs") {
    const auto is_refused_with = [](const std::string& states, const std::string& more, const std::string& why) {
      const std::string text = "{" + std::string(load) + R"(, "tiers": {"fast": {}},
        "outputs": [{"name": "fan", "type": "pwm"}, {"name": "far", "type": "pwm", "channel": 1, "tier": "fast"},
          {"name": "own", "type": "pwm", "channel": 2, "on": "load", "expression": "minutes_1 > 2"}],
        "machines": [{"name": "m", "start": "a", "states": [)" +
                               states + R"(]})" + more + "]}";
      const SystemPlan plan = plan_system(standard_registry(), parse_config(text, "f.json"));
      CAPTURE(plan.report());
      return why.empty() ? plan.good() : plan.problems.size() == 1 && plan.report().find(why) != std::string::npos;
    };
    CHECK(is_refused_with(R"({"name": "a", "final": true, "set": [{"output": "fan", "value": 1}], "arm": ["fan"]})", "",
                          ""));
    CHECK(is_refused_with(R"({"name": "a", "final": true, "set": [{"output": "fam", "value": 1}]})", "",
                          "did you mean \"fan\"?"));
    CHECK(is_refused_with(R"({"name": "a", "final": true, "arm": ["fam"]})", "", "did you mean \"fan\"?"));
    CHECK(is_refused_with(R"({"name": "a", "final": true, "set": [{"output": "fan", "value": "on"}]})", "", "number"));
    CHECK(is_refused_with(
        R"({"name": "a", "final": true, "set": [{"output": "fan", "value": 1}, {"output": "fan", "value": 0}]})", "",
        "the state sets the output \"fan\" already"));
    CHECK(is_refused_with(R"({"name": "a", "final": true, "set": [{"output": "own", "value": 1}]})", "",
                          "follows a topic, and nothing else sets it"));
    CHECK(is_refused_with(R"({"name": "a", "final": true, "set": [{"output": "far", "value": 1}]})", "",
                          "is on another loop"));
    CHECK(is_refused_with(
        R"({"name": "a", "final": true, "set": [{"output": "fan", "value": 1}]})",
        R"(, {"name": "n", "start": "a", "states": [{"name": "a", "final": true, "set": [{"output": "fan", "value": 0}]}]})",
        "machine m, at f.json:4:22, has the output fan already; one machine sets an output"));
  }

  TEST_CASE("US-35 US-41 a state sets outputs when the machine arrives, also in its start; who is disarmed is told") {
    Devices devices;
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    const SystemPlan plan = plan_system(devices.registry, parse_config("{" + std::string(load) + R"(, "outputs": [
        {"name": "a", "type": "memory", "device": "A"}, {"name": "b", "type": "memory", "device": "B", "armed": "by command"}],
        "machines": [{"name": "m", "start": "one",
          "states": [{"name": "one", "set": [{"output": "a", "value": 2}], "arm": ["b"]}, {"name": "two", "set": [{"output": "a", "value": 3}, {"output": "b"}]}],
          "transitions": [{"from": "one", "to": "two", "event": "go"}, {"from": "two", "to": "one", "event": "back"}]}]})",
                                                                       "f.json"));
    REQUIRE_MESSAGE(plan.good(), plan.report());
    std::vector<std::string> changes;
    const auto listen = loop.subscribe<OutputChange>("b", [&](const auto& change) {
      changes.push_back(std::string(change->by) + (change->done ? ": done" : ": " + std::string(change->why)));
    });
    System system(loop, devices.registry, plan);
    loop.advance(1ms);
    CHECK(devices.all["A"].did == Lines{"open 0", "set 2"});
    auto& machine = system.parts().get<fsm::ConfiguredMachine>("machine", "m");
    Output& b = system.parts().get<Output>("output", "b");
    changes.clear();
    machine.raise("go").or_throw();
    loop.advance(1ms);
    CHECK(devices.all["A"].did == Lines{"open 0", "set 2", "set 3"});
    CHECK(devices.all["B"].did == Lines{"open 0"});
    REQUIRE(changes.size() == 1);
    CHECK(changes[0].starts_with("machine m: it is disarmed"));
    machine.raise("back").or_throw();
    b.arm("test").or_throw();
    machine.raise("go").or_throw();
    loop.advance(1ms);
    CHECK(devices.all["B"].did == Lines{"open 0", "set 1"});
    CHECK(changes.back() == "machine m: done");
  }

  TEST_CASE("US-35 an output of a configuration follows its sensor; a reload leaves it untouched or makes it anew") {
    Devices devices;
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    const auto plan = [&](const std::string& second) {
      return plan_system(devices.registry, parse_config("{" + std::string(load) + R"(, "outputs": [
          {"name": "a", "type": "memory", "device": "A", "on": "load", "expression": "minutes_1 >= 0"},
          {"name": "b", "type": "memory", "device": "B")" + second +
                                                            "}]}",
                                                        "f.json"));
    };
    const SystemPlan first = plan("");
    REQUIRE_MESSAGE(first.good(), first.report());
    {
      System system(loop, devices.registry, first);
      CHECK(system.parts().names("output") == Lines{"a", "b"});
      loop.advance(200ms);
      CHECK(devices.all["A"].did == Lines{"open 0", "set 1"});
      system.parts().get<Output>("output", "b").set(1).or_throw();
      loop.advance(1ms);
      const SystemPlan next = plan(R"(, "safe": 3)");
      const PlanChange change = system.apply(next);
      CHECK(change.refused() == 0);
      loop.advance(200ms);
      CHECK(devices.all["A"].did == Lines{"open 0", "set 1"});
      CHECK(devices.all["B"].did == Lines{"open 0", "set 1", "set 0", "gone", "open 3"});
      bool is_listed = false;
      for (const SensorStatus& status : loop.runtime().sensors()) is_listed = is_listed || status.name == "a";
      CHECK(is_listed);  // as `rtdata top` has it
    }
    CHECK(devices.all["A"].did == Lines{"open 0", "set 1", "set 0", "gone"});
  }

  TEST_CASE(
      "US-35 US-5 a reload changes a controller while its output runs, and a commanded set point lasts until it") {
    Devices devices;
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    const auto plan = [&](const std::string& pid, const std::string& more = "") {
      return plan_system(devices.registry, parse_config("{" + std::string(load) + more + R"(, "outputs": [
          {"name": "a", "type": "memory", "device": "A", "on": "load", "expression": "minutes_1 * 0 + 18")" +
                                                            pid + "}]}",
                                                        "f.json"));
    };
    const std::string before = R"(, "pid": {"setpoint": 20, "kp": 0.1, "ki": 0.001})";
    const SystemPlan first = plan(before);
    REQUIRE_MESSAGE(first.good(), first.report());
    System system(loop, devices.registry, first);
    app::Tares tares("/no/such/folder/f.tare", "f.json");
    app::CommandDesk desk(loop, system, tares, [](const std::string&, bool) {});
    const auto command = [&](const Lines& words) {
      std::string text;
      desk.run(words, "test", [&](const app::CommandOutcome& outcome) { text = outcome.text; });
      return text;
    };
    loop.advance(1s);
    double value = devices.all["A"].value.value_or(-1);
    CHECK(value == doctest::Approx(0.2).epsilon(0.01));
    const auto grows_by = [&] {  // in a second
      const double was = devices.all["A"].value.value_or(-1);
      loop.advance(1s);
      return devices.all["A"].value.value_or(-1) - was;
    };
    CHECK(grows_by() == doctest::Approx(0.002));
    CHECK(system.apply(plan(R"(, "pid": {"setpoint": 20, "kp": 0.3, "ki": 0.002})")).count(Fate::live) == 1);
    CHECK(grows_by() == doctest::Approx(0.004));
    CHECK(command({"pid", "a", "setpoint", "25"}) == "the set point of output a is 25 until the next reload");
    CHECK(grows_by() == doctest::Approx(0.014));
    CHECK(command({"pid", "a", "kp", "25"}).find("pid OUTPUT setpoint VALUE") != std::string::npos);
    CHECK(command({"pid", "a", "setpoint", "on"}) == "\"on\" is not a number");
    CHECK(command({"pid", "b", "setpoint", "1"}).find("\"b\"") != std::string::npos);
    // One that changes something else, too.
    (void)system.apply(plan(R"(, "pid": {"setpoint": 20, "kp": 0.3, "ki": 0.002})", R"(, "notes": "x")"));
    CHECK(grows_by() == doctest::Approx(0.004));
    CHECK(std::count(devices.all["A"].did.begin(), devices.all["A"].did.end(), "gone") == 0);
    // Without a controller it is another output.
    CHECK(system.apply(plan("")).count(Fate::restarted) == 1);
    CHECK(command({"pid", "a", "setpoint", "1"}).find("it has no `pid`") != std::string::npos);
  }

  TEST_CASE("US-35 US-41 a reload fires nothing again: an output gets back what its machine had set, if it had that") {
    Devices devices;
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    const auto plan =
        [&](const std::string& igniter, const std::string& valve, const std::string& machine) {
          return plan_system(devices.registry, parse_config(R"({"outputs": [
        {"name": "igniter", "type": "memory", "device": "I", "lease": "1 s")" +
                                                                igniter +
                                                                R"(},
        {"name": "valve", "type": "memory", "device": "V")" + valve +
                                                                R"(}],
        "machines": [{"name": "m", "start": "pad", "states": [{"name": "pad"},
          {"name": "fire", "set": [{"output": "igniter"}, {"output": "valve", "value": 2}]}, {"name": "coast"}],
          "transitions": [{"from": "pad", "to": "fire", "event": "go"}, {"from": "fire", "to": "coast", "event": "on"},
                          {"from": "coast", "to": "fire", "event": "again"})" +
                                                                machine + "]}]}",
                                                            "f.json"));
        };
    const auto begin = plan("", "", "");
    REQUIRE_MESSAGE(begin.good(), begin.report());
    System system(loop, devices.registry, begin);
    const auto raise = [&](const char* event) {
      system.parts().get<fsm::ConfiguredMachine>("machine", "m").raise(event).or_throw();
      loop.advance(1ms);
    };
    const auto did = [&](const char* device) {
      loop.advance(1ms);
      return std::exchange(devices.all[device].did, {});
    };
    const std::string more = R"(, {"from": "pad", "to": "coast", "event": "x"})";
    raise("go");
    CHECK(did("I") == Lines{"open 0", "set 1"});
    CHECK(did("V") == Lines{"open 0", "set 2"});
    loop.advance(2s);
    CHECK(did("I") == Lines{"set 0"});  // its lease is over
    CHECK(system.apply(plan("", "", more)).count(Fate::restarted) == 1);
    CHECK(did("I").empty());
    CHECK(did("V").empty());
    CHECK(system.parts().get<fsm::ConfiguredMachine>("machine", "m").now().state == "fire");
    // Made anew, each has what it had, also in a state that sets nothing.
    const std::string slower = R"(, "watchdog": "2 s")";
    system.apply(plan(slower, slower, more));
    CHECK(did("I") == Lines{"set 0", "gone", "open 0"});
    CHECK(did("V") == Lines{"set 0", "gone", "open 0", "set 2"});
    raise("on");
    system.apply(plan(slower, "", more));
    CHECK(did("V") == Lines{"set 0", "gone", "open 0", "set 2"});
    system.parts().get<Output>("output", "valve").set(0, "operator").or_throw();
    CHECK(did("V") == Lines{"set 0"});
    system.apply(plan(slower, slower, ""));
    CHECK(did("V") == Lines{"set 0", "gone", "open 0"});
    CHECK(did("I").empty());
    // An arrival sets them again.
    raise("again");
    CHECK(did("I") == Lines{"set 1"});
    CHECK(did("V") == Lines{"set 2"});
  }

  TEST_CASE("US-35 US-41 a machine that a reload removes leaves what it had set safe, and says so") {
    Devices devices;
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    Lines told;
    loop.runtime().on_log([&](const LogRecord& record) {
      if (record.object == "machine m") told.push_back(std::string(record.text));
    });
    const auto plan = [&](const std::string& more, const std::string& igniter = "") {
      return plan_system(devices.registry, parse_config(R"({"outputs": [)" + igniter + R"(
        {"name": "valve", "type": "memory", "device": "V"}, {"name": "lamp", "type": "memory", "device": "L"}])" +
                                                            more + "}",
                                                        "f.json"));
    };
    const auto machine = [](const std::string& igniter, const std::string& event) {
      return R"(, "machines": [{"name": "m", "start": "on", "states": [{"name": "on", "set": [)" + igniter +
             R"({"output": "valve", "value": 2}, {"output": "lamp"}]}, {"name": "off", "final": true}],
             "transitions": [{"from": "on", "to": "off", "event": ")" +
             event + "\"}]}]";
    };
    const std::string igniter = R"({"name": "igniter", "type": "memory", "device": "I"}, )";
    const SystemPlan first = plan(machine(R"({"output": "igniter"}, )", "x"), igniter);
    REQUIRE_MESSAGE(first.good(), first.report());
    System system(loop, devices.registry, first);
    loop.advance(1ms);
    system.parts().get<Output>("output", "lamp").set(0.5, "operator").or_throw();
    loop.advance(1ms);
    // The output that goes with it is safe by itself.
    system.apply(plan(""));
    loop.advance(1ms);
    CHECK(devices.all["I"].value == 0.0);
    CHECK(devices.all["I"].did.back() == "gone");
    CHECK(devices.all["V"].did == Lines{"open 0", "set 2", "set 0"});
    CHECK(devices.all["L"].value == 0.5);
    CHECK(std::count(told.begin(), told.end(),
                     "it is removed: output valve, which it had set, is being set to its safe value") == 1);
    // One that is made anew leaves them as they are, one that is removed by itself does not.
    told.clear();
    system.apply(plan(machine("", "x")));
    loop.advance(1ms);
    system.apply(plan(machine("", "y")));
    loop.advance(1ms);
    CHECK(devices.all["V"].did == Lines{"open 0", "set 2", "set 0", "set 2"});
    system.remove("machine", "m");
    loop.advance(1ms);
    CHECK(devices.all["V"].value == 0.0);
    CHECK(devices.all["L"].value == 0.0);
    CHECK(told.size() == 2);
  }

  TEST_CASE("US-33 US-35 commands and reloads that need a tier which hangs are refused, and the rest goes on") {
    Devices devices;
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    const auto plan = [&](const std::string& outputs) {
      return plan_system(devices.registry, parse_config("{" + std::string(load) + R"(, "tiers": {"fast": {}},
        "machines": [{"name": "m", "tier": "fast", "start": "one", "states": [{"name": "one"}, {"name": "two", "final": true}],
          "transitions": [{"from": "one", "to": "two", "event": "go"}]}],
        "outputs": [)" + outputs + "]}",
                                                        "f.json"));
    };
    const std::string far = R"({"name": "far", "type": "memory", "device": "F", "tier": "fast"})";
    const std::string near = R"({"name": "near", "type": "memory", "device": "N"})";
    const SystemPlan first = plan(far + "," + near);
    REQUIRE_MESSAGE(first.good(), first.report());
    System system(loop, devices.registry, first);
    app::Tares tares("/no/such/folder/f.tare", "f.json");
    app::CommandDesk desk(loop, system, tares, [](const std::string&, bool) {});
    const auto command = [&](const Lines& words) {
      auto outcome = std::make_shared<app::CommandOutcome>();
      desk.run(words, "test", [outcome](const app::CommandOutcome& came) { *outcome = came; });
      return outcome;
    };
    int ticks = 0;
    const Ticker ticker(loop, 100ms, [&](const Tick&) { ++ticks; });
    loop.advance(1s);
    const auto hold = [&](Duration time) {
      system.tier("fast").loop().post([&, time] { loop.manual_clock().pass(time); });
    };

    int changes = 0;
    const auto listen = loop.subscribe<fsm::StateChange>("m", [&](const auto&) { ++changes; });

    // One that is held once costs nobody anything.
    hold(1500ms);
    loop.advance(100ms);
    ticks = 0;
    auto set = command({"set", "far", "1"});
    loop.advance(1s);
    CHECK(ticks == 10);
    CHECK(set->text.empty());
    loop.advance(1s);
    CHECK(set->done);
    CHECK(devices.all["F"].value == 1.0);

    hold(1min);
    loop.advance(100ms);
    ticks = 0;
    set = command({"set", "far", "0"});
    CHECK(command({"set", "near", "1"})->done);
    loop.advance(3s);
    CHECK(ticks == 30);
    CHECK_FALSE(set->done);
    CHECK(set->text.starts_with("tier fast has not returned from "));
    CHECK(set->text.find("for 2 s: nothing was done") != std::string::npos);
    {  // Where it is known to hang, at once.
      const TierWatch watch(loop, 1s);
      loop.advance(2s);
      set = command({"set", "far", "0"});
      CHECK_FALSE(set->done);
      CHECK(set->text.find("has not returned from") != std::string::npos);
      changes = 0;
      const auto go = command({"event", "m", "go"});
      CHECK_FALSE(go->done);
      CHECK(go->text.find("nothing was done") != std::string::npos);
    }
    const std::string more = R"(, {"name": "third", "type": "memory", "device": "T")";
    CHECK_THROWS_WITH_AS(system.apply(plan(near)), doctest::Contains("nothing was changed"), SetupError);
    CHECK_THROWS_WITH_AS(system.apply(plan(far + "," + near + more + R"(, "tier": "fast"})")),
                         doctest::Contains("has not returned from"), SetupError);
    CHECK(system.apply(plan(far + "," + near + more + "}")).count(Fate::added) == 1);
    CHECK(devices.all["T"].did == Lines{"open 0"});
    // All outputs are given back for which that can be done.
    bool is_safe = false;
    system.finish_outputs([&] { is_safe = true; });
    loop.advance(2s);
    CHECK(is_safe);
    CHECK(devices.all["N"].did == Lines{"open 0", "set 1", "set 0", "gone"});
    // What was refused is not done later.
    loop.advance(1min);
    CHECK(devices.all["F"].did == Lines{"open 0", "set 1"});
    CHECK(changes == 0);
    // At the end those who wait are told.
    hold(1min);
    set = command({"set", "far", "0"});
    desk.end();
    CHECK(set->text == "the program ends already");
    loop.advance(1min);
  }

  TEST_CASE("US-35 US-5 an output that is armed by command is not touched by a reload, and none is armed by one") {
    Devices devices;
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    const auto plan = [&](const std::string& more, bool has_igniter = true) {
      return plan_system(
          devices.registry,
          parse_config(
              std::string(R"({"outputs": [)") +
                  (has_igniter
                       ? R"({"name": "igniter", "type": "memory", "device": "I", "armed": "by command")" + more + "}, "
                       : "") +
                  R"({"name": "valve", "type": "memory", "device": "V")" + more + "}]}",
              "f.json"));
    };
    const SystemPlan first = plan("");
    const SystemPlan next = plan(R"(, "watchdog": "2 s")");
    REQUIRE_MESSAGE(next.good(), next.report());
    System system(loop, devices.registry, first);
    const auto output = [&](const char* name) -> Output& { return system.parts().get<Output>("output", name); };
    // Nobody knows it of two files.
    CHECK(plan_change(first, next).text() ==
          "output igniter: restarted (watchdog; refused while it is armed)\noutput valve: restarted (watchdog)\n");
    CHECK(plan_change(first, plan("", false)).text() == "output igniter: removed (refused while it is armed)\n");

    output("igniter").arm("operator").or_throw();
    output("igniter").set(1, "operator").or_throw();
    loop.advance(1ms);
    CHECK(system.change_to(next).text() ==
          "output igniter: refused: it is armed; disarm it first\noutput valve: restarted (watchdog)\n");
    CHECK(system.change_to(plan("", false)).text() == "output igniter: refused: it is armed; disarm it first\n");
    CHECK_THROWS_WITH_AS(system.apply(next), doctest::Contains("it is armed; disarm it first"), SetupError);
    CHECK(devices.all["I"].did == Lines{"open 0", "set 1"});
    CHECK(devices.all["V"].did == Lines{"open 0"});
    CHECK(output("igniter").is_armed());

    output("igniter").disarm("operator").or_throw();
    output("valve").disarm("operator").or_throw();
    loop.advance(1ms);
    CHECK(system.apply(next).text() == "output igniter: restarted (watchdog)\noutput valve: restarted (watchdog)\n");
    CHECK_FALSE(output("igniter").is_armed());
    CHECK_FALSE(output("valve").is_armed());  // though it is armed from the start on
    CHECK(output("valve").set(1, "operator").error().why == "it is disarmed");
    output("valve").arm("operator").or_throw();
    system.apply(first);
    CHECK(output("valve").is_armed());
  }

  TEST_CASE("US-35 US-39 outputs follow the states of a machine and an alarm, which hold until they change") {
    Devices devices;
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    const SystemPlan plan = plan_system(devices.registry, parse_config(R"({
      "sensors": [{"name": "load", "type": "host", "quantity": "load", "rate": "10 Hz"},
                  {"name": "busy", "type": "limit", "on": "load", "field": "minutes_1", "low": -1, "high": 1e9, "delay": "0 s"},
                  {"name": "idle", "type": "limit", "on": "load", "field": "minutes_1", "high": -1}],
      "machines": [
        {"name": "work", "inputs": ["idle"], "max_age": "1 s", "start": "pause",
         "states": [{"name": "pause"}, {"name": "at it"}, {"name": "done", "final": true}],
         "transitions": [{"from": "pause", "to": "at it", "when": "is_active == 1", "after": "20 s"},
                         {"from": "at it", "to": "done", "after": "20 s"}]}],
      "outputs": [
        {"name": "a", "type": "memory", "device": "A", "on": "work", "expression": "pause ? 2 : done ? 3 : 4"},
        {"name": "b", "type": "memory", "device": "B", "on": "busy", "expression": "is_active"},
        {"name": "c", "type": "memory", "device": "C", "on": "idle", "expression": "is_active"},
        {"name": "d", "type": "memory", "device": "D", "on": "load", "with": ["work"], "max_age": "1 s",
         "expression": "'work.at it' and minutes_1 > -1"}]})",
                                                                       "f.json"));
    REQUIRE_MESSAGE(plan.good(), plan.report());
    const System system(loop, devices.registry, plan);
    loop.advance(1s);
    CHECK(devices.all["A"].did == Lines{"open 0", "set 2"});
    CHECK(devices.all["B"].did == Lines{"open 0"});
    CHECK(devices.all["C"].did == Lines{"open 0", "set 1"});
    loop.advance(20s);
    CHECK(devices.all["A"].did == Lines{"open 0", "set 2", "set 4"});
    CHECK(devices.all["D"].did == Lines{"open 0", "set 1"});
    loop.advance(60s);
    CHECK(devices.all["A"].did == Lines{"open 0", "set 2", "set 4", "set 3"});
    CHECK(devices.all["B"].did == Lines{"open 0"});
    CHECK(devices.all["C"].did == Lines{"open 0", "set 1"});
    CHECK(devices.all["D"].did == Lines{"open 0", "set 1", "set 0"});
  }

  TEST_CASE("US-35 US-39 a reload that makes a limit anew pulses neither the output nor the machine that follow it") {
    Devices devices;
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    const auto planned = [&](const std::string& field) {
      return plan_system(devices.registry, parse_config(R"({
        "sensors": [{"name": "load", "type": "host", "quantity": "load", "rate": "10 Hz"},
          {"name": "busy", "type": "limit", "on": "load", "field": ")" +
                                                            field + R"(", "high": 1e9}],
        "machines": [{"name": "m", "inputs": ["busy"], "start": "ok", "states": [{"name": "ok"}, {"name": "alarm"}],
          "transitions": [{"from": "ok", "to": "alarm", "when": "is_active == 1"},
                          {"from": "alarm", "to": "ok", "when": "is_active == 0"}]}],
        "outputs": [{"name": "siren", "type": "memory", "device": "S", "on": "busy", "expression": "is_active"}]})",
                                                        "f.json"));
    };
    const SystemPlan plan = planned("minutes_1");
    REQUIRE_MESSAGE(plan.good(), plan.report());
    System system(loop, devices.registry, plan);
    Lines states;
    const auto seen = loop.subscribe<fsm::StateChange>(
        "m", [&](const Event<fsm::StateChange>& event) { states.emplace_back(std::string(event->to)); });
    loop.advance(1s);
    CHECK(system.apply(planned("minutes_5")).text() == "sensor busy: restarted (field)\n");
    loop.advance(1s);
    CHECK(devices.all["S"].did == Lines{"open 0"});
    CHECK(states.empty());
    system.sensor("busy").stop();
    loop.advance(1s);
    CHECK(devices.all["S"].did == Lines{"open 0", "set 1"});
    CHECK(states == Lines{"alarm"});
  }

  TEST_CASE("US-35 check knows the states of a machine as names, and says which was meant") {
    const auto problems = [](const std::string& expression) {
      Lines lines;
      for (const Problem& problem : plan_system(standard_registry(), parse_config(R"({
          "machines": [{"name": "valve", "start": "closed", "states": [{"name": "closed"}, {"name": "open"}],
            "transitions": [{"from": "closed", "to": "open", "event": "o"}, {"from": "open", "to": "closed", "event": "c"}]}],
          "outputs": [{"name": "fan", "type": "pwm", "on": "valve", "expression": ")" +
                                                                                      expression + R"("}]})",
                                                                                  "f.json"))
                                        .problems)
        lines.push_back(problem.text());
      return lines;
    };
    CHECK(problems("open or valve.closed and lasted < 5").empty());
    const Lines found = problems("opne");
    REQUIRE(found.size() == 1);
    CAPTURE(found[0]);
    CHECK(found[0].find("there is no name `opne`") != std::string::npos);
    CHECK(found[0].find("did you mean \"open\"?") != std::string::npos);
    CHECK(problems("to == 1").size() == 1);
  }

  TEST_CASE("US-35 a part that cannot be made leaves the outputs before it safe") {
    Devices devices;
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    devices.all["B"].fails = true;
    const SystemPlan plan = plan_system(devices.registry, parse_config(R"({"outputs": [
        {"name": "a", "type": "memory", "device": "A", "safe": 1}, {"name": "b", "type": "memory", "device": "B"}]})",
                                                                       "f.json"));
    CHECK_THROWS_WITH_AS(System(loop, devices.registry, plan), doctest::Contains("it is broken"), SetupError);
    CHECK(devices.all["A"].did == Lines{"open 1", "set 1", "gone"});
  }

  TEST_CASE("US-35 the guard makes a device of what the configuration says of it") {
    Devices devices;
    const auto made = devices.registry.make_actuator(R"({"type": "memory", "device": "A"})");
    CHECK(made->open(2).has_value());
    CHECK(devices.all["A"].did == Lines{"open 2"});
    CHECK_THROWS_AS((void)devices.registry.make_actuator(R"({"type": "memory"})"), ConfigError);
    CHECK_THROWS_AS((void)devices.registry.make_actuator(R"({"type": "no such"})"), ConfigError);
    CHECK_THROWS_AS((void)devices.registry.make_actuator("nonsense"), SetupError);
  }

  TEST_CASE(
      "US-35 US-17 rtdata run: its output is safe when it is killed, stopped, or ends, and its changes recorded") {
    for (const int number : {SIGTERM, SIGKILL, SIGSEGV, SIGSTOP}) {
      CAPTURE(number);
      Folder folder;
      Terminal line;
      folder.write("f.json", "{" + std::string(load) +
                                 R"(, "outputs": [{"name": "lamp", "type": "serial", "device": ")" + line.name +
                                 R"(", "text": "<{value}>", "on": "load", "expression": "minutes_1 >= 0",
          "watchdog": "300 ms"}], "sinks": [{"type": "sqlite", "path": "run.db"}]})");
      Process run(folder, test::built("rtdata"), {"run", "f.json"});
      CHECK(line.reads("<1>"));
      const auto began = std::chrono::steady_clock::now();
      run.signal(number);
      CHECK(line.reads("<0>"));
      const auto took = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - began);
      MESSAGE("signal " << number << ": safe after " << took.count() << " ms");
      CHECK(line.got == "<0><1><0>");
      if (number == SIGSTOP) {
        run.signal(SIGCONT);
        CHECK_FALSE(line.reads_within("<1>", 1s));  // it must be armed first
        run.signal(SIGTERM);
      }
      const int status = run.end();
      if (number != SIGTERM && number != SIGSTOP) continue;
      CHECK(status == 0);
      Process rows(folder, test::built("rtdata"), {"export", "run.db", "--topic", "lamp", "--format", "csv"});
      CHECK(rows.end() == 0);
      CHECK(rows.out.find("start") != std::string::npos);
      CHECK(rows.out.find("input") != std::string::npos);
      CHECK(rows.out.find("stop") != std::string::npos);
      CHECK((rows.out.find("watchdog") != std::string::npos) == (number == SIGSTOP));
      Process verify(folder, test::built("rtdata"), {"verify", "run.db"});
      CHECK(verify.end() == 0);
    }
  }

  TEST_CASE(
      "US-35 outputs are armed and set by command, and machines get events, and each is recorded with who asked") {
    const test::RuntimeFolder runtime;
    const Folder folder;
    Terminal line;
    folder.write("f.json", "{" + std::string(load) + R"(,
      "machines": [{"name": "valve", "start": "closed", "states": [{"name": "closed"}, {"name": "open"}],
        "transitions": [{"from": "closed", "to": "open", "event": "open"}, {"from": "open", "to": "closed", "event": "close"}]}],
      "outputs": [{"name": "lamp", "type": "serial", "device": ")" +
                               line.name +
                               R"(", "text": "<{value}>", "armed": "by command"}],
      "sinks": [{"type": "sqlite", "path": "run.db"}]})");
    Process run(folder, test::built("rtdata"), {"run", "f.json"});
    REQUIRE(run.wait_for("running f"));
    const auto ctl = [&](std::vector<std::string> words, int status) {
      words.insert(words.begin(), "ctl");
      Process one(folder, test::built("rtdata"), words);
      CHECK(one.end() == status);
      return one.out + one.err;
    };
    CHECK(ctl({"set", "lamp", "1"}, 1).find("disarmed") != std::string::npos);
    CHECK(ctl({"arm", "lamp"}, 0) == "output lamp is armed\n");
    CHECK(ctl({"arm", "lamp"}, 0) == "output lamp is armed already\n");
    CHECK(ctl({"set", "lamp", "on"}, 0) == "output lamp is being set to on\n");
    CHECK(line.reads("<1>"));
    CHECK(ctl({"set", "lamp", "bright"}, 1).find("\"bright\" is not a number, on or off") != std::string::npos);
    CHECK(ctl({"set", "lmap", "0"}, 1).find("lamp") != std::string::npos);
    CHECK(ctl({"disarm", "lamp"}, 0).find("safe value") != std::string::npos);
    CHECK(line.reads("<0>"));
    CHECK(ctl({"event", "valve", "open"}, 0) == "machine valve has got the event open\n");
    CHECK(ctl({"event", "valve", "opne"}, 1).find("open") != std::string::npos);
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    Process rows(folder, test::built("rtdata"), {"export", "run.db", "--topic", "lamp", "--format", "csv"});
    CHECK(rows.end() == 0);
    CHECK(rows.out.find("uid " + std::to_string(::geteuid())) != std::string::npos);
    Process changes(folder, test::built("rtdata"), {"export", "run.db", "--topic", "valve", "--format", "csv"});
    CHECK(changes.end() == 0);
    CHECK(changes.out.find("open") != std::string::npos);
    CHECK(Process(folder, test::built("rtdata"), {"verify", "run.db"}).end() == 0);
  }
}
