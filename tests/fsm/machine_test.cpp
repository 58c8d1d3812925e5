// Machines in virtual time.
#include "rtdata/fsm/machine.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "data/payloads.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"

using namespace rtdata;
using namespace std::chrono_literals;
using payloads::Climate;

namespace {

using Lines = std::vector<std::string>;

/// A machine whose actions and changes are written down.
struct Bench {
  Loop loop{Loop::Manual{}};
  Lines errors;
  Lines done;
  Lines changes;
  fsm::Machine machine;
  Subscription seen;

  explicit Bench(std::string failure = {}) {
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
    machine = fsm::Machine(loop, {.name = "m", .start = "a", .failure = std::move(failure)});
    seen = loop.subscribe<fsm::StateChange>("m", [this](const Event<fsm::StateChange>& e) {
      changes.push_back(std::string(e->from) + ">" + std::string(e->to) + ": " + std::string(e->cause));
    });
    for (const char* name : {"a", "b", "c"}) state(name);
  }
  void state(const std::string& name) {
    machine.add_state(name, {.arrive = [this, name] { done.push_back("arrive " + name); },
                             .leave = [this, name] { done.push_back("leave " + name); }});
  }
  /// So that the events that were published are delivered.
  Lines told() {
    loop.advance(0ns);
    return std::exchange(changes, {});
  }
};

}  // namespace

TEST_SUITE("fsm") {
  TEST_CASE("in real time, each of several events in a row may take a transition, and none is before the arrival") {
    constexpr std::uint64_t count = 50;
    Loop loop;
    Feed<Climate> feed(loop, {.name = "climate"});
    fsm::Machine machine(loop, {.name = "machine", .start = "a"});
    fsm::Input<Climate> climate(machine, "climate", 1h);
    Duration shortest = Duration::max();
    const auto look = [&](const fsm::Moment& moment) {
      shortest = std::min(shortest, moment.in_state);
      return static_cast<bool>(climate);
    };
    machine.add_state("a");
    machine.add_state("b");
    machine.add_transition({.from = "a", .to = "b", .when = look});
    machine.add_transition({.from = "b", .to = "a", .when = look});
    machine.start();
    for (std::uint64_t i = 0; i < count; ++i) feed.publish(Climate{});
    loop.poll();
    CHECK(machine.counts().events == count);
    CHECK(machine.counts().transitions == count);
    CHECK(shortest >= Duration{0});
  }

  TEST_CASE("US-39 a machine is in its start state from the start on, and its changes are events of its topic") {
    Bench b;
    CHECK(b.machine.state().empty());
    b.machine.add_transition({.from = "a", .to = "b", .on = "go"});
    b.machine.raise("go");  // not started
    CHECK(b.machine.counts().ignored == 1);
    b.machine.start();
    CHECK(b.machine.state() == "a");
    b.machine.start();  // nothing
    b.loop.advance(3s);
    CHECK(b.machine.in_state() == 3s);
    b.machine.raise("go");
    CHECK(b.machine.state() == "b");
    CHECK(b.machine.in_state() == 0s);
    CHECK(b.done == Lines{"arrive a", "leave a", "arrive b"});
    CHECK(b.told() == Lines{">a: start", "a>b: go"});
    CHECK(b.machine.counts().transitions == 1);
    CHECK(b.loop.runtime().balances());
    CHECK(b.errors.empty());
  }

  TEST_CASE("US-41 only the ways out of the current state are tried, in order, and one is taken") {
    Bench b;
    Lines asked;
    const auto ask = [&](const char* name, bool answer) {
      return [&asked, name, answer] {
        asked.emplace_back(name);
        return answer;
      };
    };
    b.machine.add_transition({.from = "a", .to = "b", .when = ask("1", false)});
    b.machine.add_transition({.from = "b", .to = "a", .when = ask("2", true)});
    b.machine.add_transition({.from = "a", .to = "b", .when = ask("3", true), .cause = "three"});
    b.machine.add_transition({.from = "a", .to = "c", .when = ask("4", true)});
    b.machine.start();
    b.machine.look();
    CHECK(asked == Lines{"1", "3"});
    CHECK(b.machine.state() == "b");
    CHECK(b.told() == Lines{">a: start", "a>b: three"});
  }

  TEST_CASE("US-40 a state is a class or functions; its check refuses an arrival") {
    Bench b;
    struct Coast final : fsm::State {
      explicit Coast(Lines& to) : lines(to) {}
      void arrive(const fsm::Moment& m) override { lines.push_back("arrive " + std::string(m.state)); }
      void leave(const fsm::Moment& m) override { lines.push_back("leave " + std::string(m.state)); }
      bool check(const fsm::Moment& m) override { return lines.push_back("check in " + std::string(m.state)), ready; }
      Lines& lines;
      bool ready = false;
    };
    auto made = std::make_unique<Coast>(b.done);
    Coast& coast = *made;
    b.machine.add_state("coast", std::move(made));
    b.machine.add_transition({.from = "a", .to = "coast"});
    b.machine.add_transition({.from = "coast", .to = "b", .on = "go"});
    b.machine.start();
    b.machine.look();
    CHECK(b.machine.state() == "a");
    coast.ready = true;
    b.machine.look();
    b.machine.raise("go");
    CHECK(b.done ==
          Lines{"arrive a", "check in a", "check in a", "leave a", "arrive coast", "leave coast", "arrive b"});
  }

  TEST_CASE("US-41 a way is taken after a time in the state, and not before") {
    Bench b;
    b.machine.add_transition({.from = "a", .to = "b", .after = 2s});
    b.machine.add_transition({.from = "b", .to = "c", .on = "go", .after = 1s});
    b.machine.start();
    b.loop.advance(1999ms);
    b.machine.look();
    CHECK(b.machine.state() == "a");
    b.loop.advance(1ms);
    CHECK(b.machine.state() == "b");
    b.machine.raise("go");  // too early
    CHECK(b.machine.state() == "b");
    b.loop.advance(1s);
    CHECK(b.machine.state() == "b");
    b.machine.raise("go");
    CHECK(b.machine.state() == "c");
    CHECK(b.told() == Lines{">a: start", "a>b: after 2 s", "b>c: go, after 1 s"});
  }

  TEST_CASE("US-41 an input that is slow does not begin a condition anew that was true without it meanwhile") {
    Bench b;
    Feed<Climate> one(b.loop, {.name = "one"});
    Feed<Climate> two(b.loop, {.name = "two"});
    fsm::Input<Climate> first(b.machine, "one", 500ms);
    fsm::Input<Climate> second(b.machine, "two", 500ms);
    b.machine.add_transition(
        {.from = "a", .to = "b", .when = [&] { return first && first->temperature > 3; }, .hold = 2s});
    b.machine.start();
    for (int i = 0; i < 22; ++i) {
      b.loop.advance(100ms);
      one.publish({.temperature = 5});
      if (i % 10 == 0) two.publish({.temperature = 5});
      b.loop.advance(0ns);
      CHECK(b.machine.state() == (i < 20 ? "a" : "b"));
    }
  }

  TEST_CASE("US-41 a condition on two topics, which must hold for a time; a stale input begins it anew") {
    Bench b;
    Feed<Climate> one(b.loop, {.name = "one"});
    Feed<Climate> two(b.loop, {.name = "two"});
    fsm::Input<Climate> first(b.machine, "one", 500ms);
    fsm::Input<Climate> second(b.machine, "two");
    b.machine.add_transition({.from = "a",
                              .to = "b",
                              .when = [&] { return first && second && first->temperature > second->temperature; },
                              .hold = 300ms});
    b.machine.start();
    const auto step = [&](double value) {
      b.loop.advance(100ms);
      one.publish({.temperature = value});
      b.loop.advance(0ns);
    };
    CHECK(first.age() == Duration::max());
    for (int i = 0; i < 9; ++i) step(5);
    CHECK(b.machine.state() == "a");  // nothing came of the other
    two.publish({.temperature = 3});
    b.loop.advance(0ns);
    step(5);
    step(1);  // interrupted
    step(5);
    step(5);
    step(5);
    CHECK(b.machine.state() == "a");
    b.loop.advance(600ms);
    CHECK_FALSE(first);
    CHECK(second);
    step(5);  // the first after a silence: what held before is not known to have held since
    step(5);
    step(5);
    CHECK(b.machine.state() == "a");
    step(5);
    CHECK(b.machine.state() == "b");
    CHECK(first.age() == 0s);
  }

  TEST_CASE("what holds for a time is counted on the events' line of time") {
    Bench b;
    Feed<Climate> feed(b.loop, {.name = "t"});
    fsm::Input<Climate> input(b.machine, "t");
    b.machine.add_transition({.from = "a", .to = "b", .when = [&] { return input->temperature > 1; }, .hold = 10s});
    b.machine.start();
    std::vector<Time> times;
    auto s = b.loop.subscribe<fsm::StateChange>("m",
                                                [&](const Event<fsm::StateChange>& e) { times.push_back(e.time); });
    const Time then = b.loop.time() + 100h;
    feed.publish({.temperature = 2}, then);
    feed.publish({.temperature = 2}, then + 10s);
    b.loop.advance(0ns);
    CHECK(b.machine.state() == "b");
    REQUIRE(times.size() == 1);
    CHECK(times[0] == then + 10s);
  }

  TEST_CASE("US-41 silence confirms nothing: time that passes, and a look, neither begin nor end what must hold") {
    Bench b;
    Feed<Climate> feed(b.loop, {.name = "t"});
    fsm::Input<Climate> input(b.machine, "t");
    const auto is_warm = [&] { return input->temperature > 3; };
    b.machine.add_transition({.from = "a", .to = "b", .when = is_warm, .hold = 2s});
    b.machine.add_transition({.from = "a", .to = "c", .when = [&] { return input->temperature > 100; }, .after = 4s});
    b.machine.add_transition({.from = "b", .to = "c", .when = is_warm, .hold = 1s, .after = 3s});
    const auto give = [&](double temperature, Duration after) {
      b.loop.advance(after);
      feed.publish({.temperature = temperature});
      b.loop.advance(0ns);
      return b.machine.state();
    };
    b.machine.start();
    CHECK(give(5, 1s) == "a");
    b.loop.advance(8s);  // with a look at 4 s
    b.machine.look();
    CHECK(b.machine.state() == "a");
    CHECK(give(0, 1s) == "a");
    CHECK(give(5, 1s) == "a");
    b.loop.advance(2s);
    b.machine.look();
    CHECK(b.machine.state() == "a");
    CHECK(give(5, 1ms) == "b");
    CHECK(b.told() == Lines{">a: start", "a>b: a condition, for 2 s"});
    b.loop.advance(3500ms);  // its `after` is over at 3 s
    CHECK(give(5, 1s) == "b");
    CHECK(give(5, 900ms) == "b");
    CHECK(give(5, 100ms) == "c");
  }

  TEST_CASE("US-41 an event that an action raises waits its turn; ten thousand are bounded, and counted") {
    Bench b;
    b.machine.add_state("busy", {.arrive = [&] {
                          for (int i = 0; i < 10'000; ++i) b.machine.raise("again");
                          b.done.push_back("in " + std::string(b.machine.state()));
                        }});
    b.machine.add_transition({.from = "a", .to = "busy", .on = "go"});
    b.machine.add_transition({.from = "busy", .to = "b", .on = "again"});
    b.machine.start();
    b.machine.raise("go");
    CHECK(b.done == Lines{"arrive a", "leave a", "in busy", "arrive b"});
    b.loop.advance(1ms);
    const fsm::MachineCounts counts = b.machine.counts();
    CHECK(counts.dropped == 10'000 - fsm::Machine::max_waiting);
    CHECK(counts.ignored == fsm::Machine::max_waiting - 1);  // those that came in b
    CHECK(b.errors.size() >= 1);
  }

  TEST_CASE("US-41 what is raised in the first arrival is taken; a look in an action comes after it") {
    Bench b;
    b.machine.add_state("first", {.arrive = [&] {
                          b.machine.raise("go");
                          b.machine.look();
                        }});
    b.machine.add_transition({.from = "first", .to = "b", .on = "go"});
    b.machine.add_transition({.from = "b", .to = "c", .cause = "seen"});
    b.machine.start_in("first");
    CHECK(b.told() == Lines{">first: start", "first>b: go", "b>c: seen"});
  }

  TEST_CASE("a way whose target may refuse it does not hide those behind it") {
    Bench b;
    b.machine.add_state("d", {.check = [] { return false; }});
    b.machine.add_transition({.from = "a", .to = "d"});
    b.machine.add_transition({.from = "a", .to = "b"});
    for (const fsm::GraphFault& fault : fsm::find_faults(b.machine.graph()))
      CHECK(fault.kind != fsm::GraphFault::Kind::never_taken);
    b.machine.start();
    b.machine.look();
    CHECK(b.machine.state() == "b");
  }

  TEST_CASE("US-41 a machine that raises events for ever does not hold its loop") {
    Bench b;
    std::size_t changes = 0;
    const auto again = [&] {
      ++changes;
      b.machine.raise("again");
    };
    b.machine.add_state("x", {.arrive = again});
    b.machine.add_state("y", {.arrive = again});
    b.machine.add_transition({.from = "a", .to = "x", .on = "go"});
    b.machine.add_transition({.from = "x", .to = "y", .on = "again"});
    b.machine.add_transition({.from = "y", .to = "x", .on = "again"});
    b.machine.start();
    b.seen.close();
    int ticks = 0;
    Ticker tick(b.loop, 1us, [&](const Tick&) {
      if (++ticks == 3) b.machine.close();
    });
    b.machine.raise("go");
    b.loop.advance(10us);
    CHECK(ticks == 11);
    CHECK(changes > fsm::Machine::max_waiting);
  }

  TEST_CASE("US-41 what throws is reported and leaves the machine in a defined state") {
    const auto thrower = [] { throw std::runtime_error("stuck valve"); };
    SUBCASE("leave: the change goes on") {
      Bench b;
      b.machine.add_state("x", {.leave = thrower});
      b.machine.add_transition({.from = "x", .to = "b", .on = "go"});
      b.machine.start_in("x");
      b.machine.raise("go");
      CHECK(b.machine.state() == "b");
      CHECK(b.done == Lines{"arrive b"});
      CHECK(b.machine.counts().failures == 1);
      REQUIRE(b.errors.size() == 1);
      CHECK(b.errors[0] == "an exception left: machine m, leave of state x: stuck valve");
    }
    SUBCASE("arrive: it is in the new state") {
      Bench b;
      b.machine.add_state("x", {.arrive = thrower});
      b.machine.add_transition({.from = "a", .to = "x", .on = "go"});
      b.machine.start();
      b.machine.raise("go");
      CHECK(b.machine.state() == "x");
    }
    SUBCASE("with a failure state: instead of the target, or from it") {
      Bench b("c");
      b.machine.add_state("x", {.arrive = thrower, .leave = thrower});
      b.machine.add_transition({.from = "a", .to = "x", .on = "go"});
      b.machine.start();
      b.machine.raise("go");
      CHECK(b.machine.state() == "c");
      CHECK(b.told() == Lines{">a: start", "a>x: go", "x>c: failure of arrive"});
      CHECK(b.machine.counts().failures == 2);

      Bench l("c");
      l.machine.add_state("x", {.leave = thrower});
      l.machine.add_transition({.from = "x", .to = "b", .on = "go"});
      l.machine.start_in("x");
      l.machine.raise("go");
      CHECK(l.told() == Lines{">x: start", "x>c: failure of leave"});
      CHECK(l.done == Lines{"arrive c"});
    }
    SUBCASE("the failure state stays") {
      Bench b("c");
      b.machine.start();
      CHECK_THROWS_AS(b.machine.remove_state("c"), SetupError);
    }
    SUBCASE("a condition: it is false") {
      Bench b;
      b.machine.add_transition({.from = "a", .to = "b", .when = []() -> bool { throw 7; }});
      b.machine.start();
      b.machine.look();
      CHECK(b.machine.state() == "a");
      CHECK(b.machine.counts().failures == 1);
    }
  }

  TEST_CASE("US-40 states and transitions come and go, also in the machine's own actions") {
    Bench b;
    b.machine.add_transition({.from = "a", .to = "b", .on = "go"});
    b.machine.add_transition({.from = "b", .to = "c", .on = "go"});
    std::string refused;
    b.machine.add_state("x", {.leave = [&] {
                          try {
                            b.machine.remove_state("x");
                          } catch (const SetupError& e) {
                            refused = e.what();
                          }
                        }});
    b.machine.add_state("y", {.arrive = [&] {
                          b.machine.remove_state("x");
                          b.machine.add_state("z");
                          b.machine.add_transition({.from = "y", .to = "z", .after = 1s});
                        }});
    b.machine.add_transition({.from = "x", .to = "y", .on = "go"});
    b.machine.start_in("x");
    CHECK_THROWS_AS(b.machine.remove_state("x"), SetupError);
    b.machine.raise("go");
    CHECK(refused.find("the machine is in it") != std::string::npos);
    b.loop.advance(1s);
    CHECK(b.machine.state() == "z");
    CHECK_THROWS_AS(b.machine.remove_state("x"), SetupError);  // gone
    CHECK(b.machine.remove_transitions("a", "b") == 1);
    CHECK(b.machine.remove_transitions("a", "b") == 0);
    b.machine.remove_state("c");
    for (const auto& edge : b.machine.graph().edges) CHECK(edge.on != "go");
    // A condition that removes its own way.
    b.machine.add_transition(
        {.from = "z", .to = "a", .when = [&] { return b.machine.remove_transitions("z", "a"), true; }});
    b.machine.look();
    CHECK(b.machine.state() == "z");
  }

  TEST_CASE("what is wrong is refused with the reason") {
    Bench b;
    const auto refusal = [](auto&& act) -> std::string {
      try {
        act();
      } catch (const SetupError& e) {
        return e.what();
      }
      return "taken";
    };
    auto& m = b.machine;
    CHECK(refusal([&] { m.add_state("a"); }).find("a state with this name already exists") != std::string::npos);
    CHECK(refusal([&] { m.add_state(""); }).find("empty") != std::string::npos);
    CHECK(refusal([&] { m.add_state(std::string(49, 'x')); }).find("longer than 48") != std::string::npos);
    CHECK(refusal([&] { m.add_state("n", nullptr); }).find("there is no state") != std::string::npos);
    m.add_state("boost");
    CHECK(refusal([&] { m.add_transition({.from = "a", .to = "bost"}); }).find("did you mean boost?") !=
          std::string::npos);
    CHECK(refusal([&] { m.add_transition({.from = "a", .to = "b", .hold = 1s}); }).find("`hold` without") !=
          std::string::npos);
    CHECK(refusal([&] { m.add_transition({.from = "a", .to = "b", .after = -1s}); }).find("negative") !=
          std::string::npos);
    CHECK(refusal([&] { m.start_in("d"); }).find("no state with this name") != std::string::npos);
    fsm::Machine other(b.loop, {.name = "other", .start = "on"});
    CHECK(refusal([&] { other.start(); }).find("no state with this name") != std::string::npos);
    CHECK(refusal([&] { fsm::Machine(b.loop, {.name = "m", .start = "a"}); }).find("m") != std::string::npos);
    m.add_transition({.from = "a", .to = "b", .on = "touchdown"});
    m.start();
    m.raise("tuchdown");
    REQUIRE(b.errors.size() == 1);
    CHECK(b.errors[0].find("did you mean touchdown?") != std::string::npos);
  }

  TEST_CASE("a machine is closed in its own action, and its input before or after it") {
    Bench b;
    Feed<Climate> feed(b.loop, {.name = "t"});
    auto input = std::make_unique<fsm::Input<Climate>>(b.machine, "t");
    fsm::Input<Climate> stays(b.machine, "t");
    b.machine.add_transition({.from = "a", .to = "b", .when = [&] { return input.reset(), true; }});
    b.machine.add_state("end", {.arrive = [&] { b.machine.close(); }});
    b.machine.add_transition({.from = "b", .to = "end"});
    b.machine.start();
    feed.publish({});
    b.loop.advance(0ns);
    CHECK(input == nullptr);
    b.machine.look();
    CHECK_FALSE(b.machine.is_open());
    CHECK(b.machine.state().empty());
    feed.publish({});
    b.loop.advance(0ns);
    CHECK_FALSE(stays);
    CHECK_THROWS_AS(fsm::Input<Climate>(b.machine, "t"), SetupError);
  }

  TEST_CASE("a machine stands still when its loop has drained, since no change would be recorded") {
    Bench b;
    b.machine.add_transition({.from = "a", .to = "b", .on = "go"});
    b.machine.start();
    CHECK(b.loop.close() == 0);
    b.machine.raise("go");
    CHECK(b.machine.state() == "a");
    CHECK(b.machine.counts().ignored == 1);
  }
}
