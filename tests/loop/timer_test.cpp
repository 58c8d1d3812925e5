#include "rtdata/loop/timer.hpp"

#include <doctest/doctest.h>

#include <cstdint>
#include <ctime>
#include <utility>
#include <vector>

using namespace rtdata;
using namespace rtdata::literals;

TEST_SUITE("loop") {
  TEST_CASE("US-43 a timer fires once, at its time, in any unit") {
    Loop loop(Loop::Manual{});
    std::vector<Duration> fired;
    const auto note = [&] { fired.push_back(loop.now().time_since_epoch()); };
    Timer ns(loop, 1500ns, note);
    Timer us(loop, 20us, note);
    Timer ms(loop, 3ms, note);
    Timer s(loop, 2s, note);
    loop.advance(1499ns);
    CHECK(fired.empty());
    loop.advance(1h);
    CHECK(fired == std::vector<Duration>{1500ns, 20us, 3ms, 2s});
    CHECK_FALSE(ns.is_running());
  }

  TEST_CASE("US-43 a stopped timer never fires again, until it is started again") {
    Loop loop(Loop::Manual{});
    int fired = 0;
    Timer timer(loop, 10ms, [&] { ++fired; });
    loop.advance(9ms);
    timer.stop();
    CHECK_FALSE(timer.is_running());
    loop.advance(1s);
    CHECK(fired == 0);
    timer.start(5ms);
    timer.start(7ms);  // restarts
    loop.advance(6ms);
    CHECK(fired == 0);
    loop.advance(1ms);
    CHECK(fired == 1);
    timer.stop();
    timer.stop();
    timer.start_at(loop.now() - 1s);
    loop.poll();
    CHECK(fired == 2);
  }

  TEST_CASE("US-43 timers due at one instant fire in order of creation, others in order of time") {
    Loop loop(Loop::Manual{});
    std::vector<int> order;
    Timer a(loop, 2ms, [&] { order.push_back(1); });
    Timer b(loop, 1ms, [&] { order.push_back(2); });
    Timer c(loop, 2ms, [&] { order.push_back(3); });
    loop.advance(2ms);
    CHECK(order == std::vector{2, 1, 3});
  }

  TEST_CASE("US-43 delays of zero, below zero and without end") {
    Loop loop(Loop::Manual{});
    int fired = 0;
    Timer zero(loop, 0ns, [&] { ++fired; });
    Timer negative(loop, -1h, [&] { ++fired; });
    Timer never(loop, Duration::max(), [&] { ++fired; });
    CHECK(fired == 0);
    loop.advance(0ns);
    CHECK(fired == 2);
    CHECK(never.is_running());
  }

  TEST_CASE("US-43 a timer that starts another due already does not keep others from firing") {
    Loop loop(Loop::Manual{});
    std::vector<int> order;
    int rounds = 0;
    Timer again(loop, [&] {
      order.push_back(1);
      if (++rounds < 20) again.start(0ns);
    });
    again.start(1ms);
    Timer other(loop, 1ms, [&] { order.push_back(2); });
    loop.advance(1ms);
    CHECK(rounds == 20);
    REQUIRE(order.size() == 21);
    CHECK(order[1] == 2);
  }

  TEST_CASE("US-43 a timer restarted or stopped from another's callback at the same instant") {
    Loop loop(Loop::Manual{});
    int fired = 0;
    Timer victim(loop, [&] { ++fired; });
    Timer first(loop, 1ms, [&] { victim.stop(); });
    victim.start(1ms);
    loop.advance(10ms);
    CHECK(fired == 0);
    first.start(1ms);
    victim.start(2ms);
    loop.advance(10ms);
    CHECK(fired == 0);
  }

  TEST_CASE("NFR-4 a ticker fires at start + n * period, first at the start") {
    Loop loop(Loop::Manual{});
    std::vector<Tick> ticks;
    Ticker ticker(loop, 10ms, [&](const Tick& tick) { ticks.push_back(tick); });
    loop.advance(30ms);
    REQUIRE(ticks.size() == 4);
    for (std::size_t i = 0; i < 4; ++i) {
      CHECK(ticks[i].due.time_since_epoch() == i * Duration{10ms});
      CHECK(ticks[i].lateness() == 0ns);
      CHECK(ticks[i].index == i);
    }
    CHECK(ticker.fired() == 4);
    CHECK(ticker.times().count == 4);
  }

  TEST_CASE("US-43 a ticker stops and starts any number of times, its sums go on") {
    Loop loop(Loop::Manual{});
    std::vector<std::uint64_t> indices;
    Ticker ticker(loop, 1ms, [&](const Tick& tick) { indices.push_back(tick.index); });
    loop.advance(1ms);
    ticker.stop();
    CHECK_FALSE(ticker.is_running());
    loop.advance(5ms);
    ticker.start();
    ticker.start();
    loop.advance(1ms);
    CHECK(indices == std::vector<std::uint64_t>{0, 1, 0, 1});
    CHECK(ticker.fired() == 4);
    CHECK(ticker.missed() == 0);
  }

  TEST_CASE("US-43 a period under 1 us is refused, and the loop goes on") {
    Loop loop(Loop::Manual{});
    CHECK_THROWS_AS(Ticker(loop, 999ns, [](const Tick&) {}), SetupError);
    Ticker ticker(loop, 1us, [](const Tick&) {});
    CHECK_THROWS_AS(ticker.set_period(0ns), SetupError);
    loop.advance(1us);
    CHECK(ticker.fired() == 2);
  }

  TEST_CASE("NFR-4 in real time no tick is early, and each is either fired or counted as missed") {
    Loop loop;
    bool early = false;
    std::uint64_t last = 0;
    Ticker ticker(loop, 1ms, [&](const Tick& tick) {
      early = early || tick.lateness() < 0ns;
      last = tick.index;
      if (last >= 100) loop.stop();
    });
    loop.run();
    CHECK_FALSE(early);
    CHECK(ticker.fired() + ticker.missed() == last + 1);
  }

  TEST_CASE("NFR-4 in real time there are as many ticks, fired or missed, as another clock has periods") {
    const auto boottime = [] {
      timespec now{};
      ::clock_gettime(CLOCK_BOOTTIME, &now);
      return Duration{now.tv_sec * std::int64_t{1'000'000'000} + now.tv_nsec};
    };
    Loop loop;
    Duration last{0};
    Duration look{0};  // the one before
    Duration made{0};
    const Duration before = boottime();
    Ticker ticker(loop, 1ms, [&](const Tick&) {
      look = std::exchange(last, boottime());
      if (look - made >= 500ms) loop.stop();
    });
    made = boottime();
    loop.run();
    // One at the start, between `before` and `made`, and one each period; those due at `look` have been counted.
    const auto counted = static_cast<std::int64_t>(ticker.fired() + ticker.missed());
    CHECK(counted > (look - made) / 1ms);
    CHECK(counted <= (last - before) / 1ms + 1);
  }
}
