// Machines of configurations: what check refuses, what they do with events, and going on after a pause.
#include "fsm/configured.hpp"

#include <doctest/doctest.h>

#include <string>
#include <vector>

#include "app/process.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/process/expression.hpp"
#include "rtdata/sensors/feed.hpp"

using namespace rtdata;
using namespace std::chrono_literals;

namespace {

using Lines = std::vector<std::string>;

const std::string load = R"({"name": "load", "type": "host", "quantity": "load", "rate": "10 Hz"})";

SystemPlan planned(const std::string& machines, const std::string& more = "") {
  return plan_system(
      standard_registry(),
      parse_config("{\"sensors\": [" + load + "],\n\"machines\": [" + machines + "]" + more + "}", "f.json"));
}
/// A machine "m" on the topic "load"; each mistake is alone.
std::string machine(const std::string& states, const std::string& transitions, const std::string& start = "a") {
  return R"({"name": "m", "inputs": ["load"], "start": ")" + start + "\",\n\"states\": [" + states +
         "],\n\"transitions\": [" + transitions + "]}";
}
const std::string a_and_b = R"({"name": "a"}, {"name": "b", "final": true})";
Lines said_of(const std::string& machines, const std::string& more = "") {
  Lines lines;
  for (const Problem& problem : planned(machines, more).problems) lines.push_back(problem.text());
  return lines;
}

struct Height {
  double altitude = 0;
  friend constexpr auto describe(type_tag<Height>) {
    return record("height", field("altitude", &Height::altitude, "m"));
  }
};

struct Bench {
  Loop loop{Loop::Manual{}};
  Lines errors;
  Lines changes;
  Feed<Height> baro;
  Feed<Height> other;
  Subscription seen;
  std::optional<fsm::ConfiguredMachine> machine;

  explicit Bench(const fsm::MachineSettings& settings,
                 const std::optional<fsm::ConfiguredMachine::Beginning>& beginning = {}) {
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
    baro = Feed<Height>(loop, {.name = "baro"});
    other = Feed<Height>(loop, {.name = "other"});
    seen = loop.subscribe<fsm::StateChange>("m", [this](const Event<fsm::StateChange>& e) {
      changes.push_back(std::string(e->from) + ">" + std::string(e->to) + ": " + std::string(e->cause));
    });
    machine.emplace(loop, settings, beginning);
    loop.advance(0ns);
  }
  Lines give(double altitude, Duration after = 100ms) {
    loop.advance(after);
    baro.publish(Height{altitude}, loop.time());
    loop.advance(0ns);
    loop.advance(0ns);
    return std::exchange(changes, {});
  }
};

}  // namespace

TEST_SUITE("fsm") {
  TEST_CASE("US-41 check says each mistake of a machine, with its place") {
    const std::string go = R"({"from": "a", "to": "b", "when": "running > 3"})";
    CHECK(said_of(machine(a_and_b, go)).empty());
    const Lines unknown = said_of(machine(a_and_b, R"({"from": "a", "to": "c"})"));
    REQUIRE(unknown.size() == 1);
    CHECK_MESSAGE(
        unknown[0].find("machines[0].transitions[0].to: there is no state \"c\" in `states`") != std::string::npos,
        unknown[0]);
    CHECK(said_of(machine(a_and_b, go, "pad")).at(0).find("start: there is no state \"pad\" in `states`") !=
          std::string::npos);
    CHECK(plan_system(
              standard_registry(),
              parse_config("{\"sensors\": [" + load + R"(,
      {"name": "busy", "type": "limit", "on": "load", "field": "running", "high": 3}],
      "machines": [{"name": "m", "inputs": ["busy"], "start": "a", "states": [)" +
                               a_and_b + R"(], "transitions": [{"from": "a", "to": "b", "when": "is_active"}]}]})",
                           "f.json"))
              .problems.empty());  // a flag is a condition
    const auto says = [](const std::string& item, const std::string& path, const std::string& why) {
      const Lines lines = said_of(item);
      CAPTURE(why);
      REQUIRE(lines.size() >= 1);
      CHECK_MESSAGE(lines[0].find(path + ": " + why) != std::string::npos, lines[0]);
    };
    says(R"({"name": "m", "states": [{"name": "a", "final": true}]})", "machines[0]", "\"start\" is missing");
    says(machine(a_and_b + R"(, {"name": "x", "final": true})", go), "machines[0].states[2].name",
         "nothing leads from the start to state `x`");
    says(machine(R"({"name": "a"}, {"name": "b"})", go), "machines[0].states[1].name",
         "nothing leads out of state `b`; if this is intended, declare it as final");
    says(machine(a_and_b, go + "," + go), "machines[0].transitions[1]", "the transition from `a` to `b` exists twice");
    says(machine(a_and_b, R"({"from": "a", "to": "b", "after": "5 s"}, {"from": "a", "to": "b", "after": "2 s"})"),
         "machines[0].transitions[0]", "the transition from `a` to `b` is never taken");
    says(machine(a_and_b, R"({"from": "a", "to": "b", "when": "runing > 3"})"), "machines[0].transitions[0].when",
         "there is no name `runing` (column 1 of the expression)");
    says(machine(a_and_b, R"({"from": "a", "to": "b", "when": "running >"})"), "machines[0].transitions[0].when",
         "the expression ends, but a value is missing");
    says(machine(a_and_b, R"({"from": "a", "to": "b", "when": "running"})"), "machines[0].transitions[0].when",
         "it is a number, not a condition: compare it with something");
    says(machine(a_and_b, R"({"from": "a", "to": "b", "when": "false"})"), "machines[0].transitions[0].when",
         "this condition is never true");
    says(machine(a_and_b, R"({"from": "a", "to": "b", "when": "running + 1"})"), "machines[0].transitions[0].when",
         "it is a number, not a condition: compare it with something");
    says(machine(a_and_b, R"({"from": "a", "to": "b", "for": "1 s"})"), "machines[0].transitions[0].for",
         "`for` needs a `when`");
    says(machine(a_and_b + R"(, {"name": "a"})", go), "machines[0].states[2].name", "there is already a state \"a\"");
    const auto says_of_state = [&](const std::string& state, const std::string& why) {
      says(R"({"name": "m", "start": ")" + state + R"(", "states": [{"name": ")" + state + R"(", "final": true}]})",
           "machines[0].states[0].name", why);
    };
    says_of_state("a/b", "the name of a state cannot contain `/`: expressions read it as `.`");
    says_of_state("lasted", "`lasted` is a field of the machine's changes");
    says_of_state("m", "`m` is the machine's topic");
    CHECK(said_of(R"({"name": "m", "start": "to", "states": [{"name": "to", "final": true}]})").empty());
    says(R"({"name": "m", "inputs": ["laod"], "start": "a", "states": [{"name": "a", "final": true}]})",
         "machines[0].inputs[0]", "nothing of this configuration publishes on \"laod\"");
    says(R"({"name": "load", "topic": "x", "start": "a", "states": [{"name": "a", "final": true}]})",
         "machines[0].name", "there is a sensor \"load\" already");
    says(R"({"name": "m", "start": "a", "states": [{"name": "a", "final": true}],
        "resume": {"recording": "db", "max_age": "10 s", "unknown_age": "start"}})",
         "machines[0].resume.recording", "there is no sink \"db\"");
  }

  TEST_CASE("US-41 check says all mistakes of a machine at once, word for word, with lines and columns") {
    const std::string text = R"({"sensors": [{"name": "load", "type": "host", "quantity": "load", "rate": "10 Hz"}],
 "machines": [
  {"name": "m", "inputs": ["load"], "start": "aa", "states": [{"name": "a"}, {"name": "b"}, {"name": "a"}],
   "transitions": [{"from": "a", "to": "b", "when": "minutes_1 > 1"},
                   {"from": "a", "to": "d"},
                   {"from": "b", "to": "a", "when": "minutes_1 + 1"},
                   {"from": "b", "to": "a", "for": "1 s"},
                   {"from": "b", "to": "a", "when": "minutes_1 >"}]}]})";
    Lines lines;
    for (const Problem& problem : plan_system(standard_registry(), parse_config(text, "f.json")).problems)
      lines.push_back(problem.text());
    CHECK(
        lines ==
        Lines{
            R"(f.json:3:46: machines[0].start: there is no state "aa" in `states`)",
            R"(f.json:3:102: machines[0].states[2].name: there is already a state "a")",
            R"(f.json:5:40: machines[0].transitions[1].to: there is no state "d" in `states`)",
            "f.json:6:53: machines[0].transitions[2].when: it is a number, not a condition: compare it with something",
            "f.json:7:52: machines[0].transitions[3].for: `for` needs a `when`, which must be true for this long: add "
            "`when`, or use `after`",
            "f.json:8:65: machines[0].transitions[4].when: the expression ends, but a value is missing (column 12 of "
            "the expression)"});
  }

  TEST_CASE("US-41 a machine of settings: conditions that hold for a time, memories that begin in a state, times") {
    Bench b({.name = "m",
             .inputs = {"baro"},
             .max_age = 500ms,
             .start = "up",
             .states = {{"up"}, {"down"}, {"landed", true}},
             .transitions = {{.from = "up", .to = "down", .when = "altitude < highest(altitude) - 5", .hold = 200ms},
                             {.from = "down", .to = "up", .when = "altitude > lowest(altitude) + 5"},
                             {.from = "down", .to = "landed", .after = 2s}}});
    CHECK(std::exchange(b.changes, {}) == Lines{">up: start"});
    for (const double altitude : {10.0, 90.0, 100.0, 94.0, 93.0}) CHECK(b.give(altitude).empty());
    CHECK(b.give(92) == Lines{"up>down: altitude < highest(altitude) - 5, for 200 ms"});
    CHECK(b.give(90).empty());
    CHECK(b.give(96) == Lines{"down>up: altitude > lowest(altitude) + 5"});
    CHECK(b.give(92).empty());  // 100 is forgotten: the highest since it is up is 96
    CHECK(b.give(90).empty());
    CHECK(b.give(89).empty());
    CHECK(b.give(88).size() == 1);
    b.loop.advance(2s);
    CHECK(b.machine->now().state == "landed");
    CHECK(b.errors.size() == 1);  // the silence of two seconds
    CHECK(b.errors.at(0).find("topic baro: the topic has had no event for more than 500 ms") != std::string::npos);
  }

  TEST_CASE("US-41 a value that is too old counts as absent, and does not hide another that is there") {
    Bench b({.name = "m",
             .inputs = {"baro", "other"},
             .max_age = 300ms,
             .start = "a",
             .states = {{"a"}, {"b", true}},
             .transitions = {{.from = "a", .to = "b", .when = "altitude > 50 and other > 50"},
                             {.from = "a", .to = "b", .when = "altitude > 500 or other > 500"}}});
    b.changes.clear();
    b.other.publish(Height{60}, b.loop.time());
    CHECK(b.give(10, 200ms).empty());
    CHECK(b.give(60, 200ms).empty());  // the other is 400 ms old
    CHECK(b.give(501, 200ms) == Lines{"a>b: altitude > 500 or other > 500"});
  }

  TEST_CASE("US-41 an input that is slow begins a condition anew that uses it, and no other") {
    for (const bool is_used : {false, true}) {
      CAPTURE(is_used);
      Bench b(
          {.name = "m",
           .inputs = {"baro", "other"},
           .max_age = 500ms,
           .start = "a",
           .states = {{"a"}, {"b", true}, {"c", true}},
           .transitions = {
               {.from = "a", .to = "c", .when = "other > 1000 or altitude > 1000"},
               {.from = "a", .to = "b", .when = is_used ? "altitude > 3 and other > 3" : "altitude > 3", .hold = 2s}}});
      b.changes.clear();
      // The other one comes each 550 ms, when its value before is too old, and that of the first is 55 ms old.
      Duration to_b = Duration::max();
      const MonotonicTime begin = b.loop.now();
      for (int i = 0; i < 40 && to_b == Duration::max(); ++i) {
        for (int k = 0; k < 5; ++k)
          if (!b.give(5, 99ms).empty()) to_b = b.loop.now() - begin;
        b.loop.advance(55ms);
        b.other.publish(Height{5}, b.loop.time());
        b.loop.advance(0ns);
      }
      CHECK((to_b == Duration::max()) == is_used);
      if (!is_used) CHECK(to_b <= 2200ms);
    }
  }

  TEST_CASE("US-41 events by name; a condition that fails is told once, and is false") {
    Bench b({.name = "m",
             .inputs = {"baro"},
             .start = "a",
             .states = {{"a"}, {"b", true}},
             .transitions = {{.from = "a", .to = "b", .when = "1 / altitude > 5"},
                             {.from = "a", .to = "b", .when = "altitude > 1", .event = "abort"}}});
    b.changes.clear();
    CHECK(b.give(0).empty());
    CHECK(b.give(0).empty());
    REQUIRE(b.errors.size() == 1);
    CHECK_MESSAGE(b.errors[0].find("from a to b: division by zero") != std::string::npos, b.errors[0]);
    CHECK(b.machine->raise("abrot").error().text() ==
          "cannot raise event: abrot: no transition of machine m waits for it: did you mean \"abort\"?");
    CHECK(b.machine->raise("abort"));
    b.loop.advance(1ms);
    CHECK(b.changes.empty());  // its condition does not hold
    CHECK(b.give(2).empty());
    CHECK(b.machine->raise("abort"));
    b.loop.advance(1ms);
    b.loop.advance(0ns);
    CHECK(b.changes == Lines{"a>b: abort, altitude > 1"});
  }

  TEST_CASE("US-41 a machine goes on in a state, and has been in it for as long as it was") {
    Bench b({.name = "m",
             .start = "a",
             .states = {{"a"}, {"b"}, {"c", true}},
             .transitions = {{.from = "a", .to = "b", .event = "go"}, {.from = "b", .to = "c", .after = 3s}}},
            fsm::ConfiguredMachine::Beginning{"b", 2s, "resumed"});
    CHECK(std::exchange(b.changes, {}) == Lines{">b: resumed"});
    b.loop.advance(999ms);
    CHECK(b.machine->now().state == "b");
    b.loop.advance(1ms);
    CHECK(b.machine->now().state == "c");
  }

  TEST_CASE("US-41 in the place of another, a machine acts on its state once, also while the card is waited for") {
    const fsm::MachineSettings settings{
        .name = "m",
        .start = "up",
        .states = {{.name = "up"}, {.name = "down"}},
        .transitions = {{.from = "up", .to = "down", .event = "go"}, {.from = "down", .to = "up", .event = "back"}},
        .resume = fsm::ResumeSettings{.recording = "r", .max_age = 1min, .wait = 10s}};
    Loop loop{Loop::Manual{}};
    std::vector<Callback<void()>> syncs;
    const auto sync = [&](Callback<void()> done) { syncs.push_back(std::move(done)); };
    Lines acted;
    std::optional<fsm::ConfiguredMachine> machine;
    const auto make = [&](const std::optional<fsm::ConfiguredMachine::Beginning>& beginning) {
      machine.reset();
      machine.emplace(loop, settings, beginning, sync);
      machine->on_state([&](std::string_view state) { acted.emplace_back(state); });
    };
    const auto reload = [&] {
      const fsm::ConfiguredMachine::Now now = machine->now();
      make(fsm::ConfiguredMachine::Beginning{std::string(now.state), 1s, "reloaded", machine->is_acted_on()});
    };
    make(std::nullopt);
    REQUIRE(syncs.size() == 1);
    CHECK_FALSE(machine->is_acted_on());
    syncs[0]();
    CHECK(machine->is_acted_on());
    CHECK(std::exchange(acted, {}) == Lines{"up"});
    machine->raise("go").or_throw();
    loop.advance(0ns);
    REQUIRE(syncs.size() == 2);
    reload();  // the card has not answered
    REQUIRE(syncs.size() == 3);
    syncs[1]();  // the one before has gone
    CHECK(acted.empty());
    syncs[2]();
    CHECK(std::exchange(acted, {}) == Lines{"down"});
    reload();
    reload();
    CHECK(machine->is_acted_on());
    CHECK(syncs.size() == 3);
    machine->raise("back").or_throw();
    loop.advance(11s);  // longer than it waits
    CHECK(syncs.size() == 4);
    CHECK(acted == Lines{"up"});
  }

  TEST_CASE("US-41 the schema knows machines, which need no type") {
    const std::string schema = standard_registry().schema();
    CHECK(schema.find("\"machines\"") != std::string::npos);
  }
}
