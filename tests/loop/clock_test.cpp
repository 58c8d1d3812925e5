// Times of events, while the time of day is set.
#include "rtdata/loop/clock.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <string>
#include <vector>

#include "loop/observed.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using observed::Number;

namespace {

/// Notes the pairs that a recording would hold.
struct Pairs final : detail::Recorder {
  std::vector<ClockPair> pairs;
  Result<void> on_topic(detail::TopicCore&) override { return {}; }
  void on_gap(detail::OriginCore&, const Gap&) override {}
  void on_segment(detail::OriginCore&, const Segment&) override {}
  void on_clock(const ClockPair& pair) override { pairs.push_back(pair); }
  void on_error(Time, Time, std::string_view, const Error&, std::uint64_t) override {}
  SinkStatus status() const override { return {}; }
  const std::string& name() const noexcept override { return name_; }
  SinkCounts counts() const noexcept override { return {}; }
  const std::string name_;
  void drain(MonotonicTime, Callback<void(std::uint64_t)> done) override { done(0); }
};

/// The machine's monotonic clock with a time of day that can be set.
struct SettableClock final : SystemClock {
  Duration offset{0};
  Time realtime() noexcept override { return SystemClock::realtime() + offset; }
  std::optional<Duration> accuracy() noexcept override { return std::nullopt; }
};

}  // namespace

TEST_SUITE("loop") {
  TEST_CASE("event times never repeat or go back while the time of day is set, and each step is recorded") {
    ManualClock clock(Time{1s});  // 1970, as boards without a battery start
    Runtime runtime({.clock = &clock});
    Loop loop(runtime, {});
    Pairs recorder;
    runtime.core().attach(recorder);
    runtime.on_log([](const LogRecord&) {});
    std::vector<Time> times;
    Sensor<Number> sensor(loop, {.name = "s", .rate = 100_Hz}, [] { return Number{}; });
    const auto subscription = loop.subscribe("s", [&](const EventView& e) { times.push_back(e.time()); });
    loop.advance(1s);
    clock.set_realtime(Time{1'700'000'000s});
    loop.advance(1s);
    clock.set_realtime(clock.realtime() - 1h);
    loop.advance(1s);
    clock.set_realtime(clock.realtime() + 1h);
    loop.advance(1s);
    REQUIRE(times.size() == 401);
    bool exact = true;
    for (std::size_t i = 0; i < times.size(); ++i) exact = exact && times[i] == Time{1s + i * Duration{10ms}};
    CHECK(exact);
    REQUIRE(recorder.pairs.size() == 3);
    for (std::size_t i = 0; i < 3; ++i) {
      CHECK(std::string(recorder.pairs[i].occasion) == "step");
      CHECK(recorder.pairs[i].monotonic.time_since_epoch() == (i + 1) * Duration{1s});
    }
    CHECK(recorder.pairs[0].realtime == Time{1'700'000'000s});
    CHECK(recorder.pairs[1].realtime - recorder.pairs[0].realtime == 1s - 1h);
    CHECK(recorder.pairs[2].realtime - recorder.pairs[1].realtime == 1s + 1h);
    CHECK_FALSE(runtime.core().clock_log.look());
    CHECK(runtime.core().clock_log.look("regular"));
    CHECK(std::string(recorder.pairs.back().occasion) == "regular");
    loop.close();
    CHECK(std::string(recorder.pairs.back().occasion) == "end");
    runtime.core().detach(recorder);
  }

  TEST_CASE("an event exactly at the epoch, or before it, keeps its time") {
    ManualClock clock(Time{-1s});
    Runtime runtime({.clock = &clock});
    Loop loop(runtime, {});
    const auto topic = loop.topic<Number>("t");
    std::vector<Time> times;
    const auto subscription = topic.subscribe(loop, [&](const Event<Number>& e) { times.push_back(e.time); });
    topic.publish({});
    loop.advance(1s);
    topic.publish({});
    loop.poll();
    CHECK(times == std::vector<Time>{Time{-1s}, Time{}});
  }

  TEST_CASE("the time of day is recorded once in a while as long as somebody keeps it right, and when that changes") {
    ManualClock clock;
    Runtime runtime({.clock = &clock});
    Loop loop(runtime, {});
    Pairs recorder;
    runtime.core().attach(recorder);
    runtime.on_log([](const LogRecord&) {});
    Ticker seconds(loop, 1s, [](const Tick&) {});
    loop.advance(30min);
    CHECK(recorder.pairs.empty());  // nobody does
    clock.set_accuracy(20ms);
    loop.advance(1h);
    REQUIRE(recorder.pairs.size() == 6);
    CHECK(std::string(recorder.pairs[0].occasion) == "sync");
    CHECK(recorder.pairs[0].accuracy == 20ms);
    for (std::size_t i = 1; i < 6; ++i) {
      CHECK(std::string(recorder.pairs[i].occasion) == "regular");
      CHECK(recorder.pairs[i].monotonic - recorder.pairs[i - 1].monotonic == 10min);
    }
    clock.set_accuracy(10ms);  // twice as good
    loop.advance(20s);
    REQUIRE(recorder.pairs.size() == 7);
    CHECK(recorder.pairs[6].accuracy == 10ms);
    clock.set_accuracy(7ms);
    loop.advance(20s);
    CHECK(recorder.pairs.size() == 7);
    clock.set_accuracy({});
    loop.advance(1h);
    REQUIRE(recorder.pairs.size() == 8);
    CHECK(std::string(recorder.pairs[7].occasion) == "sync");
    CHECK(recorder.pairs[7].accuracy == std::nullopt);
    runtime.core().detach(recorder);
  }

  TEST_CASE("a clock that was right and steps: where it stood before is recorded too") {
    ManualClock clock;
    clock.set_accuracy(20ms);
    Runtime runtime({.clock = &clock});
    Loop loop(runtime, {});
    Pairs recorder;
    runtime.core().attach(recorder);
    runtime.on_log([](const LogRecord&) {});
    Ticker seconds(loop, 1s, [](const Tick&) {});
    loop.advance(5min);
    clock.set_realtime(clock.realtime() - 1s);  // 23:59:60
    loop.advance(1s);
    REQUIRE(recorder.pairs.size() == 2);
    CHECK(std::string(recorder.pairs[0].occasion) == "regular");
    CHECK(std::string(recorder.pairs[1].occasion) == "step");
    CHECK(recorder.pairs[1].monotonic - recorder.pairs[0].monotonic <= 1s);
    CHECK(recorder.pairs[1].realtime - recorder.pairs[0].realtime <= Duration{0});
    runtime.core().detach(recorder);
  }

  TEST_CASE("a suspension of the computer is noted as such, and not as a clock that was set") {
    ManualClock clock;
    Runtime runtime({.clock = &clock});
    Loop loop(runtime, {});
    Pairs recorder;
    runtime.core().attach(recorder);
    std::string log;
    runtime.on_log([&](const LogRecord& record) { log += std::string(record.text) + "\n"; });
    Sensor<Number> sensor(loop, {.name = "s", .rate = 1_Hz}, [] { return Number{}; });
    loop.advance(10s);
    CHECK(recorder.pairs.empty());
    clock.suspend(8h);
    clock.suspend(-1h);  // nothing
    loop.advance(10s);
    REQUIRE(recorder.pairs.size() == 1);
    CHECK(std::string(recorder.pairs[0].occasion) == "suspended");
    CHECK(recorder.pairs[0].suspended == 8h);
    CHECK(recorder.pairs[0].monotonic == MonotonicTime{10s});
    CHECK(recorder.pairs[0].realtime == Time{1'700'000'010s + 8h});
    CHECK(log.starts_with("the computer was suspended for 8 h; "));
    CHECK_MESSAGE(log.find("was set") == std::string::npos, log);
    CHECK(sensor.counts().taken == 21);  // the schedule stood still

    clock.suspend(1h);
    clock.set_realtime(clock.realtime() - 2s);  // by a clock that is right
    loop.advance(10s);
    REQUIRE(recorder.pairs.size() == 2);
    CHECK(std::string(recorder.pairs[1].occasion) == "step");
    CHECK(recorder.pairs[1].suspended == 9h);
    CHECK_MESSAGE(log.find("the computer was suspended for 1 h; ") != std::string::npos, log);
    CHECK_MESSAGE(log.find("the time of day was set by -2 s; ") != std::string::npos, log);
    CHECK(runtime.note_wall_clock({.monotonic = loop.now(), .realtime = clock.realtime(), .source = "gps"}));
    CHECK(recorder.pairs.back().suspended == 9h);
    runtime.core().detach(recorder);
  }

  TEST_CASE("a plugged clock tells the time as often as it likes, and floods no recording") {
    ManualClock clock;
    Runtime runtime({.clock = &clock});
    Loop loop(runtime, {});
    Pairs recorder;
    runtime.core().attach(recorder);
    Duration accuracy = 1ms;
    Duration wrong{0};
    Ticker gps(loop, 100ms, [&](const Tick&) {
      const Time utc = clock.realtime() + 3s + wrong;
      CHECK(runtime.note_wall_clock({.monotonic = loop.now(), .realtime = utc, .source = "gps", .accuracy = accuracy}));
    });
    loop.advance(1h);
    REQUIRE(recorder.pairs.size() == 7);
    CHECK(recorder.pairs[0].source == "gps");
    CHECK(std::string(recorder.pairs[0].occasion) == "start");
    CHECK(recorder.pairs[6].monotonic - recorder.pairs[0].monotonic == 1h);
    loop.advance(1min);
    accuracy = 1us;
    loop.advance(1min);
    REQUIRE(recorder.pairs.size() == 8);
    CHECK(recorder.pairs[7].accuracy == 1us);
    accuracy = 10us;
    loop.advance(1min);
    accuracy = 1us;  // as it was before
    wrong = 5ms;     // drift is followed by the next regular one
    loop.advance(1min);
    CHECK(recorder.pairs.size() == 8);
    wrong = 5s;
    loop.advance(1min);
    CHECK(recorder.pairs.size() == 9);
    // A recording that begins now is told the last of it.
    const auto pairs = runtime.core().clock_log.pairs();
    REQUIRE(pairs.size() == 2);
    CHECK(pairs[0].source == "gps");
    CHECK(pairs[0].monotonic == loop.now());
    CHECK(pairs[1].source == "system");
    loop.advance(5s);
    CHECK(recorder.pairs.size() == 9);
    gps.close();
    loop.close();
    REQUIRE(recorder.pairs.size() == 11);  // what it said last is not lost
    CHECK(recorder.pairs[9].source == "gps");
    CHECK(std::string(recorder.pairs[10].occasion) == "end");
    runtime.core().detach(recorder);
  }

  TEST_CASE("a plugged clock is refused with a reason") {
    Loop loop{Loop::Manual{}};
    const auto refusal = [&](const ClockPair& pair) {
      const auto done = loop.runtime().note_wall_clock(pair);
      return done ? "" : std::string(done.error().id());
    };
    CHECK(refusal({.source = ""}) == "bad-name");
    CHECK(refusal({.source = "system"}) == "bad-name");
    CHECK(refusal({.source = std::string(65, 'x')}) == "bad-name");
    CHECK(refusal({.source = "gps", .accuracy = Duration{0}}) == "bad-argument");
    for (int i = 0; i < 16; ++i) CHECK(refusal({.source = "clock " + std::to_string(i)}) == "");
    CHECK(refusal({.source = "one more"}) == "bad-argument");
    CHECK(refusal({.source = "clock 3"}) == "");
  }

  TEST_CASE("event times of a feed with times of its own rise too") {
    ManualClock clock;
    Runtime runtime({.clock = &clock});
    Loop loop(runtime, {});
    const auto topic = loop.topic<Number>("t");
    std::vector<Time> times;
    const auto subscription = topic.subscribe(loop, [&](const Event<Number>& e) { times.push_back(e.time); });
    for (int i = 0; i < 3; ++i) topic.publish({});  // at one instant
    loop.poll();
    CHECK(times == std::vector<Time>{loop.time(), loop.time() + 1ns, loop.time() + 2ns});
  }

  TEST_CASE("in real time too a clock that is set moves no event") {
    SettableClock clock;
    Runtime runtime({.clock = &clock});
    Loop loop(runtime, {});
    Pairs recorder;
    runtime.core().attach(recorder);
    runtime.on_log([](const LogRecord&) {});
    std::vector<Time> times;
    Sensor<Number> sensor(loop, {.name = "s", .rate = 1_kHz}, [] { return Number{}; });
    const auto subscription = loop.subscribe("s", [&](const EventView& e) {
      times.push_back(e.time());
      if (times.size() == 5) clock.offset = -1h;
      if (times.size() == 10) clock.offset = 1h;
      if (times.size() == 15) loop.stop();
    });
    loop.run();
    bool rising = true;
    for (std::size_t i = 1; i < times.size(); ++i) rising = rising && times[i] > times[i - 1];
    CHECK(rising);
    CHECK(times.back() - times.front() < 1h);
    CHECK(recorder.pairs.size() == 2);
    runtime.core().detach(recorder);
  }

  TEST_CASE("the machine's clocks") {
    SystemClock clock;
    const auto first = clock.monotonic();
    CHECK(clock.monotonic() >= first);
    CHECK_FALSE(clock.boot_id().empty());
    CHECK(clock.suspended() > -1ms);
    CHECK(std::chrono::abs(clock.suspended() - clock.suspended()) < 1ms);
    if (const auto accuracy = clock.accuracy()) CHECK(*accuracy >= 1ms);
    ManualClock one, other;
    CHECK(one.boot_id() == one.boot_id());
    CHECK(one.boot_id() != other.boot_id());
  }

  TEST_CASE("a clock at the ends of time: offsets, steps and what is noted of it saturate") {
    for (const Time first : {Time::min(), Time{}, Time::max()}) {
      for (const Time then : {Time::min(), Time{}, Time::max()}) {
        ManualClock clock(first);
        Runtime runtime({.clock = &clock});
        runtime.on_log([](const LogRecord&) {});
        Loop loop(runtime, {});
        Sensor<Number> sensor(loop, {.name = "s", .rate = 10_Hz}, [] { return Number{1}; });
        std::vector<Time> times;
        const Subscription seen = loop.topic<Number>("s").subscribe(
            loop, [&](const Event<Number>& event) { times.push_back(event.time); });
        loop.advance(1s);
        clock.set_realtime(then);
        loop.advance(1s);
        for (const MonotonicTime at : {MonotonicTime::min(), loop.now(), MonotonicTime::max()}) {
          for (const Time utc : {Time::min(), Time{}, Time::max()}) {
            for (const Duration accuracy : {Duration{1}, Duration::max()})
              CHECK(runtime.note_wall_clock({.monotonic = at, .realtime = utc, .source = "gps", .accuracy = accuracy}));
          }
        }
        for (const Duration accuracy : {Duration::min(), Duration{0}})
          CHECK(!runtime.note_wall_clock({.monotonic = {}, .realtime = {}, .source = "gps", .accuracy = accuracy}));
        clock.pass(Duration::min());  // nothing: no time goes back
        clock.pass(-1s);
        CHECK(loop.now() == MonotonicTime{2s});
        loop.advance(1s);
        CHECK(loop.close() == 0);
        CHECK(times.size() == 31);
        CHECK(std::is_sorted(times.begin(), times.end()));
        CHECK(runtime.balances());
      }
    }
  }
}
