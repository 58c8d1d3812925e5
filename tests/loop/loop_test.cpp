#include "rtdata/loop/loop.hpp"

#include <doctest/doctest.h>
#include <uv.h>

#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/timer.hpp"

using namespace rtdata;
using namespace rtdata::literals;

TEST_SUITE("loop") {
  TEST_CASE("run returns when nothing is left that could happen") {
    Loop loop;
    loop.run();
    int fired = 0;
    Timer timer(loop, 1ms, [&] { ++fired; });
    Ticker stopped(loop, 1ms, [](const Tick&) {});
    stopped.stop();
    loop.run();
    CHECK(fired == 1);
    timer.start(1h);
    timer.stop();
    loop.run();
    const auto subscription = loop.subscribe("#", [](const EventView&) {});
    loop.run();
    Loop manual(Loop::Manual{});
    Timer later(manual, 1h, [&] { ++fired; });
    manual.run();
    CHECK(fired == 2);
    CHECK(manual.now().time_since_epoch() == 1h);
  }

  TEST_CASE("run_for keeps running without work, and does what is due at the very end") {
    Loop loop;
    const auto begin = loop.now();
    loop.run_for(5ms);
    CHECK(loop.now() - begin >= 5ms);
    Loop manual(Loop::Manual{});
    int fired = 0;
    Timer timer(manual, 5ms, [&] { ++fired; });
    manual.run_for(5ms);
    CHECK(fired == 1);
    CHECK(manual.now().time_since_epoch() == 5ms);
  }

  TEST_CASE("stop ends a run, from a callback and from another thread") {
    Loop loop;
    Ticker ticker(loop, 1ms, [&](const Tick& tick) {
      if (tick.index >= 3) loop.stop();
    });
    loop.run();
    CHECK(ticker.fired() >= 1);
    std::thread other([&] { loop.stop(); });
    loop.run();
    other.join();
    loop.run_for(1ms);
  }

  TEST_CASE("stop before a run ends that run at once, and only that one") {
    Loop loop;
    int fired = 0;
    Timer timer(loop, 0ns, [&] { ++fired; });
    loop.stop();
    loop.run();
    CHECK(fired == 0);
    loop.run();
    CHECK(fired == 1);
    loop.stop();
    loop.run_for(1h);
    timer.start(3ms);
    loop.run();
    CHECK(fired == 2);
  }

  TEST_CASE("stop on a manual loop ends advance where it is") {
    Loop loop(Loop::Manual{});
    Ticker ticker(loop, 1ms, [&](const Tick& tick) {
      if (tick.index == 3) loop.stop();
    });
    loop.advance(1s);
    CHECK(loop.now().time_since_epoch() == 3ms);
    loop.advance(1ms);
    CHECK(ticker.fired() == 5);
  }

  TEST_CASE("posted functions run in order, on the loop's thread, from any thread") {
    Loop loop;
    constexpr int each = 200;
    std::vector<int> seen;
    std::thread::id ran_on;
    std::vector<std::thread> threads;
    Timer keeps_running(loop, 1h, [] {});
    for (int t = 0; t < 3; ++t) {
      threads.emplace_back([&, t] {
        for (int i = 0; i < each; ++i) {
          loop.post([&, t, i] {
            seen.push_back(t * each + i);
            ran_on = std::this_thread::get_id();
            if (seen.size() == 3 * each) loop.stop();
          });
        }
      });
    }
    loop.run();
    for (auto& thread : threads) thread.join();
    REQUIRE(seen.size() == 3 * each);
    CHECK(ran_on == std::this_thread::get_id());
    int last[3] = {-1, -1, -1};
    bool in_order = true;
    for (const int value : seen) {
      in_order = in_order && value > last[value / each];
      last[value / each] = value;
    }
    CHECK(in_order);
  }

  TEST_CASE("a function posted to a loop with nothing else to do runs") {
    int ran = 0;
    Loop loop;
    SUBCASE("in run") {
      loop.post([&] { loop.post([&] { ++ran; }); });
      loop.run();
    }
    SUBCASE("in poll") {
      loop.post([&] { ++ran; });
      loop.poll();
    }
    SUBCASE("on a manual loop") {
      Loop manual(Loop::Manual{});
      manual.post([&] { ++ran; });
      manual.advance(0ns);
    }
    CHECK(ran == 1);
  }

  TEST_CASE("a function that was posted and never run is destroyed with the loop") {
    auto token = std::make_shared<int>();
    const std::weak_ptr<int> seen = token;
    {
      Loop loop;
      loop.post([held = std::move(token)] { *held = 1; });
    }
    CHECK(seen.expired());
  }

  TEST_CASE("poll does what can be done now and does not wait") {
    Loop loop;
    int fired = 0;
    Timer now(loop, 0ns, [&] { ++fired; });
    Timer later(loop, 1h, [&] { ++fired; });
    loop.poll();
    loop.poll();
    CHECK(fired == 1);
  }

  TEST_CASE("running a loop from its own callback is refused") {
    Loop loop(Loop::Manual{});
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.why); });
    int refused = 0;
    Timer timer(loop, 1ms, [&] {
      const auto expect_refused = [&](auto&& call) {
        try {
          call();
        } catch (const SetupError& e) {
          if (e.error().code == Errc::busy) ++refused;
        }
      };
      expect_refused([&] { loop.run(); });
      expect_refused([&] { loop.advance(1ms); });
      expect_refused([&] { loop.poll(); });
      expect_refused([&] { loop.close(); });
      loop.run();  // thrown through the callback: reported
    });
    loop.advance(2ms);
    CHECK(refused == 4);
    CHECK(errors.size() == 1);
  }

  TEST_CASE("an idle loop with a 1 Hz ticker sleeps in between") {
    Loop loop;
    uv_prepare_t prepare;
    int turns = 0;
    uv_prepare_init(loop.uv(), &prepare);
    prepare.data = &turns;
    uv_prepare_start(&prepare, [](uv_prepare_t* handle) { ++*static_cast<int*>(handle->data); });
    const auto topic = loop.topic<int>("n");
    int delivered = 0;
    const auto subscription = topic.subscribe(loop, [&](const Event<int>&) { ++delivered; });
    Ticker ticker(loop, 1s, [&](const Tick&) { topic.publish(1); });
    loop.run_for(1100ms);
    CHECK(ticker.fired() + ticker.missed() == 2);
    CHECK(delivered == static_cast<int>(ticker.fired()));
    CHECK(turns <= 14);  // a few for each tick, delivery and the end
    uv_close(reinterpret_cast<uv_handle_t*>(&prepare), nullptr);
    loop.poll();
  }

  TEST_CASE("virtual time looks at handles of others from the moment that the loop of libuv is asked for") {
    Loop loop(Loop::Manual{});
    int ticks = 0, turns = 0;
    Ticker ticker(loop, 1ms, [&](const Tick&) { ++ticks; });
    loop.advance(10ms);
    CHECK(ticks == 11);
    uv_prepare_t prepare;
    uv_prepare_init(loop.uv(), &prepare);
    prepare.data = &turns;
    uv_prepare_start(&prepare, [](uv_prepare_t* handle) { ++*static_cast<int*>(handle->data); });
    loop.advance(10ms);
    CHECK(turns >= 10);
    uv_close(reinterpret_cast<uv_handle_t*>(&prepare), nullptr);
    loop.poll();
  }

  TEST_CASE("virtual time without anything of others: what is posted and a stop are seen at the next instant") {
    Loop loop(Loop::Manual{});
    std::vector<int> order;
    Ticker ticker(loop, 1ms, [&](const Tick& tick) {
      order.push_back(static_cast<int>(tick.index));
      if (tick.index == 2) loop.post([&] { order.push_back(100); });
      if (tick.index == 4) loop.stop();
    });
    loop.advance(10ms);
    CHECK(order == std::vector<int>{0, 1, 2, 100, 3, 4});
    loop.advance(2ms);
    CHECK(order.size() == 8);
  }

  TEST_CASE("errors go to on_error, which may throw and may set another; without one to the log") {
    Loop loop(Loop::Manual{});
    std::vector<std::string> log;
    loop.runtime().on_log([&](const LogRecord& record) { log.emplace_back(record.text); });
    std::vector<std::string> errors;
    Ticker bad(loop, {.period = 2s, .name = "bad"}, [](const Tick&) { throw std::runtime_error("no luck"); });
    loop.advance(0ns);
    REQUIRE(log.size() == 1);
    CHECK(log[0].find("no luck") != std::string::npos);
    loop.on_error([&](const ErrorReport& report) {
      errors.push_back(std::string(report.object) + ": " + std::string(report.error.id()));
      loop.on_error([&](const ErrorReport& next) {
        errors.push_back("second: " + std::string(next.object));
        throw 1;
      });
    });
    loop.advance(4s);
    CHECK(errors == std::vector<std::string>{"bad: handler-threw", "second: bad"});
    CHECK(log.size() == 2);
    CHECK(bad.fired() == 3);
  }

  TEST_CASE("handlers of errors and of the log may set another in their own place, or none") {
    Loop loop(Loop::Manual{});
    const std::string large(200, 'x');  // on the heap: a handler that is gone reads freed memory
    std::string seen;
    int logged = 0;
    SUBCASE("errors") {
      loop.runtime().on_log([&](const LogRecord&) { ++logged; });
      loop.on_error([&, large](const ErrorReport&) {
        loop.on_error({});
        seen = large;
      });
    }
    SUBCASE("log") {
      loop.runtime().on_log([&, large](const LogRecord&) {
        loop.runtime().on_log([&](const LogRecord&) { ++logged; });
        seen = large;
      });
    }
    Ticker bad(loop, {.period = 2s, .name = "bad"}, [](const Tick&) { throw std::runtime_error("no luck"); });
    loop.advance(1s);
    CHECK(seen == large);
    CHECK(logged == 0);
    loop.advance(2s);
    CHECK(logged == 1);
  }

  TEST_CASE("repeats of an error within a second are joined, and none is forgotten") {
    Loop loop(Loop::Manual{});
    std::uint64_t reports = 0;
    std::uint64_t counted = 0;
    loop.on_error([&](const ErrorReport& report) {
      ++reports;
      counted += report.count;
    });
    Ticker bad(loop, 1ms, [](const Tick&) { throw 1; });
    loop.advance(99ms);
    bad.stop();
    CHECK(reports == 1);
    loop.advance(1s);
    CHECK(reports == 2);
    CHECK(counted == 100);
  }

  TEST_CASE("a callback that holds the loop is reported by its name") {
    Loop loop(Loop::Manual{});
    std::vector<std::string> blamed;
    loop.on_error([&](const ErrorReport& report) {
      if (report.error.code == Errc::held_too_long) blamed.emplace_back(report.object);
    });
    Ticker slow(loop, {.period = 100ms, .name = "slow"}, [&](const Tick&) { loop.manual_clock().pass(11ms); });
    Ticker fine(loop, {.period = 100ms, .name = "fine"}, [&](const Tick&) { loop.manual_clock().pass(10ms); });
    loop.post([&] { loop.manual_clock().pass(20ms); });
    loop.advance(0ns);
    CHECK(blamed == std::vector<std::string>{"slow", "posted function"});
    CHECK(slow.times().max == 11ms);
  }

  TEST_CASE("advance and the manual clock are for manual loops") {
    Loop loop;
    CHECK_THROWS_AS(loop.advance(1ms), SetupError);
    CHECK_THROWS_AS(loop.manual_clock(), SetupError);
    CHECK_THROWS_AS(Loop(static_cast<uv_loop_t*>(nullptr)), SetupError);
  }
}
