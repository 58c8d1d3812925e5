// Tiers in virtual time: what happens on several loops is interleaved by a seed, and replayed by it.
#include <doctest/doctest.h>

#include <cstdint>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "loop/lane_sensor.hpp"
#include "loop/observed.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/topic.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using namespace std::chrono_literals;
using observed::Count;

namespace {

using Trace = std::vector<std::string>;

/// What happened, in order, on three loops that all do something at the same instants.
Trace traced(Loop::Manual manual) {
  Trace trace;
  Loop loop{manual};
  Tier fast(loop, {.name = "fast"});
  Tier slow(loop, {.name = "slow"});
  const auto note = [&](Loop& on, const std::string& what) {
    trace.push_back(std::to_string(on.now().time_since_epoch().count()) + " " + on.config().name + " " + what);
  };
  loop.script_lane_duration(3ms);
  Ticker a(fast.loop(), 2ms, [&](const Tick& tick) { note(fast.loop(), "tick " + std::to_string(tick.index)); });
  Ticker b(slow.loop(), 2ms, [&](const Tick& tick) { note(slow.loop(), "tick " + std::to_string(tick.index)); });
  Ticker c(loop, 2ms, [&](const Tick& tick) { note(loop, "tick " + std::to_string(tick.index)); });
  std::int64_t next = 0;
  Sensor<Count> sensor(fast.loop(), {.name = "s", .topic = "t", .rate = 250_Hz}, [&] { return Count{++next}; });
  lane_sensor::LaneSensor<Count> on_lane(loop, {.name = "l", .topic = "t", .rate = 100_Hz});
  const auto seen = [&](Loop& on) {
    return
        [&](const Event<Count>& event) { note(on, std::string(event.origin) + " " + std::to_string(event.sequence)); };
  };
  auto here = loop.subscribe<Count>("t", seen(loop));
  auto there = slow.loop().subscribe<Count>("t", seen(slow.loop()));
  loop.advance(50ms);
  loop.close();
  return trace;
}

}  // namespace

TEST_SUITE("loop") {
  TEST_CASE("the same seed interleaves a main loop, its tiers and lanes in the same way, others in other ways") {
    for (const std::uint64_t seed : {0U, 1U, 77U}) CHECK(traced({.seed = seed}) == traced({.seed = seed}));
    std::set<Trace> all;
    for (std::uint64_t seed = 0; seed < 10; ++seed) all.insert(traced({.seed = seed}));
    CHECK(all.size() == 10);
    CHECK(traced({.seed = 3, .jitter = 0s}) != traced({.seed = 3}));
  }

  TEST_CASE("whatever the seed, all that tiers publish in virtual time crosses, in order") {
    for (std::uint64_t seed = 0; seed < 20; ++seed) {
      CAPTURE(seed);
      Loop loop{Loop::Manual{.seed = seed}};
      Tier fast(loop, {.name = "fast"});
      Tier slow(loop, {.name = "slow"});
      std::uint64_t wrong = 0, on_main = 0, on_slow = 0, echoed = 0;
      Feed<Count> feed(fast.loop(), {.name = "f"});
      Feed<Count> echo(slow.loop(), {.name = "echo"});
      Ticker ticker(fast.loop(), 1ms, [&](const Tick&) {
        for (int i = 0; i < 10; ++i) feed.publish({i});
      });
      auto here = loop.subscribe<Count>("f", [&](const Event<Count>& event) { wrong += event.sequence != ++on_main; });
      auto there = slow.loop().subscribe<Count>("f", [&](const Event<Count>& event) {
        wrong += event.sequence != ++on_slow;
        echo.publish(*event);
      });
      auto back = fast.loop().subscribe<Count>("echo",
                                               [&](const Event<Count>& event) { wrong += event.sequence != ++echoed; });
      loop.advance(100ms);
      fast.call([&](Loop&) { ticker.stop(); });
      const std::uint64_t published = feed.counts().published;
      CHECK(published >= 1000);
      loop.advance(10ms);  // what is under way
      CHECK(on_main == published);
      CHECK(on_slow == published);
      CHECK(echoed == published);
      CHECK(wrong == 0);
      CHECK(loop.close() == 0);
      CHECK(loop.runtime().balances());
    }
  }

  TEST_CASE("without a seed, what tiers send at the end of an advance has been taken when it returns") {
    Loop loop{Loop::Manual{}};
    Tier fast(loop, {});
    std::uint64_t seen = 0;
    Sensor<Count> sensor(fast.loop(), {.name = "s", .rate = 1_kHz}, [] { return Count{}; });
    auto subscription = loop.subscribe<Count>("s", [&](const Event<Count>&) { ++seen; });
    loop.advance(0s);
    for (int i = 1; i <= 50; ++i) {
      loop.advance(1ms);
      CHECK(seen == fast.call([&](Loop&) { return sensor.counts().published; }));
    }
    CHECK(seen >= 50);
    const MonotonicTime before = loop.now();
    CHECK(before == MonotonicTime{50ms});
  }

  TEST_CASE("with a seed, a message and a lane's job take at most the jitter longer, some of them nothing") {
    std::set<Duration> delays, reads;
    for (std::uint64_t seed = 1; seed < 20; ++seed) {
      Loop loop{Loop::Manual{.seed = seed, .jitter = 300us}};
      Tier fast(loop, {});
      loop.script_lane_duration(2ms);
      Feed<Count> feed(fast.loop(), {.name = "f"});
      Timer timer(fast.loop(), 5ms, [&] { feed.publish({fast.loop().now().time_since_epoch().count()}); });
      auto subscription = loop.subscribe<Count>(
          "f", [&](const Event<Count>& event) { delays.insert(loop.now() - MonotonicTime{Duration{event->number}}); });
      lane_sensor::LaneSensor<Count> sensor(loop, {.name = "l", .rate = 10_Hz});
      auto on_read = loop.subscribe<Count>("l",
                                           [&](const Event<Count>&) { reads.insert(loop.now() - MonotonicTime{}); });
      loop.advance(20ms);
    }
    CHECK(*delays.begin() == 0s);
    CHECK(*delays.rbegin() > 0s);
    CHECK(*delays.rbegin() <= 300us);
    CHECK(delays.size() > 5);
    CHECK(*reads.begin() == 2ms);
    CHECK(*reads.rbegin() > 2ms);
    CHECK(*reads.rbegin() <= 2ms + 300us);
  }

  TEST_CASE("a callback that takes time in virtual time holds its own loop only") {
    for (const std::uint64_t seed : {0U, 5U}) {
      CAPTURE(seed);
      Loop loop{Loop::Manual{.seed = seed}, {.hold_limit = 1s}};
      loop.runtime().on_log([](const LogRecord&) {});  // the tier is waited for at the end
      Tier fast(loop, {.hold_limit = 1s});
      std::uint64_t on_fast = 0, on_main = 0, while_held = 0;
      Ticker quick(fast.loop(), 1ms, [&](const Tick&) { ++on_fast; });
      Ticker ticker(loop, 1ms, [&](const Tick& tick) {
        ++on_main;
        if (tick.index != 10) return;
        const std::uint64_t before = on_fast;
        const MonotonicTime from = loop.now();
        loop.manual_clock().pass(20ms);
        CHECK(loop.now() == from + 20ms);
        while_held = on_fast - before;
      });
      loop.advance(100ms);
      CHECK(while_held >= 19);
      CHECK(while_held <= 21);
      CHECK(on_fast >= 100);
      CHECK(on_main <= 82);
      CHECK(loop.now() == MonotonicTime{100ms});
      // A tier's costs the main loop nothing either.
      const std::uint64_t before = on_main;
      fast.loop().post([&] { loop.manual_clock().pass(1h); });
      loop.advance(50ms);
      CHECK(on_main >= before + 50);
      CHECK(loop.now() == MonotonicTime{150ms});
    }
  }

  TEST_CASE("a call to a tier that holds on is refused in virtual time, with the callback, and done once it turns") {
    Loop loop{Loop::Manual{}};
    std::vector<std::string> told;
    loop.runtime().on_log(
        [&](const LogRecord& record) { told.push_back(std::string(record.object) + ": " + std::string(record.text)); });
    Tier fast(loop, {.name = "fast", .hold_limit = 1h});
    Ticker ticker(fast.loop(), Ticker::Config{.period = 5ms, .name = "beat"}, [&](const Tick& tick) {
      if (tick.index == 1) fast.loop().manual_clock().pass(3s);
    });
    loop.advance(6ms);
    CHECK(told.empty());
    CHECK_THROWS_WITH_AS(fast.call([](Loop& on) { return on.now(); }), doctest::Contains("has not returned from beat"),
                         SetupError);
    CHECK_FALSE(told.empty());
    loop.advance(3s);
    CHECK(fast.call([](Loop& on) { return on.now(); }) >= MonotonicTime{3s + 5ms});
    CHECK_FALSE(fast.call([](Loop&) { return std::this_thread::get_id(); }) == std::this_thread::get_id());
    CHECK_THROWS_WITH(fast.call([](Loop&) { throw std::runtime_error("from the tier"); }), "from the tier");
  }

  TEST_CASE("a tier in virtual time stops, starts again, hangs and goes as one with a thread of its own does") {
    for (std::uint64_t seed = 0; seed < 10; ++seed) {
      CAPTURE(seed);
      Loop loop{Loop::Manual{.seed = seed}};
      loop.runtime().on_log([](const LogRecord&) {});
      Tier fast(loop, {.name = "fast", .hold_limit = 1h});
      Tier other(loop, {.name = "other"});
      std::uint64_t ticks = 0, others = 0;
      Ticker ticker(fast.loop(), 1ms, [&](const Tick&) { ++ticks; });
      const Ticker beat(other.loop(), 1ms, [&](const Tick&) { ++others; });
      loop.advance(10ms);
      CHECK(ticks >= 10);
      fast.stop();
      CHECK_FALSE(fast.is_running());
      const std::uint64_t at_stop = ticks;
      loop.advance(10ms);
      CHECK(ticks == at_stop);
      CHECK(fast.call([](Loop&) { return std::this_thread::get_id(); }) == std::this_thread::get_id());
      fast.start();
      loop.advance(10ms);
      CHECK(ticks >= at_stop + 10);
      fast.loop().post([&] { fast.loop().manual_clock().pass(2s); });
      loop.advance(2ms);
      const MonotonicTime before = loop.now();
      CHECK_FALSE(fast.stop_within(5ms));
      CHECK(loop.now() == before + 5ms);
      CHECK(fast.stop_within(1h));
      CHECK(loop.now() >= before + 1990ms);
      CHECK(others >= 2000);  // nobody else was held
      CHECK(loop.close() == 0);
      CHECK(loop.runtime().balances());
    }
  }

  TEST_CASE("a drain gives up a tier that hangs in virtual time, at the time that it has") {
    Loop loop{Loop::Manual{}};
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.what); });
    Tier fast(loop, {.name = "fast", .hold_limit = 10h});
    Feed<Count> feed(fast.loop(), {.name = "f"});
    fast.start();
    fast.loop().post([&] {
      feed.publish({1});
      fast.loop().manual_clock().pass(1h);
    });
    loop.advance(1ms);
    CHECK(loop.close(10s) == 0);
    CHECK(loop.now() < MonotonicTime{1min});
    REQUIRE(errors.size() == 1);
    CHECK(errors[0] == "did not stop in time");
    CHECK_FALSE(loop.runtime().balances());
    loop.advance(1h);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("run in virtual time ends by stop, from a tier too, and when no loop has anything left to do") {
    Loop loop{Loop::Manual{}};
    Tier fast(loop, {});
    {
      const Timer timer(fast.loop(), 1h, [&] { loop.stop(); });
      const Ticker ticker(loop, 1s, [](const Tick&) {});
      loop.run();
      CHECK(loop.now() >= MonotonicTime{1h});
      CHECK(loop.now() <= MonotonicTime{1h + 1s});
    }
    const MonotonicTime before = loop.now();
    std::uint64_t fired = 0;
    Timer last;
    fast.call([&](Loop& on) { last = Timer(on, 5s, [&] { ++fired; }); });
    loop.run();
    CHECK(fired == 1);
    CHECK(loop.now() == before + 5s);
  }

  TEST_CASE("loops that send to each other without end do not keep virtual time from going on") {
    for (const std::uint64_t seed : {0U, 4U}) {
      Loop loop{Loop::Manual{.seed = seed}};
      Tier fast(loop, {});
      Feed<Count> a(loop, {.name = "a"});
      Feed<Count> b(fast.loop(), {.name = "b"});
      std::uint64_t rounds = 0;
      auto here = loop.subscribe<Count>("b", [&](const Event<Count>&) { a.publish({}); });
      auto there = fast.loop().subscribe<Count>("a", [&](const Event<Count>&) {
        ++rounds;
        b.publish({});
      });
      loop.advance(0s);
      a.publish({});
      loop.advance(1ms);
      CHECK(rounds > 0);
      CHECK(loop.now() >= MonotonicTime{1ms});
      CHECK(loop.now() < MonotonicTime{3ms});
    }
  }
}
