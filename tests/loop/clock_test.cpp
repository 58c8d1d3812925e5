// Times of events, while the time of day is set.
#include "rtdata/loop/clock.hpp"

#include <doctest/doctest.h>

#include <string>
#include <vector>

#include "loop/runtime_core.hpp"
#include "loop/observed.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using observed::Number;

namespace {

/// Notes the pairs that a recording would hold.
struct Pairs final : detail::Recorder {
  std::vector<ClockPair> pairs;
  void on_topic(detail::TopicCore&) override {}
  void on_gap(detail::OriginCore&, const Gap&) override {}
  void on_segment(detail::OriginCore&, const Segment&) override {}
  void on_clock(const ClockPair& pair) override { pairs.push_back(pair); }
  void on_error(Time, std::string_view, const Error&, std::uint64_t) override {}
  SinkStatus status() const override { return {}; }
  void drain(MonotonicTime, Callback<void(std::uint64_t)> done) override { done(0); }
};

/// The machine's monotonic line with a time of day that can be set.
struct SettableClock final : SystemClock {
  Duration offset{0};
  Time realtime() noexcept override { return SystemClock::realtime() + offset; }
};

}  // namespace

TEST_SUITE("loop") {
  TEST_CASE("event times never repeat or go back while the time of day is set, and each step is recorded") {
    ManualClock clock(Time{1s});  // 1970, as boards without a battery start
    Runtime runtime({.clock = &clock});
    Loop loop(runtime, {});
    Pairs recorder;
    runtime.core().recorders.push_back(&recorder);
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
      CHECK(std::string(recorder.pairs[i].source) == "step");
      CHECK(recorder.pairs[i].monotonic.time_since_epoch() == (i + 1) * Duration{1s});
    }
    CHECK(recorder.pairs[0].realtime == Time{1'700'000'000s});
    CHECK(recorder.pairs[1].realtime - recorder.pairs[0].realtime == 1s - 1h);
    CHECK(recorder.pairs[2].realtime - recorder.pairs[1].realtime == 1s + 1h);
    CHECK_FALSE(runtime.core().look_at_clock());
    CHECK(runtime.core().look_at_clock("regular"));
    CHECK(std::string(recorder.pairs.back().source) == "regular");
    loop.close();
    CHECK(std::string(recorder.pairs.back().source) == "end");
    std::erase(runtime.core().recorders, &recorder);
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
    runtime.core().recorders.push_back(&recorder);
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
    std::erase(runtime.core().recorders, &recorder);
  }

  TEST_CASE("the machine's clocks") {
    SystemClock clock;
    const auto first = clock.monotonic();
    CHECK(clock.monotonic() >= first);
    CHECK_FALSE(clock.boot_id().empty());
  }
}
