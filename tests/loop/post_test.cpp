// What Loop::post accounts for, and that a flood of posted functions holds neither ticks nor the order.
#include <doctest/doctest.h>

#include <algorithm>
#include <cstdint>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/timer.hpp"

using namespace rtdata;
using namespace rtdata::literals;

TEST_SUITE("loop") {
  TEST_CASE("each posted function is counted: it was run, or it waits") {
    Loop loop(Loop::Manual{});
    const auto counts = [&] { return loop.runtime().loops().front().posts; };
    CHECK(counts().posted == 0);
    for (int i = 0; i < 3; ++i) loop.post([] {});
    std::thread([&] { loop.post([] {}); }).join();
    CHECK(counts().posted == 4);
    CHECK(counts().waiting() == 4);
    std::uint64_t waiting_within = 0;
    loop.post([&] { waiting_within = counts().waiting(); });
    loop.post([&] { loop.post([] {}); });
    loop.poll();
    CHECK(waiting_within == 1);
    CHECK(counts().posted == 7);
    CHECK(counts().run == 7);
    CHECK(counts().waiting() == 0);
    CHECK(counts().most_waiting == 6);
  }

  TEST_CASE("posted functions run for the budget of a turn, then ticks that came due come first, and none is lost") {
    Loop loop(Loop::Manual{}, {.delivery_budget = 2ms, .hold_limit = 1s});
    std::uint64_t missed = 0;
    std::vector<std::string> order;
    const Ticker ticker(loop, 5ms, [&](const Tick& tick) {
      missed += tick.missed;
      order.push_back("tick");
    });
    loop.advance(1ms);
    order.clear();
    for (int i = 0; i < 100; ++i) {
      loop.post([&loop, &order, i] {
        loop.manual_clock().pass(1ms);
        order.push_back(std::to_string(i));
      });
    }
    loop.poll();
    CHECK(loop.now().time_since_epoch() >= 100ms);
    CHECK(missed == 0);
    int next = 0, since_tick = 0, longest = 0;
    for (const std::string& one : order) {
      if (one == "tick") {
        since_tick = 0;
        continue;
      }
      CHECK(one == std::to_string(next++));
      longest = std::max(longest, ++since_tick);
    }
    CHECK(next == 100);
    CHECK(longest <= 6);  // a period, and what ran when the tick came due
  }

  TEST_CASE("what was posted before the end runs in it, though the loop was stopped; what is too late is reported") {
    for (const int takes : {1, 100}) {
      CAPTURE(takes);
      Loop loop(Loop::Manual{}, {.delivery_budget = 2ms, .hold_limit = 1s});
      std::vector<std::string> errors;
      loop.on_error([&](const ErrorReport& report) {
        if (report.error.code != Errc::held_too_long) errors.push_back(report.error.text());
      });
      int run = 0;
      for (int i = 0; i < 100; ++i) {
        loop.post([&] {
          loop.manual_clock().pass(std::chrono::milliseconds{takes});
          if (++run == 5) loop.stop();
        });
      }
      loop.run();
      CHECK(run < 100);
      CHECK(loop.close(2s) == 0);
      if (takes == 1) {
        CHECK(run == 100);
        CHECK(errors.empty());
      } else {
        REQUIRE(errors.size() == 1);
        CHECK(errors[0].find(" posted functions did not run before the end") != std::string::npos);
      }
    }
  }

  TEST_CASE("in real time, posted functions that one turn has left run in the next, before newer ones") {
    Loop loop({.delivery_budget = 1us});
    std::vector<int> order;
    for (int i = 0; i < 1000; ++i) {
      loop.post([&, i] {
        order.push_back(i);
        if (i == 0) loop.post([&] { order.push_back(1000); });
      });
    }
    loop.run();
    REQUIRE(order.size() == 1001);
    for (int i = 0; i <= 1000; ++i) CHECK(order[static_cast<std::size_t>(i)] == i);
  }

  TEST_CASE("a backlog of posted functions is reported") {
    Loop loop(Loop::Manual{});
    std::vector<std::string> reports;
    loop.on_error([&](const ErrorReport& report) {
      reports.push_back(std::string(report.error.id()) + ": " + std::string(report.object) + ": " + report.error.what);
    });
    std::size_t ran = 0;
    for (std::size_t i = 0; i < Loop::post_backlog; ++i) loop.post([&] { ++ran; });
    loop.poll();
    CHECK(ran == Loop::post_backlog);
    CHECK(reports.empty());
    for (std::size_t i = 0; i <= Loop::post_backlog; ++i) loop.post([&] { ++ran; });
    loop.poll();
    CHECK(ran == 2 * Loop::post_backlog + 1);
    CHECK(reports == std::vector<std::string>{"backlog: loop main: 10001 posted functions wait"});
  }

  TEST_CASE("a loop that stops in a posted function keeps the others for its next run") {
    Loop loop({.delivery_budget = 0us});
    int ran = 0;
    loop.post([&] { loop.stop(); });
    for (int i = 0; i < 10; ++i) loop.post([&] { ++ran; });
    loop.run();
    loop.run();
    CHECK(ran == 10);
    auto held = std::make_shared<int>();
    const std::weak_ptr<int> watched = held;
    {
      Loop ending({.delivery_budget = 0us});
      ending.post([&] { ending.stop(); });
      ending.post([held = std::move(held)] {});
      ending.run();
    }
    CHECK(watched.expired());
  }
}
