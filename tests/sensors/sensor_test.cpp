#include "rtdata/sensors/sensor.hpp"

#include <doctest/doctest.h>

#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "loop/lane_sensor.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace rtdata::literals;

TEST_SUITE_BEGIN("sensors");

namespace {

struct Number {
  std::int64_t number = 0;
  RTDATA_FIELDS(Number, (number))
};
struct Other {
  double other = 0;
  RTDATA_FIELDS(Other, (other))
};

}  // namespace

TEST_CASE("US-27 a sensor that cannot be made leaves nothing behind on its loop") {
  Loop loop{Loop::Manual{}};
  Sensor<Number> first(loop, {.name = "a", .rate = 10_Hz}, [] { return Number{1}; });
  CHECK_THROWS_AS(Sensor<Number>(loop, {.name = "a", .rate = 10_Hz}, [] { return Number{1}; }), SetupError);
  CHECK_THROWS_AS(Sensor<Other>(loop, {.name = "b", .topic = "a", .rate = 10_Hz}, [] { return Other{1}; }), SetupError);
  CHECK_THROWS_AS(Sensor<Number>(loop, {.name = "c"}, [] { return Number{1}; }), SetupError);
  loop.advance(1s);
  CHECK(first.counts().published == 11);
}

TEST_CASE("US-27 a faulty sensor is tried again after delays that double, and is ok at once when it answers") {
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  bool is_broken = true;
  std::vector<std::int64_t> tried;  // ms
  struct Device {
    Loop& loop;
    bool& is_broken;
    std::vector<std::int64_t>& tried;
    Result<void> open() {
      tried.push_back(loop.now().time_since_epoch() / 1ms);
      if (is_broken) return Error{Errc::not_found, "no device", "", "", ""};
      return {};
    }
    Result<Number> read() {
      if (is_broken) return Error{Errc::io_failed, "no answer", "", "", ""};
      return Number{1};
    }
  };
  Sensor<Number> sensor(loop, {.name = "s", .rate = 1_kHz, .retry_first = 100ms, .retry_longest = 400ms},
                        Device{loop, is_broken, tried});
  CHECK(sensor.health() == Health::faulted);
  loop.advance(2s - 1us);
  REQUIRE(tried.size() >= 5);
  std::vector<std::int64_t> delays;
  for (std::size_t i = 1; i < tried.size(); ++i) delays.push_back(tried[i] - tried[i - 1]);
  for (std::size_t i = 0; i < delays.size(); ++i) {
    const std::int64_t whole = std::min<std::int64_t>(400, 100 << std::min<std::size_t>(i, 4));
    CHECK(delays[i] <= whole + 1);
    CHECK(delays[i] >= whole * 3 / 4);
  }
  CHECK(sensor.counts().failed == 2000);
  CHECK(sensor.counts().scheduled == 2000);
  CHECK(sensor.counts().balances());
  is_broken = false;
  loop.advance(500ms);
  CHECK(sensor.health() == Health::ok);
  CHECK(sensor.counts().published > 0);
  CHECK(sensor.counts().balances());
}

TEST_CASE("US-27 failures in a row make a sensor degraded, then faulted; one good reading makes it ok") {
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  int bad = 0;
  std::vector<std::string> errors;
  Sensor<Number> sensor(loop, {.name = "s", .rate = 10_Hz}, [&]() -> Result<Number> {
    if (bad != 0) return Error{Errc::io_failed, "no answer", "", "", ""};
    return Number{1};
  });
  sensor.on_error([&](const ErrorReport& report) { errors.emplace_back(report.error.id()); });
  loop.advance(150ms);
  bad = 1;
  loop.advance(100ms);
  CHECK(sensor.health() == Health::degraded);
  bad = 0;
  loop.advance(100ms);
  CHECK(sensor.health() == Health::ok);
  bad = 1;
  loop.advance(300ms);
  CHECK(sensor.health() == Health::faulted);
  CHECK(errors.size() == 4);
  bad = 0;
  loop.advance(200ms);
  CHECK(sensor.health() == Health::ok);
  CHECK(sensor.status().reason.empty());
  CHECK(sensor.counts().balances());
}

TEST_CASE("US-27 a read that throws is a failure like any other") {
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  std::vector<std::string> errors;
  int reads = 0;
  Sensor<Number> sensor(loop, {.name = "s", .rate = 10_Hz, .faulted_after = 100}, [&]() -> Number {
    if (++reads % 2 == 0) throw std::runtime_error("odd");
    if (reads == 5) throw 5;
    return Number{reads};
  });
  sensor.on_error([&](const ErrorReport& report) { errors.emplace_back(report.error.why); });
  loop.advance(550ms);
  CHECK(errors == std::vector<std::string>{"odd", "odd", "an exception that is not a std::exception", "odd"});
  CHECK(sensor.counts().taken == 2);
  CHECK(sensor.counts().failed == 4);
  CHECK(sensor.counts().balances());
}

TEST_CASE("US-5 ticks that pass while the loop is held are missed, not caught up") {
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  std::vector<std::int64_t> read_at;
  Sensor<Number> sensor(loop, {.name = "s", .rate = 100_Hz}, [&] {
    read_at.push_back(loop.now().time_since_epoch() / 1ms);
    return Number{1};
  });
  Timer hog(loop, 25ms, [&] { loop.manual_clock().pass(50ms); });  // holds the loop until 75 ms
  loop.advance(100ms);
  CHECK(read_at == std::vector<std::int64_t>{0, 10, 20, 75, 80, 90, 100});
  CHECK(sensor.counts().scheduled == 11);
  CHECK(sensor.counts().missed == 4);  // 30, 40, 50, 60; the one of 70 was taken late
  CHECK(sensor.counts().taken == 7);
  CHECK(sensor.counts().late == 1);
  CHECK(sensor.counts().balances());
}

TEST_CASE("US-5 a reading is late beyond the larger of 1 ms and a tenth of the period, or beyond what is set") {
  for (const auto& [late_after, expected] :
       {std::pair<std::optional<Duration>, std::uint64_t>{std::nullopt, 0}, {1ms, 1}}) {
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    Sensor<Number> sensor(loop, {.name = "s", .rate = 10_Hz, .late_after = late_after}, [] { return Number{1}; });
    Timer hog(loop, 95ms, [&] { loop.manual_clock().pass(12ms); });
    loop.advance(300ms);
    CHECK(sensor.counts().late == expected);
    CHECK(sensor.counts().taken == 4);
    CHECK(sensor.counts().balances());
  }
}

TEST_CASE("US-5 a reading is late by the schedule at which it was due, also when the rate changes meanwhile") {
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  loop.script_lane_duration(3ms);
  Timer hog(loop, 95ms, [&] { loop.manual_clock().pass(10ms); });  // the tick of 100 ms begins 5 ms late
  SUBCASE("in the read") {
    Sensor<Number> sensor;
    sensor = Sensor<Number>(loop, {.name = "s", .rate = 10_Hz}, [&] {
      if (loop.now().time_since_epoch() == 105ms) sensor.set_rate(1_kHz);
      return Number{1};
    });
    loop.advance(200ms);
    CHECK(sensor.counts().taken > 90);
    CHECK(sensor.counts().late == 0);
    CHECK(sensor.counts().balances());
  }
  SUBCASE("while a lane reads") {
    lane_sensor::LaneSensor<Number> sensor(loop, {.name = "s", .rate = 10_Hz});
    Timer changes(loop, 106ms, [&] { sensor.set_rate(1_kHz); });
    loop.advance(200ms);
    CHECK(sensor.counts().taken > 20);
    CHECK(sensor.counts().late == 0);
    CHECK(sensor.counts().balances());
  }
}

TEST_CASE("US-9 the opening of a lane's device that changes the rate and stops the sensor ends one read") {
  struct Device final : detail::LaneDevice {
    explicit Device(std::function<Result<void>()> open_) : opens(std::move(open_)) {}
    struct Read final : detail::Transaction {
      void transact() noexcept override {}
    };
    std::shared_ptr<detail::Transaction> make_opening() override { return std::make_shared<Read>(); }
    Result<void> take_opening(detail::Transaction&) override { return opens(); }
    std::shared_ptr<detail::Transaction> make_transaction() override { return std::make_shared<Read>(); }
    detail::Sampled decode(detail::Transaction&, detail::SamplePort& port) override {
      return port.fail({Errc::io_failed, "no answer", "", "", ""});
    }
    std::string lane_key() const override { return "device"; }
    Error given_up_error() const override { return {Errc::timed_out, "no answer", "", "", ""}; }
    std::function<Result<void>()> opens;
  };
  struct Made : AnySensor {
    Made() = default;
    Made(Loop& loop, std::function<Result<void>()> open)
        : AnySensor(detail::make_sensor(loop, {.name = "s", .rate = 10_Hz, .faulted_after = 1},
                                        detail::payload_type<Number>(), std::make_unique<Device>(std::move(open)))) {}
  };
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  int opened = 0;
  Made sensor;
  const auto open = [&]() -> Result<void> {
    if (++opened == 2) {
      sensor.set_rate(20_Hz);
      sensor.stop();
    }
    return {};
  };
  sensor = Made(loop, open);
  loop.advance(500ms);
  CHECK(opened == 2);
  CHECK(sensor.counts().in_flight == 0);
  CHECK(sensor.counts().failed == sensor.counts().scheduled);
  sensor.start();
  loop.advance(500ms);
  CHECK(sensor.counts().failed > 2);
  CHECK(loop.runtime().balances());
}

TEST_CASE("US-9 a sensor may stop, start, close and re-rate itself from within read") {
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  int reads = 0;
  Sensor<Number> stops;
  std::vector<std::int64_t> heard;
  auto s = loop.topic<Number>("stops").subscribe(loop, [&](const Event<Number>& e) { heard.push_back(e->number); });
  stops = Sensor<Number>(loop, {.name = "stops", .rate = 10_Hz}, [&] {
    if (++reads == 3) stops.stop();
    return Number{reads};
  });
  loop.advance(1s);
  CHECK(reads == 3);
  CHECK(heard == std::vector<std::int64_t>{1, 2});
  CHECK(stops.counts().balances());
  CHECK(stops.counts().scheduled == 3);
  stops.start();
  loop.advance(150ms);
  CHECK(heard == std::vector<std::int64_t>{1, 2, 4, 5});
  CHECK(stops.counts().balances());

  Sensor<Number> rates;
  int rated = 0;
  rates = Sensor<Number>(loop, {.name = "rates", .rate = 10_Hz}, [&] {
    if (++rated == 2) rates.set_rate(100_Hz);
    return Number{rated};
  });
  loop.advance(195ms);  // at 0, 100, then every 10 ms from there on
  CHECK(rates.rate() == 100_Hz);
  CHECK(rated >= 11);
  CHECK(rates.counts().published == static_cast<std::uint64_t>(rated));
  CHECK(rates.counts().balances());

  Sensor<Number> closes;
  int closed = 0;
  closes = Sensor<Number>(loop, {.name = "closes", .rate = 10_Hz}, [&] {
    if (++closed == 2) closes.close();
    return Number{closed};
  });
  loop.advance(1s);
  CHECK(closed == 2);
  CHECK(loop.runtime().balances());
}

namespace {

/// Works, or not, as the test says; may do something when it is opened.
struct Moody {
  bool& is_bad;
  std::function<void()> when_opened = {};
  int* closed = nullptr;
  Result<void> open() {
    if (when_opened) when_opened();
    if (is_bad) return Error{Errc::not_found, "no device", "", "", ""};
    return {};
  }
  Result<Number> read() {
    if (is_bad) return Error{Errc::io_failed, "no answer", "", "", ""};
    return Number{1};
  }
  void close() {
    if (closed != nullptr) ++*closed;
  }
};

}  // namespace

TEST_CASE("US-9 a sensor that cannot start may be stopped or closed by the handler that is told of it") {
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  bool is_bad = true;
  Sensor<Number> sensor(loop, {.name = "s", .rate = 10_Hz, .start = false}, Moody{is_bad});
  SUBCASE("stopped") {
    sensor.on_error([&](const ErrorReport&) { sensor.stop(); });
    sensor.start();
    CHECK_FALSE(sensor.is_running());
    loop.advance(1s);
    CHECK(sensor.counts().scheduled == 0);
    is_bad = false;
    sensor.start();
    loop.advance(1s);
    CHECK(sensor.counts().published == 11);
  }
  SUBCASE("closed") {
    sensor.on_error([&](const ErrorReport&) { sensor.close(); });
    sensor.start();
    CHECK_FALSE(sensor.is_open());
    loop.advance(1s);
  }
  CHECK(loop.runtime().balances());
}

TEST_CASE("US-9 a device may stop, restart, close or re-rate its sensor while it is opened") {
  enum class Act { stop, restart, close, rate };
  const auto check = [](Act act, bool at_start) {
    CAPTURE(static_cast<int>(act));
    CAPTURE(at_start);
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    bool is_bad = false;
    bool acts = false;
    int closed = 0;
    Sensor<Number> sensor;
    const auto when_opened = [&] {
      if (!std::exchange(acts, false)) return;
      if (act == Act::stop || act == Act::restart) sensor.stop();
      if (act == Act::restart) sensor.start();
      if (act == Act::close) sensor.close();
      if (act == Act::rate) sensor.set_rate(100_Hz);
    };
    sensor = Sensor<Number>(loop,
                            {.name = "s", .rate = 10_Hz, .faulted_after = 1, .retry_first = 150ms, .start = false},
                            Moody{is_bad, when_opened, &closed});
    if (at_start) {
      acts = true;
      sensor.start();
    } else {
      sensor.start();
      loop.advance(250ms);
      is_bad = true;
      loop.advance(100ms);
      is_bad = false;
      acts = true;
    }
    loop.advance(500ms);
    CHECK_FALSE(acts);
    CHECK(sensor.is_open() == (act != Act::close));
    if (act == Act::rate) {
      CHECK(sensor.is_running());
      CHECK(sensor.rate() == 100_Hz);
      CHECK(sensor.health() == Health::ok);
    }
    if (act == Act::stop && !at_start) CHECK_FALSE(sensor.is_running());
    if (act == Act::restart) {
      CHECK(sensor.is_running());
      const std::uint64_t before = sensor.counts().published;
      loop.advance(100ms);
      CHECK(sensor.counts().published == before + 1);
    }
    CHECK(loop.runtime().balances());
    sensor.close();
    CHECK(closed == (at_start ? 1 : 2));  // what was opened is closed
    CHECK(loop.runtime().balances());
  };
  for (const Act act : {Act::stop, Act::restart, Act::close, Act::rate}) {
    check(act, true);
    check(act, false);
  }
}

TEST_CASE("US-27 a device whose close throws is closed, and told of") {
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  struct Device {
    Number read() { return {1}; }
    void close() { throw std::runtime_error("stuck"); }
  };
  std::vector<std::string> errors;
  Sensor<Number> sensor(loop, {.name = "s", .rate = 10_Hz}, Device{});
  sensor.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
  loop.advance(1s);
  sensor.stop();
  REQUIRE(errors.size() == 1);
  CHECK(errors[0].find("close() threw") != std::string::npos);
  CHECK(errors[0].find("stuck") != std::string::npos);
}

TEST_CASE("US-27 a device whose close throws when its sensor is closed, or closes it while it is opened, is told of") {
  for (const bool while_opened : {false, true}) {
    Loop loop{Loop::Manual{}};
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
    struct Device {
      Sensor<Number>& sensor;
      const bool& closes;
      Result<void> open() {
        if (closes) sensor.close();
        return {};
      }
      Number read() { return {1}; }
      void close() { throw std::runtime_error("stuck"); }
    };
    Sensor<Number> sensor;
    bool closes = false;
    sensor = Sensor<Number>(loop, {.name = "s", .rate = 10_Hz}, Device{sensor, closes});
    loop.advance(1s);
    if (while_opened) {
      sensor.stop();
      loop.advance(2s);  // the same error within a second would be joined to it
      errors.clear();
      closes = true;
      sensor.start();
      CHECK_FALSE(sensor.is_open());
    }
    sensor.close();
    REQUIRE_MESSAGE(errors.size() == 1, while_opened);
    CHECK(errors[0].find("close() threw") != std::string::npos);
    CHECK(errors[0].find("stuck") != std::string::npos);
    CHECK(loop.runtime().balances());
  }
}

TEST_CASE("US-27 a handler of errors may set another in its own place, or none") {
  Loop loop{Loop::Manual{}};
  std::vector<std::string> log;
  loop.runtime().on_log([&](const LogRecord& record) { log.emplace_back(record.text); });
  bool is_bad = true;
  Sensor<Number> sensor(loop, {.name = "s", .rate = 10_Hz, .faulted_after = 100, .start = false}, Moody{is_bad});
  const std::string large(200, 'x');  // on the heap: a handler that is gone reads freed memory
  std::string seen;
  int second = 0;
  sensor.on_error([&, large](const ErrorReport&) {
    sensor.on_error([&](const ErrorReport&) {
      ++second;
      sensor.on_error({});
    });
    seen = large;
  });
  is_bad = false;
  sensor.start();
  is_bad = true;
  loop.advance(50ms);
  CHECK(seen == large);
  CHECK(second == 0);
  const std::size_t before = log.size();
  loop.advance(200ms);
  CHECK(second == 1);  // then it is gone, and the log is told
  CHECK(log.size() > before);
}

TEST_CASE("US-27 nothing new is counted as repeated; an equal value is data") {
  Loop loop{Loop::Manual{}};
  int reads = 0;
  Sensor<Number> sensor(loop, {.name = "s", .rate = 10_Hz}, [&]() -> Reading<Number> {
    if (++reads % 3 == 0) return nothing_new;
    return Number{7};
  });
  Sensor<Number> optional(loop, {.name = "o", .rate = 10_Hz}, [&]() -> std::optional<Number> { return std::nullopt; });
  loop.advance(850ms);
  CHECK(sensor.counts().taken == 9);
  CHECK(sensor.counts().published == 6);
  CHECK(sensor.counts().repeated == 3);
  CHECK(sensor.counts().balances());
  CHECK(optional.counts().repeated == 9);
  CHECK(optional.counts().balances());
}

TEST_CASE("US-5 sampling at a new rate begins at once, and an impossible one is refused") {
  Loop loop{Loop::Manual{}};
  Sensor<Number> sensor(loop, {.name = "s", .rate = 1_Hz}, [] { return Number{1}; });
  loop.advance(500ms);
  sensor.set_rate(100_Hz);
  loop.advance(95ms);
  CHECK(sensor.counts().published == 11);
  CHECK_THROWS_AS(sensor.set_rate(Rate{}), SetupError);
  CHECK_THROWS_AS(sensor.set_rate(Rate::from_period(10ns)), SetupError);
  CHECK(sensor.rate() == 100_Hz);
  CHECK(sensor.counts().balances());
}

TEST_CASE("US-27 a feed that is good again may be stopped or closed by who is told of it") {
  for (const bool closes : {false, true}) {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    Feed<Number> feed(loop, {.name = "feed"});
    auto subscription = loop.subscribe<Number>("feed", [](const Event<Number>&) {});
    feed.fail({Errc::bad_data, "cannot use this", "feed", "it is garbage", ""});
    unsigned told = 0;
    loop.runtime().on_log([&](const LogRecord&) {
      ++told;
      closes ? feed.close() : void(feed.stop());
    });
    feed.publish({1}, loop.time());
    loop.poll();
    CHECK(told == 1);
    CHECK(subscription.counts().delivered == 0);
    CHECK(subscription.counts().cancelled == 1);
    CHECK(loop.runtime().balances());
  }
}

TEST_SUITE_END();
