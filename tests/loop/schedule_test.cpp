// Rate groups: what has the same period and phase shares a wake-up, and keeps its own account.
#include <doctest/doctest.h>

#include <memory>
#include <new>
#include <stdexcept>
#include <string>
#include <vector>

#include "loop/core/loop_core.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

struct Number {
  double value = 0;
  RTDATA_FIELDS(Number, (value, "1"))
};

Duration at(const Tick& tick) { return tick.due.time_since_epoch(); }

}  // namespace

TEST_SUITE("loop") {
  TEST_CASE("a schedule that cannot begin is told in its own words, and the others begin") {
    struct Member final : detail::RateMember {
      Member() : RateMember(10ms) {}
      void tick(const Tick&) override { ++ticks; }
      std::string blame_name() const override { return "member"; }
      void schedule_began() override {
        if (throws == 1) throw std::logic_error("two of one name");
        if (throws == 2) throw std::bad_alloc();
      }
      int throws = 0, ticks = 0;
    };
    Loop loop(Loop::Manual{});
    std::vector<std::string> told;
    loop.on_error(
        [&](const ErrorReport& report) { told.push_back(std::string(report.object) + ": " + report.error.why); });
    Member broken, without_memory, good;
    broken.throws = 1;
    without_memory.throws = 2;
    for (Member* member : {&broken, &without_memory, &good}) loop.core().schedule().add(*member);
    loop.advance(25ms);
    CHECK(told == std::vector<std::string>{"member: two of one name"});
    CHECK(good.ticks == 3);
    for (Member* member : {&broken, &without_memory, &good}) loop.core().schedule().remove(*member);
  }

  TEST_CASE("NFR-4 a million ticks without drift") {
    Loop loop(Loop::Manual{});
    MonotonicTime last{};
    bool exact = true;
    std::uint64_t count = 0;
    Ticker ticker(loop, 3ms, [&](const Tick& tick) {
      exact = exact && tick.due.time_since_epoch() == static_cast<std::int64_t>(count) * Duration{3ms} &&
              tick.lateness() == 0ns;
      ++count;
      last = tick.due;
    });
    loop.advance(3ms * 1'000'000 - 1ns);
    CHECK(count == 1'000'000);
    CHECK(exact);
    CHECK(last.time_since_epoch() == 3ms * 999'999);
  }

  TEST_CASE("NFR-4 late ticks are skipped and counted, never caught up in a burst; the grid stays") {
    Loop loop(Loop::Manual{});
    std::vector<Tick> ticks;
    Ticker ticker(loop, 10ms, [&](const Tick& tick) {
      ticks.push_back(tick);
      if (ticks.size() == 2) loop.manual_clock().pass(34ms);
    });
    loop.on_error([](const ErrorReport&) {});
    loop.advance(60ms);
    REQUIRE(ticks.size() == 5);
    CHECK(at(ticks[1]) == 10ms);
    CHECK(at(ticks[2]) == 40ms);  // begun at 44 ms: 20 and 30 were missed
    CHECK(ticks[2].missed == 2);
    CHECK(ticks[2].lateness() == 4ms);
    CHECK(ticks[2].index == 4);
    CHECK(at(ticks[3]) == 50ms);
    CHECK(ticker.fired() == 5);
    CHECK(ticker.missed() == 2);
  }

  TEST_CASE("NFR-4 one that is held up by another group is told when it really began, and is not blamed") {
    Loop loop(Loop::Manual{});
    std::vector<std::string> blamed;
    loop.on_error([&](const ErrorReport& report) { blamed.emplace_back(report.object); });
    Ticker slow(loop, {.period = 1s, .name = "slow"}, [&](const Tick&) { loop.manual_clock().pass(50ms); });
    std::vector<Tick> ticks;
    Ticker quick(loop, {.period = 10ms, .name = "quick"}, [&](const Tick& tick) { ticks.push_back(tick); });
    loop.advance(100ms);
    CHECK(blamed == std::vector<std::string>{"slow"});
    REQUIRE_FALSE(ticks.empty());
    CHECK(ticks[0].missed == 5);
    CHECK(at(ticks[0]) == 50ms);
    CHECK(quick.fired() + quick.missed() == 11);
    CHECK(quick.times().max == 0ns);
  }

  TEST_CASE("NFR-4 schedules start on the phase grid, and phases are added to it") {
    Loop loop(Loop::Manual{});
    loop.advance(300us);
    std::vector<Duration> a;
    std::vector<Duration> b;
    Ticker on_grid(loop, 10ms, [&](const Tick& tick) { a.push_back(at(tick)); });
    Ticker shifted(loop, {.period = 10ms, .phase = 2500us}, [&](const Tick& tick) { b.push_back(at(tick)); });
    loop.advance(20ms);
    CHECK(a == std::vector<Duration>{1ms, 11ms});
    CHECK(b == std::vector<Duration>{3500us, 13500us});
    Loop free(Loop::Manual{}, {.phase_grid = 0ns});
    free.advance(300us);
    Ticker off_grid(free, 10ms, [&](const Tick& tick) { a.push_back(at(tick)); });
    free.advance(1ms);
    CHECK(a.back() == 300us);
    Loop spinning(Loop::Manual{}, {.phase_grid = 3ms, .spin = 100us});
    spinning.advance(1500us);
    Ticker beside(spinning, 10ms, [&](const Tick& tick) { a.push_back(at(tick)); });
    spinning.advance(5ms);
    CHECK(a.back() == 4ms);
  }

  TEST_CASE("NFR-4 what is made long after in the same turn starts later") {
    Loop loop(Loop::Manual{});
    std::vector<Duration> a;
    Ticker first(loop, 1s, [](const Tick&) {});
    loop.manual_clock().pass(500ms);
    Ticker second(loop, 1s, [&](const Tick& tick) { a.push_back(at(tick)); });
    loop.advance(0ns);
    CHECK(a == std::vector<Duration>{500ms});
    CHECK(second.missed() == 0);
  }

  TEST_CASE("NFR-4 members are added, removed and replaced while their group fires") {
    Loop loop(Loop::Manual{});
    std::vector<int> order;
    std::vector<Ticker> tickers(5);
    for (int i = 0; i < 5; ++i) {
      tickers[static_cast<std::size_t>(i)] = Ticker(loop, 10ms, [&, i](const Tick& tick) {
        order.push_back(i);
        if (at(tick) != 10ms) return;
        if (i == 1) {
          tickers[0].close();  // has had its tick
          tickers[1].close();  // has it now
          tickers[2].close();  // has not had it
          tickers[4].stop();
          tickers[4].start();  // joins again: first due now
        }
      });
    }
    loop.advance(10ms);
    CHECK(order == std::vector{0, 1, 2, 3, 4, 0, 1, 3, 4});
    order.clear();
    loop.advance(20ms);
    CHECK(order == std::vector{3, 4, 3, 4});
  }

  TEST_CASE("NFR-4 members keep their order when most of them go, between ticks and before the first") {
    Loop loop(Loop::Manual{});
    std::vector<int> order;
    std::vector<Sensor<Number>> sensors;
    for (int i = 0; i < 100; ++i) {
      sensors.emplace_back(loop, SensorConfig{.name = "s" + std::to_string(i), .rate = 100_Hz}, [&, i] {
        order.push_back(i);
        return Number{};
      });
    }
    const auto stop_all_but = [&](int divisor) {
      for (std::size_t i = 0; i < sensors.size(); ++i) {
        if (i % static_cast<std::size_t>(divisor) != 0) sensors[i].stop();
      }
    };
    const auto is_in_order = [&](std::size_t ticks) {
      bool is = order.size() == ticks;
      for (std::size_t i = 1; i < order.size(); ++i) is = is && order[i] > order[i - 1];
      return is;
    };
    stop_all_but(2);
    loop.advance(0s);
    CHECK(is_in_order(50));
    order.clear();
    stop_all_but(20);
    for (std::size_t i = 0; i < 100; i += 25) sensors[i].close();  // 0 and 50 ticked, 25 and 75 were stopped
    loop.advance(10ms);
    CHECK(order == std::vector{20, 40, 60, 80});
    order.clear();
    sensors[10].start();  // at the end of the list, in a group of the same phase
    loop.advance(10ms);
    CHECK(order == std::vector{10, 20, 40, 60, 80, 10});
    std::vector<std::string> left;
    for (const SensorStatus& status : loop.runtime().sensors()) left.push_back(status.name);
    REQUIRE(left.size() == 96);
    CHECK(left[0] == "s1");
    CHECK(left[24] == "s26");
    CHECK(left[95] == "s99");
    sensors.clear();
    CHECK(loop.runtime().sensors().empty());
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("NFR-4 a group whose last member goes while it fires is gone, and can be made again") {
    Loop loop(Loop::Manual{});
    int fired = 0;
    std::vector<Ticker> tickers(3);
    for (auto& ticker : tickers) {
      ticker = Ticker(loop, 10ms, [&](const Tick&) {
        ++fired;
        tickers.clear();
      });
    }
    loop.advance(100ms);
    CHECK(fired == 1);
    Ticker again(loop, 10ms, [&](const Tick&) { ++fired; });
    loop.advance(10ms);
    CHECK(fired == 3);
  }

  TEST_CASE("NFR-4 a ticker made in the very turn in which others of its rate have ticked starts at once") {
    Loop loop(Loop::Manual{});
    Ticker late;
    std::vector<Duration> ticks;
    Ticker first(loop, 1h, [&](const Tick& tick) {
      if (at(tick) == 1h) late = Ticker(loop, 1h, [&](const Tick& t) { ticks.push_back(at(t)); });
    });
    loop.advance(2h);
    CHECK(ticks == std::vector<Duration>{1h, 2h});
    CHECK(first.fired() == 3);
  }

  TEST_CASE("US-43 a new period starts a new schedule; from the own callback a period later") {
    Loop loop(Loop::Manual{});
    std::vector<Duration> ticks;
    Ticker ticker(loop, 10ms, [&](const Tick& tick) {
      ticks.push_back(at(tick));
      if (at(tick) == 20ms) ticker.set_period(3ms);
    });
    loop.advance(27ms);
    CHECK(ticks == std::vector<Duration>{0ms, 10ms, 20ms, 23ms, 26ms});
    ticker.set_period(5ms);
    loop.advance(10ms);
    CHECK(ticks == std::vector<Duration>{0ms, 10ms, 20ms, 23ms, 26ms, 27ms, 32ms, 37ms});
    ticker.stop();
    ticker.set_period(1ms);
    loop.advance(10ms);
    CHECK(ticks.size() == 8);
    ticker.start();
    loop.advance(1ms);
    CHECK(ticks.size() == 10);
  }

  TEST_CASE("US-43 a period changed at every tick goes on forever") {
    Loop loop(Loop::Manual{});
    Ticker ticker(loop, 1ms, [&](const Tick& tick) {
      ticker.set_period(tick.index % 2 == 0 && at(tick) % 5ms != 0ns ? 2ms : 3ms);
    });
    loop.advance(1s);
    CHECK(ticker.fired() > 300);
    CHECK(ticker.fired() < 1000);
  }

  TEST_CASE("NFR-4 sensors of one group stopped while it fires late keep balanced accounts") {
    Loop loop(Loop::Manual{});
    loop.on_error([](const ErrorReport&) {});
    std::vector<Sensor<Number>> sensors(3);
    int reads = 0;
    for (int i = 0; i < 3; ++i) {
      sensors[static_cast<std::size_t>(i)] = Sensor<Number>(loop, {.name = "s" + std::to_string(i), .rate = 100_Hz},
                                                            [&, i] {
                                                              ++reads;
                                                              if (i == 0 && loop.now().time_since_epoch() >= 40ms) {
                                                                sensors[2].stop();
                                                                sensors[0].stop();
                                                              }
                                                              return Number{1};
                                                            });
    }
    loop.advance(20ms);
    CHECK(reads == 9);
    loop.manual_clock().pass(33ms);  // ticks at 30, 40 and 50 have come due
    loop.advance(0ns);
    CHECK(loop.runtime().balances());
    CHECK(sensors[0].counts().scheduled == 6);
    CHECK(sensors[2].counts().scheduled == 6);
    CHECK(sensors[2].counts().missed == 3);
    CHECK(sensors[1].counts().missed == 2);
    CHECK(sensors[1].counts().taken == 4);
    loop.advance(100ms);
    CHECK(reads == 9 + 2 + 10);
  }
}
