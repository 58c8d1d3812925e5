#include <doctest/doctest.h>

#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "loop/lane_sensor.hpp"
#include "loop/observed.hpp"
#include "rtdata/detail/sensors/transaction.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using observed::Number;

namespace {

using SlowSensor = lane_sensor::LaneSensor<Number>;

}  // namespace

TEST_SUITE("loop") {
  TEST_CASE("close without sensors or sinks, twice, then with objects made again") {
    Loop loop(Loop::Manual{});
    CHECK(loop.close() == 0);
    CHECK(loop.close() == 0);
    Feed<Number> feed(loop, {.name = "f"});
    feed.publish({});
    CHECK(loop.close() == 0);
    CHECK_FALSE(feed.is_running());
    feed.start();
    feed.publish({});
    CHECK(loop.close() == 0);
    CHECK(feed.counts().published == 2);
    CHECK(loop.runtime().balances());
    Loop real;
    real.stop();  // asked for after the run had ended: does not cut the drain short
    CHECK(real.close() == 0);
    CHECK(real.close() == 0);
  }

  TEST_CASE("ticks due before the end fire, and what they published is delivered") {
    Loop loop(Loop::Manual{});
    Sensor<Number> sensor(loop, {.name = "s", .rate = 100_Hz}, [] { return Number{}; });
    int delivered = 0;
    const auto subscription = loop.subscribe("#", [&](const EventView&) { ++delivered; });
    loop.advance(95ms);
    loop.manual_clock().pass(5ms);  // the tick at 100 ms is due and has not fired
    CHECK(loop.close() == 0);
    CHECK(delivered == 11);
    CHECK(sensor.counts().scheduled == 11);
    CHECK(sensor.counts().taken == 11);
    CHECK(subscription.counts().cancelled == 0);
    CHECK(loop.runtime().balances());
    loop.advance(1s);
    CHECK(delivered == 11);
  }

  TEST_CASE("reads under way on a lane finish and are published and delivered before the end") {
    Loop loop(Loop::Manual{});
    loop.script_lane_duration(30ms);
    SlowSensor sensor(loop, {.name = "slow", .rate = 10_Hz});
    int delivered = 0;
    const auto subscription = loop.subscribe("#", [&](const EventView&) { ++delivered; });
    loop.advance(110ms);
    CHECK(delivered == 1);
    CHECK(sensor.counts().in_flight == 1);
    CHECK(loop.close() == 0);
    CHECK(delivered == 2);
    CHECK(sensor.counts().taken == 2);
    CHECK(sensor.counts().in_flight == 0);
    CHECK(sensor.counts().scheduled == 2);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("reads that outlast the deadline are counted as failed") {
    Loop loop(Loop::Manual{});
    loop.script_lane_duration(500ms);
    SlowSensor sensor(loop, {.name = "slow", .rate = 1_Hz});
    loop.advance(10ms);
    CHECK(loop.close(100ms) == 0);
    CHECK(loop.now().time_since_epoch() <= 120ms);
    CHECK(sensor.counts().failed == 1);
    CHECK(sensor.counts().in_flight == 0);
    CHECK(loop.runtime().balances());
    loop.advance(1s);
    CHECK(sensor.counts().published == 0);
  }

  TEST_CASE("a device that throws while a read is prepared or decoded fails that read only") {
    struct Throwing final : detail::LaneDevice {
      struct Read final : detail::Transaction {
        void transact() noexcept override {}
      };
      explicit Throwing(int& made_) : made(made_) {}
      int& made;
      int decoded = 0;
      std::shared_ptr<detail::Transaction> make_transaction() override {
        if (++made == 1) throw std::runtime_error("not yet");
        return std::make_shared<Read>();
      }
      detail::Sampled decode(detail::Transaction&, detail::SamplePort& port) override {
        if (++decoded == 2) throw 7;
        Number number{1, 0};
        port.publish(&number);
        return detail::Sampled::value;
      }
      std::string lane_key() const override { return "throwing"; }
      Error given_up_error() const override { return {Errc::timed_out, "no answer", "", "", ""}; }
    };
    struct ThrowingSensor : AnySensor {
      ThrowingSensor(Loop& loop, int& made)
          : AnySensor(detail::make_sensor(loop, {.name = "throwing", .rate = 10_Hz}, detail::payload_type<Number>(),
                                          std::make_unique<Throwing>(made))) {}
    };
    Loop loop(Loop::Manual{});
    std::vector<std::string> errors;
    int made = 0;
    ThrowingSensor sensor(loop, made);
    sensor.on_error([&](const ErrorReport& report) { errors.push_back(report.error.what); });
    loop.advance(450ms);
    CHECK(errors == std::vector<std::string>{"preparing to read threw", "decoding threw"});
    CHECK(sensor.counts().failed == 2);
    CHECK(sensor.counts().published == 3);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("drain from a callback of a tick or a delivery counts that tick and ends later") {
    Loop loop(Loop::Manual{});
    int ended = 0;
    const auto drain = [&] { loop.drain(1s, [&](std::uint64_t lost) { ended += lost == 0 ? 1 : 100; }); };
    std::vector<Sensor<Number>> sensors;
    Subscription subscription;
    SUBCASE("a sensor's own, in the middle of its group") {
      for (int i = 0; i < 3; ++i) {
        sensors.push_back(Sensor<Number>(loop, {.name = "s" + std::to_string(i), .rate = 100_Hz}, [&, i] {
          if (i == 1 && loop.now().time_since_epoch() == 50ms) drain();
          return Number{};
        }));
      }
    }
    SUBCASE("a handler") {
      sensors.push_back(Sensor<Number>(loop, {.name = "s0", .rate = 100_Hz}, [] { return Number{}; }));
      subscription = loop.subscribe<Number>("s0", [&](const Event<Number>& e) {
        if (e.sequence == 6) drain();
      });
    }
    loop.advance(1s);
    CHECK(ended == 1);
    for (const auto& sensor : sensors) {
      CHECK(sensor.counts().taken == sensor.counts().scheduled);
      CHECK(sensor.counts().scheduled >= 6);
      CHECK(sensor.counts().scheduled <= 7);  // a handler's wish is met in the next turn
      CHECK_FALSE(sensor.is_running());
    }
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("stop cuts a close short, and the drain that goes on harms nobody") {
    Loop loop(Loop::Manual{});
    loop.script_lane_duration(500ms);
    SlowSensor sensor(loop, {.name = "slow", .rate = 1_Hz});
    loop.advance(10ms);
    Timer impatient(loop, 50ms, [&] { loop.stop(); });
    CHECK(loop.close() == 0);
    CHECK(loop.now().time_since_epoch() == 60ms);
    loop.advance(1s);
    CHECK(sensor.counts().taken == 1);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("a loop that goes in the middle of a drain drops it with all it holds") {
    auto token = std::make_shared<int>();
    const std::weak_ptr<int> seen = token;
    {
      Loop loop(Loop::Manual{});
      loop.script_lane_duration(500ms);
      SlowSensor sensor(loop, {.name = "slow", .rate = 1_Hz});
      loop.advance(10ms);
      loop.drain(1s, [held = std::move(token)](std::uint64_t) { *held = 1; });
      loop.advance(10ms);
      CHECK_FALSE(seen.expired());
    }
    CHECK(seen.expired());
  }
}
