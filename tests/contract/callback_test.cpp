// What callbacks of the user's may do, each thing that once went wrong for itself. Whatever comes to nobody's mind:
// callback_contract_test.cpp.
#include <doctest/doctest.h>

#include <csignal>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "contract/at_end.hpp"
#include "loop/core/latch.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "rtdata/sinks/recording_writer.hpp"
#include "rtdata/sinks/sink.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using namespace std::chrono_literals;
using sinks::Number;

namespace {

const Error bad{Errc::bad_data, "cannot do it", "here", "the test says so", "nothing"};

/// A writer that keeps what it stores, and lets a test do something in each of its calls.
struct Told {
  int rows = 0;
  int writes = 0;
  int closes = 0;
  std::optional<Error> warning;
  bool refuses = false;
  int failures = 0;
  std::function<void()> in_write, in_add_topic, in_live_counts;
};
class ToldWriter final : public RecordingWriter {
 public:
  explicit ToldWriter(Told& told) : told_(told) {}
  Result<void> open() override { return {}; }
  Result<void> write(Batch& batch) override {
    ++told_.writes;
    if (told_.in_write) told_.in_write();
    if (told_.failures > 0) {
      --told_.failures;
      return bad;
    }
    for (const Record& record : batch) {
      if (std::exchange(told_.refuses, false)) {
        batch.refuse(record, bad);
      } else {
        ++told_.rows;
      }
    }
    return {};
  }
  Result<void> close() override {
    ++told_.closes;
    return {};
  }
  std::optional<Error> take_warning() override { return std::exchange(told_.warning, std::nullopt); }
  Result<void> add_topic(std::uint32_t, std::string_view, const Description&) override {
    if (told_.in_add_topic) told_.in_add_topic();
    return {};
  }
  LiveCounts* live_counts(std::uint32_t) override {
    if (told_.in_live_counts) told_.in_live_counts();
    return nullptr;
  }

 private:
  Told& told_;
};

SinkConfig small(std::string name = "s") { return {.name = std::move(name), .topics = {"#"}, .batch_rows = 100}; }

/// A device of which a test says what its calls do.
struct Device {
  std::function<Result<void>()> on_open = [] { return Result<void>{}; };
  std::function<Result<Number>()> on_read = [] { return Result<Number>{Number{1}}; };
  std::function<void()> on_close = [] {};
  Result<void> open() { return on_open(); }
  Result<Number> read() { return on_read(); }
  void close() { on_close(); }
};

}  // namespace

TEST_SUITE("contract") {
  TEST_CASE("a program that ends its run when space runs out loses nothing that can still be stored") {
    Told told;
    Loop loop;
    detail::Latch go_on;
    std::uint64_t lost = 1;
    Sink sink(loop, small(), std::make_unique<ToldWriter>(told));
    const auto topic = loop.topic<Number>("a");
    told.warning = bad;
    told.in_write = [&] {
      if (!told.warning) go_on.wait(1h);  // what follows the warning, until the loop has come out of the report
    };
    sink.on_error([&](const ErrorReport&) {
      for (int i = 0; i < 400; ++i) topic.publish({2});
      loop.drain(10s, [&](std::uint64_t count) {
        lost = count;
        loop.stop();
      });
      loop.post([&] { go_on.set(); });
    });
    for (int i = 0; i < 100; ++i) topic.publish({1});
    Timer limit(loop, 60s, [&] { loop.stop(); });
    loop.run();
    CHECK(lost == 0);
    CHECK(told.rows == 500);
    CHECK(told.closes == 1);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("the report of a sink holds for as long as its handler runs, whatever that does to the sink") {
    for (const char* kind : {"refusal", "warning", "failure"}) {
      for (const char* verb : {"flush", "drain", "close", "replace"}) {
        CAPTURE(kind);
        CAPTURE(verb);
        Told told;
        Told other;
        Loop loop{Loop::Manual{}};
        loop.script_lane_duration(1ms);
        Sink sink(loop, small(), std::make_unique<ToldWriter>(told));
        const auto topic = loop.topic<Number>("a");
        int reports = 0;
        sink.on_error([&](const ErrorReport& report) {
          if (++reports > 1) return;
          for (int i = 0; i < 150; ++i) topic.publish({2});
          const std::string does = verb;
          if (does == "flush") sink.flush();
          if (does == "drain") loop.drain(10s, [](std::uint64_t) {});
          if (does == "close") sink.close();
          if (does == "replace") sink = Sink(loop, small("t"), std::make_unique<ToldWriter>(other));
          CHECK(report.error.text().find("the test says so") != std::string::npos);
          CHECK(report.count == 1);
        });
        told.refuses = std::string(kind) == "refusal";
        if (std::string(kind) == "warning") told.warning = bad;
        told.failures = std::string(kind) == "failure" ? 1 : 0;
        for (int i = 0; i < 100; ++i) topic.publish({1});
        loop.advance(1s);
        CHECK(loop.close() == 0);
        CHECK(reports == 1);
        CHECK(told.rows == (std::string(kind) == "refusal" ? 249 : 250));
        CHECK(told.closes == 1);
        CHECK(loop.runtime().balances());
      }
    }
  }

  TEST_CASE("a device's close may close its own sensor") {
    for (const char* how : {"stopped", "closed", "faulted", "destroyed with the loop"}) {
      CAPTURE(how);
      const bool is_loop = std::string(how) == "destroyed with the loop";
      int closes = 0;
      std::optional<Sensor<Number>> sensor;
      std::vector<std::string> errors;
      {
        Loop loop{Loop::Manual{}};
        loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.what); });
        Device device;
        device.on_read = [&]() -> Result<Number> {
          if (std::string(how) == "faulted") return bad;
          return Number{1};
        };
        device.on_close = [&, big = std::string(100, 'x')] {
          ++closes;
          sensor.reset();
          CHECK(big == std::string(100, 'x'));  // it has not gone
        };
        sensor.emplace(loop, SensorConfig{.name = "s", .rate = 100_Hz}, std::move(device));
        loop.advance(5ms);
        if (std::string(how) == "stopped") sensor->stop();
        if (std::string(how) == "closed") sensor->close();
        loop.advance(50ms);
        CHECK(errors == std::vector<std::string>(std::string(how) == "faulted" ? 1 : 0,
                                                 "cannot do it"));  // the next two are joined
        CHECK(loop.runtime().balances());
        CHECK(sensor.has_value() == is_loop);
      }
      CHECK(closes == 1);
      CHECK(!sensor.has_value());
    }
  }

  TEST_CASE("a device's close may destroy another sensor while the loop closes") {
    Loop loop{Loop::Manual{}};
    std::optional<Sensor<Number>> one, other;
    Device device;
    device.on_close = [&] { other.reset(); };
    one.emplace(loop, SensorConfig{.name = "one", .rate = 100_Hz}, std::move(device));
    Device second;
    second.on_close = [&] { one.reset(); };
    other.emplace(loop, SensorConfig{.name = "other", .rate = 100_Hz}, std::move(second));
    loop.advance(50ms);
    CHECK(loop.close() == 0);
    CHECK(!other.has_value());
    CHECK(loop.runtime().balances());
  }

  TEST_CASE(
      "a writer may do nothing to the loop but post and stop: it is refused, and closing is done later and told") {
    for (const char* call : {"add_topic", "live_counts", "write"}) {
      CAPTURE(call);
      Told told;
      Told others;
      Loop loop{Loop::Manual{}};
      std::vector<std::string> errors;
      loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.id().data()); });
      std::optional<Sink> first, second;
      int refused = 0;
      int posted = 0;
      const auto all = [&] {
        const auto refuses = [&](const std::function<void()>& verb) {
          try {
            verb();
          } catch (const SetupError& e) {
            refused += e.error().code == Errc::busy ? 1 : 0;
          }
        };
        refuses([&] { Sink made(loop, small("made"), std::make_unique<ToldWriter>(others)); });
        refuses([&] { Timer made(loop, 1ms, [] {}); });
        refuses([&] { loop.topic<Number>("other"); });
        refuses([&] { loop.advance(1ms); });
        refuses([&] { loop.close(); });
        refuses([&] { loop.drain(1s, [](std::uint64_t) {}); });
        refuses([&] { first->flush(); });
        loop.post([&] { ++posted; });
        second.reset();
      };
      first.emplace(loop, small("first"), std::make_unique<ToldWriter>(told));
      second.emplace(loop, small("second"), std::make_unique<ToldWriter>(others));
      const auto once = [&, done = false]() mutable {
        if (!std::exchange(done, true)) all();
      };
      if (std::string(call) == "add_topic") told.in_add_topic = once;
      if (std::string(call) == "live_counts") told.in_live_counts = once;
      if (std::string(call) == "write") told.in_write = once;
      for (int i = 0; i < 100; ++i) loop.topic<Number>("a").publish({1});
      CHECK(refused == 7);
      CHECK(!second.has_value());
      loop.advance(10ms);
      CHECK(posted == 1);
      CHECK(errors == std::vector<std::string>{"busy"});
      CHECK(others.closes == 1);
      CHECK(others.rows == 100);  // it was there until the turn ended
      CHECK(loop.close() == 0);
      CHECK(told.rows == 100);
      CHECK(loop.runtime().balances());
    }
  }

  TEST_CASE("a handle that the old one's callback assigns again while it is assigned loses none of them") {
    Loop loop{Loop::Manual{}};
    Sensor<Number> sensor;
    Device device;
    device.on_close = [&] {
      sensor = Sensor<Number>(loop, {.name = "third", .rate = 100_Hz}, [] { return Number{3}; });
    };
    sensor = Sensor<Number>(loop, {.name = "first", .rate = 100_Hz}, std::move(device));
    loop.advance(15ms);
    sensor = Sensor<Number>(loop, {.name = "second", .rate = 100_Hz}, [] { return Number{2}; });
    CHECK(sensor.status().name == "third");
    CHECK(loop.runtime().sensors().size() == 1);  // none without a handle
    loop.advance(15ms);
    sensor.close();
    CHECK(loop.runtime().sensors().empty());
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("an object that a callback's captures own may be replaced by what it stands in") {
    struct Owner {
      Timer timer;
      std::string text = std::string(100, 'x');
    };
    Loop loop{Loop::Manual{}};
    auto owner = std::make_shared<Owner>();
    std::weak_ptr<Owner> seen = owner;
    owner->timer = Timer(loop, 1ms, [owner] {});
    Timer* const timer = &owner->timer;
    owner.reset();  // the captures alone hold it now
    *timer = Timer(loop, 1ms, [] {});
    CHECK(seen.expired());
    loop.advance(5ms);
  }

  TEST_CASE("setting a handler whose captures' destructor sets another keeps the last one") {
    Loop loop{Loop::Manual{}};
    int called = 0;
    loop.on_error(
        [end = AtEnd([&] { loop.on_error([&](const ErrorReport&) { called = 3; }); })](const ErrorReport&) {});
    loop.on_error([&](const ErrorReport&) { called = 2; });
    Timer timer(loop, 0s, [] { throw std::runtime_error("told"); });
    loop.advance(1ms);
    CHECK(called == 3);
  }

  TEST_CASE("a report that was kept for a loop is told to the log when that loop has gone") {
    ManualClock clock;
    Runtime runtime({.clock = &clock});
    std::vector<std::string> lines;
    runtime.on_log([&](const LogRecord& record) { lines.push_back(std::string(record.object)); });
    for (const bool with_next : {false, true}) {
      lines.clear();
      {
        Loop loop(runtime, {});
        runtime.core().keep_report(&loop.core(), with_next ? "a" : "b", bad);
      }
      Loop next(runtime, {});
      next.poll();
      CHECK(lines == std::vector<std::string>{with_next ? "a" : "b"});
    }
  }

  TEST_CASE("what destructors post while a loop goes is destroyed unrun") {
    int runs = 0;
    int ends = 0;
    {
      Loop loop{Loop::Manual{}};
      loop.post([&, end = AtEnd([&] {
                      ++ends;
                      for (int i = 0; i < 100; ++i) loop.post([&, end = AtEnd([&] { ++ends; })] { ++runs; });
                    })] { ++runs; });
    }
    CHECK(runs == 0);
    CHECK(ends == 101);
  }

  TEST_CASE("a name that was fed is not taken over by a schedule, nor the other way round") {
    Loop loop{Loop::Manual{}};
    Told told;
    Sink sink(loop, small(), std::make_unique<ToldWriter>(told));
    const auto refused = [](const std::function<void()>& make) {
      try {
        make();
      } catch (const SetupError& e) {
        return std::string(e.what()).find("earlier in this run it") != std::string::npos;
      }
      return false;
    };
    const SensorConfig sampled{.name = "x", .topic = "t", .rate = 100_Hz};
    {
      Sensor<Number> unused(loop, {.name = "x", .topic = "t", .rate = 100_Hz, .start = false}, [] { return Number{}; });
    }
    {
      Feed<Number> feed(loop, {.name = "x", .topic = "t"});  // nothing has come from the sensor
      feed.publish({1});
      feed.repeated();
    }
    CHECK(refused([&] { Sensor<Number> sensor(loop, sampled, [] { return Number{}; }); }));
    CHECK_NOTHROW(Feed<Number>(loop, {.name = "x", .topic = "t"}).publish({2}));
    {
      Sensor<Number> sensor(loop, {.name = "y", .topic = "t", .rate = 100_Hz}, [] { return Number{}; });
      loop.advance(25ms);
    }
    CHECK(refused([&] { Feed<Number>(loop, {.name = "y", .topic = "t"}); }));
    CHECK(loop.close() == 0);
    CHECK(loop.runtime().balances());
    CHECK(told.rows == 2 + 3);
  }

  TEST_CASE("time goes on in a manual loop, whatever brings itself on again at one instant") {
    Loop loop{Loop::Manual{}};
    Told told;
    Sink sink(loop, {.name = "s", .batch_rows = 50}, std::make_unique<ToldWriter>(told));
    const auto topic = loop.topic<Number>("a");
    std::uint64_t handled = 0;
    const Subscription subscription = topic.subscribe(loop, [&](const Event<Number>& event) {
      ++handled;
      topic.publish(event.data);
    });
    constexpr unsigned circling = 6;  // that come again and again; in ten rounds more than a batch
    for (unsigned i = 0; i < circling; ++i) topic.publish({1});
    loop.advance(1ms);
    CHECK(loop.now() == MonotonicTime{1ms});
    CHECK(handled >= 100 * circling);  // a hundred rounds an instant
    Timer timer;
    std::uint64_t fired = 0;
    timer = Timer(loop, 0s, [&] {
      ++fired;
      timer.start(0s);
    });
    loop.advance(1ms);
    CHECK(fired >= 1000);
    CHECK(loop.now() >= MonotonicTime{2ms});
    CHECK(loop.now() <= MonotonicTime{2ms + 2us});
    timer.close();
    CHECK(loop.close() == 0);
    CHECK(sink.counts().balances());
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("times and spans as long as can be said mean the end of time, which never comes") {
    Loop loop{Loop::Manual{}};
    Told told;
    int fired = 0;
    const auto count = [&] { ++fired; };
    const auto count_tick = [&](const Tick&) { ++fired; };
    Timer timer(loop, Duration::max(), count);
    Timer at_end(loop, count);
    at_end.start_at(MonotonicTime::max());
    Ticker ticker(loop, {.period = Duration::max(), .phase = Duration::max()}, count_tick);
    Ticker once(loop, {.period = Duration::max()}, count_tick);
    Sensor<Number> rare(loop,
                        {.name = "rare", .rate = Rate::from_period(Duration::max()), .late_after = Duration::max()},
                        [] { return Number{1}; });
    SensorConfig fails{.name = "fails", .rate = 100_Hz, .faulted_after = 1};
    fails.retry_first = fails.retry_longest = Duration::max();
    Sensor<Number> failing(loop, fails, [] { return Result<Number>(bad); });
    SinkConfig with = small();
    with.batch_time = with.retry_first = with.retry_longest = with.close_deadline = Duration::max();
    Sink sink(loop, with, std::make_unique<ToldWriter>(told));
    told.failures = 1;
    Feed<Number> feed(loop, {.name = "feed"});
    std::vector<Time> times;
    const Subscription seen = loop.topic<Number>("feed").subscribe(
        loop, [&](const Event<Number>& event) { times.push_back(event.time); });
    feed.publish({1}, Time::min());
    feed.publish({2}, Time::max());
    feed.publish({3}, Time::max());
    feed.publish({4});
    loop.advance(1s);
    CHECK(fired == 1);  // the ticker at its start
    CHECK(times.size() == 4);
    for (std::size_t i = 1; i < times.size(); ++i) CHECK(times[i - 1] < times[i]);
    CHECK(rare.counts().taken == 1);
    CHECK(failing.counts().failed == 101);
    loop.script_lane_duration(Duration::max());
    sink.flush();
    loop.script_lane_duration(0s);
    timer.start(Duration::min());
    ticker.set_period(Duration::max() - 1ns);
    rare.set_rate(Rate::from_period(Duration::max() - 1ns));
    loop.advance(Duration::min());
    failing.close();  // which would tick until the end of time
    ticker.close();
    once.close();
    rare.close();
    CHECK(loop.close(Duration::max()) == 0);
    CHECK(told.rows > 0);
    CHECK(loop.runtime().balances());
    loop.advance(Duration::max());
    loop.advance(Duration::max());
    CHECK(loop.now() == MonotonicTime::max());
    Sensor<Number> last(loop, {.name = "last", .rate = 100_Hz, .phase = 1h}, [] { return Number{1}; });
    Ticker too_late(loop, {.period = 1s}, count_tick);
    loop.topic<Number>("a").publish({1});
    loop.drain(Duration::min(), [](std::uint64_t) {});
    loop.advance(1s);
    CHECK(fired == 2);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("a phase before the start misses no tick: it is that within the first period") {
    Loop loop{Loop::Manual{}};
    std::vector<Tick> ticks;
    for (const Duration phase : {Duration{-1h}, Duration{-250ms}, Duration::min()}) {
      ticks.clear();
      const MonotonicTime from = loop.now();
      Sensor<Number> sensor(loop, {.name = "s", .rate = 1_Hz, .phase = phase}, [] { return Number{1}; });
      Ticker ticker(loop, {.period = 1s, .phase = phase}, [&](const Tick& tick) { ticks.push_back(tick); });
      loop.advance(3s);
      CHECK(sensor.counts().missed == 0);
      CHECK(ticker.missed() == 0);
      REQUIRE(ticks.size() >= 3);
      CHECK(ticks.front().due >= from);
      CHECK(ticks.front().due < from + 1s);
      if (phase == -250ms) CHECK(ticks.front().due == from + 750ms);
      CHECK(loop.runtime().balances());
      sensor.close();
      loop.advance(1s);
    }
  }

  TEST_CASE("a payload whose constructor, or destructor, uses the topic that it is published on") {
    struct Meddler {
      std::function<void()>* moved = nullptr;
      std::function<void()>* gone = nullptr;
      explicit Meddler(std::function<void()>* m, std::function<void()>* g) : moved(m), gone(g) {}
      Meddler(Meddler&& other) : moved(other.moved), gone(std::exchange(other.gone, nullptr)) {
        if (moved != nullptr) (*moved)();
      }
      ~Meddler() {
        if (gone != nullptr) (*gone)();
      }
    };
    Loop loop{Loop::Manual{}};
    const auto topic = loop.topic<Meddler>("m");
    Subscription subscription;
    int handled = 0;
    int depth = 0;
    std::function<void()> nothing = [] {};
    std::function<void()> publishes = [&] {
      if (depth++ == 0) topic.publish(Meddler(&nothing, nullptr));
      --depth;
    };
    std::function<void()> replaces = [&] {
      subscription = topic.subscribe(loop, [&](const Event<Meddler>&) { ++handled; });
      topic.publish(Meddler(nullptr, nullptr));
    };
    subscription = topic.subscribe(loop, [&](const Event<Meddler>&) { ++handled; });
    topic.publish(Meddler(&publishes, nullptr));
    CHECK(subscription.counts().dropped == 1);  // published while the place was being filled
    topic.publish(Meddler(nullptr, &replaces));
    loop.advance(1ms);
    CHECK(handled == 3);
    CHECK(loop.runtime().balances());
    std::function<void()> throws = [] { throw std::runtime_error("does not move"); };
    int errors = 0;
    Sensor<Meddler> sensor(loop, {.name = "s", .topic = "m", .rate = 100_Hz},
                           [&] { return Meddler(&throws, nullptr); });
    sensor.on_error([&](const ErrorReport&) { ++errors; });
    loop.advance(25ms);
    CHECK(errors == 3);
    CHECK(sensor.counts().published == 3);  // and dropped by the subscription
    CHECK(subscription.counts().dropped == 3);
    CHECK(loop.runtime().balances());
    subscription.close();
  }

  TEST_CASE("what is to be called is given, or refused") {
    Loop loop{Loop::Manual{}};
    const auto topic = loop.topic<Number>("a");
    const auto refused = [](const std::function<void()>& verb) {
      try {
        verb();
      } catch (const SetupError& e) {
        return e.error().code == Errc::bad_argument;
      }
      return false;
    };
    CHECK(refused([&] { Timer made(loop, 1ms, nullptr); }));
    CHECK(refused([&] { Ticker made(loop, 1ms, nullptr); }));
    CHECK(refused([&] { FdWatch made(loop, 0, FdWatch::readable, nullptr); }));
    CHECK(refused([&] { SignalWatch made(loop, SIGUSR2, nullptr); }));
    CHECK(refused([&] { const auto made = topic.subscribe(loop, nullptr); }));
    CHECK(refused([&] { const auto made = loop.subscribe("#", Callback<void(const EventView&)>()); }));
    CHECK(refused([&] { loop.post(nullptr); }));
    CHECK(refused([&] { loop.drain(1s, nullptr); }));
    CHECK(refused([&] { Sink made(loop, small(), nullptr); }));
    CHECK_THROWS_AS(AnyFeed(loop, {.name = "f"}, nullptr), SetupError);
    CHECK_THROWS_AS(Callback<void()>()(), std::logic_error);
    Callback<void()> taken([] {});
    const Callback<void()> to(std::move(taken));
    CHECK(!taken);
    CHECK_THROWS_AS(taken(), std::logic_error);
    CHECK_THROWS_AS(Runtime({.ring_events = std::size_t(-1)}), SetupError);
    CHECK(loop.callbacks().empty());
    loop.advance(1s);
    CHECK(loop.close() == 0);
  }

  TEST_CASE("bytes of another size than the payload's are unreadable, and told") {
    Loop loop{Loop::Manual{}};
    int errors = 0;
    Feed<Number> feed(loop, {.name = "f"});
    feed.on_error([&](const ErrorReport& report) { errors += report.error.code == Errc::bad_data ? 1 : 0; });
    const std::byte few[3]{};
    feed.publish_bytes(few);
    feed.publish_bytes({}, Time{1s});
    CHECK(errors == 2);
    CHECK(feed.counts().unreadable == 2);
    CHECK(feed.counts().published == 0);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("a sensor that holds the loop, and whose device's close() closes it when it is stopped for that") {
    Loop loop{Loop::Manual{}};
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.what); });
    std::optional<Sensor<Number>> sensor;
    Device device;
    device.on_read = [&] {
      loop.manual_clock().pass(50ms);
      return Result<Number>{Number{1}};
    };
    device.on_close = [&] { sensor.reset(); };
    SensorConfig config{.name = "s", .rate = 10_Hz, .on_overrun = OnOverrun::stop};
    config.retry_first = config.retry_longest = Duration::min();
    sensor.emplace(loop, config, std::move(device));
    loop.advance(2s);  // the second error of the same kind is held back for a second
    CHECK(!sensor);
    REQUIRE(errors.size() == 2);
    CHECK(errors.back() == "stopped");
    CHECK(loop.runtime().balances());
    Sensor<Number> fails(loop, {.name = "t", .rate = 1_kHz, .faulted_after = 1, .retry_first = Duration::min()},
                         [] { return Result<Number>(bad); });
    loop.advance(10ms);
    CHECK(fails.counts().failed == 11);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("the destructor of a payload that nobody came to take cannot run its loop, which is being destroyed") {
    struct Payload {
      Payload(const std::function<void()>& in_destructor, int& alive_) : destroyed(in_destructor), alive(&alive_) {
        ++*alive;
      }
      Payload(Payload&& other) noexcept : destroyed(other.destroyed), alive(other.alive) { ++*alive; }
      ~Payload() {
        --*alive;
        destroyed();
      }
      const std::function<void()>& destroyed;
      int* alive;
    };
    int alive = 0;
    int refused = 0;
    std::function<void()> in_destructor = [] {};
    auto loop = std::make_unique<Loop>(Loop::Manual{});
    Loop& ending = *loop;
    const auto subscription = loop->topic<Payload>("p").subscribe(ending, [](const Event<Payload>&) {});
    for (int i = 0; i < 3; ++i) loop->topic<Payload>("p").publish(Payload(in_destructor, alive));
    CHECK(alive == 3);
    in_destructor = [&] {
      const std::function<void()> verbs[] = {
          [&] { ending.poll(); },      [&] { ending.run(); },   [&] { ending.advance(1s); },
          [&] { ending.run_for(1s); }, [&] { ending.close(); }, [&] { ending.drain(1s, [](std::uint64_t) {}); }};
      for (const auto& verb : verbs) {
        try {
          verb();
        } catch (const SetupError& error) {
          if (error.error().code == Errc::busy) ++refused;
        }
      }
    };
    loop = nullptr;
    CHECK(alive == 0);
    CHECK(refused == 3 * 6);
  }
}
