// A device that takes long to be opened or closed does so on its lane: nobody on the loop waits for it.
#include <doctest/doctest.h>

#include <atomic>
#include <memory>
#include <semaphore>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "loop/run_until.hpp"
#include "rtdata/detail/sensors/transaction.hpp"
#include "rtdata/loop/timer.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

struct Number {
  std::int64_t number = 0;
  RTDATA_FIELDS(Number, (number))
};

/// What has become of a device; shared with its transactions, which may outlive the sensor.
struct Seen {
  std::atomic<int> openings{0}, opened{0}, reads{0}, closed{0}, transactions{0};
  std::atomic<int> failing{0};  // so many openings fail
  std::atomic<std::thread::id> opened_on{}, closed_on{};
  std::binary_semaphore may_open{0};
  bool cannot_begin = false;
  std::atomic<bool> waits{false};  // for the semaphore, in the opening
};

struct SlowDevice final : detail::LaneDevice {
  explicit SlowDevice(std::shared_ptr<Seen> seen_, Duration limit_) : seen(std::move(seen_)), limit(limit_) {}
  struct Open final : detail::Transaction {
    explicit Open(std::shared_ptr<Seen> seen_) : seen(std::move(seen_)) {}
    void transact() noexcept override {
      ++seen->openings;
      seen->opened_on = std::this_thread::get_id();
      if (seen->waits) seen->may_open.acquire();
      is_there = seen->failing.fetch_sub(1) <= 0;
    }
    std::shared_ptr<Seen> seen;
    bool is_there = false;
  };
  struct Read final : detail::Transaction {
    explicit Read(std::shared_ptr<Seen> seen_) : seen(std::move(seen_)) { ++seen->transactions; }
    ~Read() override { --seen->transactions; }
    void transact() noexcept override { ++seen->reads; }
    void close() noexcept override {
      ++seen->closed;
      seen->closed_on = std::this_thread::get_id();
    }
    std::shared_ptr<Seen> seen;
  };
  std::shared_ptr<detail::Transaction> make_opening() override {
    if (seen->cannot_begin) throw std::runtime_error("not today");
    return std::make_shared<Open>(seen);
  }
  Result<void> take_opening(detail::Transaction& opening) override {
    if (!static_cast<Open&>(opening).is_there)
      return Error{Errc::not_found, "cannot open", "slow", "it is not there", ""};
    ++seen->opened;
    return {};
  }
  std::shared_ptr<detail::Transaction> make_transaction() override { return std::make_shared<Read>(seen); }
  detail::Sampled decode(detail::Transaction&, detail::SamplePort& port) override {
    Number number{seen->reads};
    port.publish(&number);
    return detail::Sampled::value;
  }
  std::string lane_key() const override { return "slow"; }
  Duration give_up_after() const override { return limit; }
  Error given_up_error() const override { return {Errc::timed_out, "no answer", "slow", "", ""}; }
  const std::shared_ptr<Seen> seen;
  const Duration limit;
};

struct SlowSensor : AnySensor {
  SlowSensor() = default;
  SlowSensor(Loop& loop, std::shared_ptr<Seen> seen, Duration limit = 10s, SensorConfig config = {.name = "slow"})
      : AnySensor(make(loop, std::move(seen), limit, std::move(config))) {}
  static detail::Node* make(Loop& loop, std::shared_ptr<Seen> seen, Duration limit, SensorConfig config) {
    if (!config.rate) config.rate = 10_Hz;
    return detail::make_sensor(loop, std::move(config), detail::payload_type<Number>(),
                               std::make_unique<SlowDevice>(std::move(seen), limit));
  }
};

/// A loop in virtual time on which 1 kHz is sampled, with what happens at 100 ms.
struct LaneOpeningBench {
  Loop loop{Loop::Manual{}};
  std::shared_ptr<Seen> seen = std::make_shared<Seen>();
  Sensor<Number> fast{loop, {.name = "fast", .rate = 1_kHz}, [] { return Number{1}; }};
  SlowSensor slow;
  std::vector<std::string> errors;
  Timer timer;

  LaneOpeningBench() {
    be_quiet(loop);
    loop.on_error(
        [this](const ErrorReport& report) { errors.push_back(std::string(report.object) + ": " + report.error.what); });
  }
  template <class Function>
  void at_100_ms(Function function) {
    timer = Timer(loop, 100ms, std::move(function));
  }
  /// Nobody has waited.
  void check_fast() {
    CHECK(fast.counts().missed == 0);
    CHECK(fast.counts().late == 0);
    CHECK(fast.counts().taken == fast.counts().scheduled);
    CHECK(loop.runtime().balances());
  }
};

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE(
      "NFR-1 US-7 a device whose opening takes a second is added while 1 kHz is sampled: no tick is missed or late") {
    LaneOpeningBench bench;
    bench.loop.script_lane_duration(1s);
    bench.at_100_ms([&] {
      bench.slow = SlowSensor(bench.loop, bench.seen);
      CHECK(bench.slow.is_running());
    });
    bench.loop.advance(1050ms);
    CHECK(bench.slow.is_running());
    CHECK(bench.slow.counts().scheduled == 0);  // nothing is owed while it is opened
    bench.loop.script_lane_duration(0ns);
    bench.loop.advance(1s);
    CHECK(bench.seen->openings == 1);
    CHECK(bench.slow.health() == Health::ok);
    CHECK(bench.slow.counts().taken == 10);  // at 1100 ms, and every 100 ms after it
    CHECK(bench.slow.counts().published == 10);
    CHECK(bench.slow.counts().missed + bench.slow.counts().failed == 0);
    CHECK(bench.errors.empty());
    bench.check_fast();
    CHECK(bench.fast.counts().taken == 2051);
  }

  TEST_CASE("NFR-1 US-8 a device is stopped, closed or drained while it is opened") {
    LaneOpeningBench bench;
    bench.loop.script_lane_duration(1s);
    bench.at_100_ms([&] { bench.slow = SlowSensor(bench.loop, bench.seen); });
    bench.loop.advance(500ms);
    SUBCASE("stopped, and started again") {
      bench.slow.stop();
      CHECK(!bench.slow.is_running());
      bench.loop.post([&] { bench.slow.start(); });  // its opening waits for the lane
      bench.loop.advance(700ms);
      CHECK(bench.seen->opened == 0);
      CHECK(bench.slow.is_running());
      bench.loop.advance(1s);
      CHECK(bench.seen->opened == 1);
      bench.loop.advance(2s);
      CHECK(bench.slow.counts().published > 0);
      bench.slow.stop();
      CHECK(bench.slow.counts().balances());
    }
    SUBCASE("closed") {
      bench.slow.close();
      bench.loop.advance(2s);
      CHECK(bench.seen->opened == 0);
      CHECK(bench.seen->reads == 0);
    }
    SUBCASE("its rate is changed") {
      bench.slow.set_rate(100_Hz);
      bench.loop.script_lane_duration(0ns);
      bench.loop.advance(700ms);
      CHECK(bench.slow.counts().taken == 11);
    }
    SUBCASE("drained") {
      CHECK(bench.loop.close(5s) == 0);
      CHECK(bench.loop.now().time_since_epoch() < 600ms);  // nobody waits for the opening
      CHECK(!bench.slow.is_running());
      CHECK(bench.seen->opened == 0);
    }
    bench.check_fast();
  }

  TEST_CASE("NFR-1 a device that cannot be opened while the loop runs is faulted, and opened again on its lane") {
    LaneOpeningBench bench;
    bench.seen->failing = 2;
    bench.loop.script_lane_duration(300ms);
    bench.at_100_ms(
        [&] { bench.slow = SlowSensor(bench.loop, bench.seen, 10s, {.name = "slow", .faulted_after = 2}); });
    bench.loop.advance(390ms);
    CHECK(bench.slow.health() == Health::ok);
    bench.loop.advance(20ms);  // it is not there
    CHECK(bench.slow.health() == Health::faulted);
    CHECK(bench.errors == std::vector<std::string>{"sensor slow: cannot open"});
    bench.loop.advance(2s);  // nor the second time; the third time it is, each time after 300 ms
    CHECK(bench.seen->openings == 3);
    CHECK(bench.slow.health() == Health::ok);
    CHECK(bench.slow.counts().published > 0);
    CHECK(bench.slow.counts().failed >= 6);  // also those that came due while it was opened
    bench.slow.stop();
    CHECK(bench.slow.counts().balances());
    bench.check_fast();
  }

  TEST_CASE("US-8 a sensor is closed by the one who is told that its opening cannot begin") {
    LaneOpeningBench bench;
    bench.slow = SlowSensor(bench.loop, bench.seen);
    bench.slow.stop();
    bench.seen->cannot_begin = true;
    bench.slow.on_error([&](const ErrorReport&) { bench.slow.close(); });
    bench.slow.start();
    CHECK_FALSE(bench.slow.is_open());
    bench.loop.advance(100ms);
    CHECK(bench.seen->openings == 1);
  }

  TEST_CASE("NFR-1 an opening that hangs is given up") {
    LaneOpeningBench bench;
    bench.loop.script_lane_duration(1h);
    bench.at_100_ms([&] { bench.slow = SlowSensor(bench.loop, bench.seen, 200ms); });
    bench.loop.advance(350ms);
    CHECK(bench.slow.health() == Health::faulted);
    CHECK(bench.errors == std::vector<std::string>{"sensor slow: no answer"});
    bench.loop.script_lane_duration(0ns);
    bench.loop.advance(1s);
    CHECK(bench.slow.health() == Health::ok);
    CHECK(bench.slow.counts().published > 0);
    bench.check_fast();
  }

  TEST_CASE("a program knows at its start which devices are missing, and a required one throws at any time") {
    LaneOpeningBench bench;
    bench.seen->failing = 1;
    bench.loop.script_lane_duration(10ms);
    bench.slow = SlowSensor(bench.loop, bench.seen, 1s);
    CHECK(bench.slow.health() == Health::faulted);
    CHECK(bench.errors == std::vector<std::string>{"sensor slow: cannot open"});
    bench.slow.close();
    bench.seen->failing = 1;
    CHECK_THROWS_WITH_AS(SlowSensor(bench.loop, bench.seen, 1s, {.name = "slow", .required = true}),
                         doctest::Contains("it is not there"), SetupError);
    bench.loop.script_lane_duration(1h);
    CHECK_THROWS_WITH_AS(SlowSensor(bench.loop, bench.seen, 1s, {.name = "slow", .required = true}),
                         doctest::Contains("no answer"), SetupError);
    bench.loop.script_lane_duration(0ns);
    bool has_thrown = false;
    bench.at_100_ms([&] {
      bench.seen->failing = 1;
      try {
        bench.slow = SlowSensor(bench.loop, bench.seen, 1s, {.name = "slow", .required = true});
      } catch (const SetupError&) {
        has_thrown = true;
      }
      bench.slow = SlowSensor(bench.loop, bench.seen, 1s, {.name = "slow", .required = true});
      CHECK(bench.slow.is_running());
    });
    bench.loop.advance(200ms);
    CHECK(has_thrown);
    CHECK(bench.slow.counts().published > 0);
  }

  TEST_CASE("NFR-1 on threads: the loop goes on while a device is opened, and it is closed on its lane") {
    const auto seen = std::make_shared<Seen>();
    seen->waits = true;
    Loop loop;
    be_quiet(loop);
    SlowSensor slow;
    int ticks = 0, ticks_while_opening = 0;
    loop.post([&] { slow = SlowSensor(loop, seen, 60s, {.name = "slow", .rate = 1_kHz}); });
    Ticker ticker(loop, 1ms, [&](const Tick&) {
      ++ticks;
      if (seen->openings == 1 && seen->opened == 0 && ++ticks_while_opening == 20) seen->may_open.release();
      if (seen->reads > 3 && slow.is_running()) slow.stop();
      if (seen->closed == 1) loop.stop();
    });
    loop.run();
    CHECK(ticks_while_opening >= 20);
    CHECK(seen->opened_on.load() != std::this_thread::get_id());
    CHECK(seen->closed_on.load() != std::this_thread::get_id());  // on which of the pool's is not promised
    CHECK(slow.counts().balances());
    loop.post([&] { slow.start(); });
    ticker.close();
    SUBCASE("it is closed while it is opened") {
      run_until(loop, [&] { return seen->openings == 2; });
      slow.close();
      seen->may_open.release();
      loop.run();  // until the lane has nothing to do
      CHECK(seen->opened == 1);
    }
    SUBCASE("it is opened again") {
      seen->may_open.release();
      const int before = seen->reads;
      run_until(loop, [&] { return seen->reads > before; });
      CHECK(seen->opened == 2);
      slow.close();
      loop.run();
      CHECK(seen->closed == 2);
      CHECK(seen->transactions == 0);
    }
    CHECK(loop.runtime().balances());
  }
}
