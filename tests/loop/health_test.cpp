#include "rtdata/loop/runtime.hpp"

#include <doctest/doctest.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "loop/core/loop_core.hpp"
#include "loop/observed.hpp"
#include "loop/run_until.hpp"
#include "loop/virtual_time.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "rtdata/sinks/sink.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using observed::Count;

namespace {

/// "sensor s faulted: cannot read"
std::string text_of(const HealthChange& change) {
  std::string text = std::string(change.kind) + " " + std::string(change.name) + " " +
                     std::string(name_of(change.state));
  return change.reason.empty() ? text : text + ": " + std::string(change.reason);
}

struct Heard {
  std::vector<std::string> texts;
  std::vector<Time> times;
  Subscription subscription;
  explicit Heard(Loop& loop) {
    subscription = loop.subscribe<HealthChange>(health_topic, [this](const Event<HealthChange>& event) {
      texts.push_back(text_of(event.data));
      times.push_back(event.time);
    });
  }
};

}  // namespace

TEST_SUITE_BEGIN("loop");

TEST_CASE("US-16 a sensor's changes of health are events, once each, with the reason and the time") {
  Loop loop{Loop::Manual{}};
  loop.on_error([](const ErrorReport&) {});
  loop.runtime().on_log([](const LogRecord&) {});
  Heard heard(loop);
  std::vector<std::string> all;
  auto every = loop.subscribe("#", [&](const EventView& event) { all.emplace_back(event.topic()); });
  bool is_broken = false;
  Sensor<Count> sensor(loop, {.name = "s", .rate = 10_Hz, .retry_first = 100ms}, [&]() -> Result<Count> {
    if (is_broken) return Error{Errc::io_failed, "cannot read", "", "", ""};
    return Count{1};
  });
  const Time start = loop.time();
  loop.advance(950ms);
  CHECK(heard.texts.empty());
  is_broken = true;
  loop.advance(450ms);  // fails at 1.0, 1.1, 1.2 s
  CHECK(heard.texts == std::vector<std::string>{"sensor s degraded: cannot read", "sensor s faulted: cannot read"});
  is_broken = false;
  loop.advance(2s);
  REQUIRE(heard.texts.size() == 3);
  CHECK(heard.texts[2] == "sensor s ok");
  CHECK(heard.times[0] - start == 1s);
  CHECK(heard.times[1] - start == 1200ms);
  CHECK(!all.empty());
  for (const std::string& topic : all) CHECK(topic == "s");  // # does not match our own topics
  loop.close();
  CHECK(loop.runtime().balances());
}

TEST_CASE("US-16 a long reason is cut at a whole character") {
  Loop loop{Loop::Manual{}};
  loop.on_error([](const ErrorReport&) {});
  Heard heard(loop);
  std::string reason;
  for (int i = 0; i < 100; ++i) reason += "\u00b5";
  Sensor<Count> sensor(loop, {.name = "s", .rate = 10_Hz}, [&]() -> Result<Count> {
    return Error{Errc::io_failed, "x" + reason, "", "", ""};
  });
  loop.advance(10ms);
  REQUIRE(heard.texts.size() == 1);
  CHECK(heard.texts[0] == "sensor s degraded: x" + reason.substr(0, 92) + "...");
}

TEST_CASE("US-16 a loop that is held is degraded, until it was not held for ten seconds") {
  Loop loop{Loop::Manual{}};
  loop.on_error([](const ErrorReport&) {});
  Heard heard(loop);
  Duration takes{20ms};
  Ticker ticker(loop, Ticker::Config{.period = 1s, .name = "blink"},
                [&](const Tick&) { loop.manual_clock().pass(takes); });
  loop.advance(5s);
  CHECK(heard.texts == std::vector<std::string>{"loop main degraded: blink held the loop for 20 ms"});
  takes = Duration{0};
  loop.advance(9s);
  CHECK(heard.texts.size() == 1);
  loop.advance(2s);
  REQUIRE(heard.texts.size() == 2);
  CHECK(heard.texts[1] == "loop main ok");
  loop.close();
}

TEST_CASE("US-16 a lane is degraded while a job was given up, and ok after one that ended well") {
  struct Job final : detail::LaneJob {
    void run() noexcept override {}
    void done(Outcome) override {}
  };
  Loop loop{Loop::Manual{}};
  Heard heard(loop);
  detail::Lane& lane = loop.core().lanes.of("/dev/i2c-1", 100ms);
  loop.script_lane_duration(200ms);
  REQUIRE(lane.submit(std::make_shared<Job>()));
  loop.advance(300ms);
  CHECK(heard.texts == std::vector<std::string>{
                           "lane /dev/i2c-1 degraded: a job took longer than its limit of 100 ms and was given up"});
  loop.script_lane_duration(10ms);
  REQUIRE(lane.submit(std::make_shared<Job>()));
  loop.advance(300ms);
  REQUIRE(heard.texts.size() == 2);
  CHECK(heard.texts[1] == "lane /dev/i2c-1 ok");
}

TEST_CASE("US-16 a sink that cannot store is faulted, and ok when it can again; it may record that itself") {
  struct Failing final : Writer {
    Failing(bool& is_broken_, std::vector<std::string>& stored_) : is_broken(is_broken_), stored(stored_) {}
    Result<void> open() override { return {}; }
    Result<void> write(Batch& batch) override {
      if (is_broken) return Error{Errc::storage_full, "cannot store", "", "", ""};
      for (const Record& record : batch) stored.emplace_back(record.info->topic);
      return {};
    }
    bool& is_broken;
    std::vector<std::string>& stored;
  };
  Loop loop{Loop::Manual{}};
  loop.on_error([](const ErrorReport&) {});
  loop.runtime().on_log([](const LogRecord&) {});
  Heard heard(loop);
  bool is_broken = true;
  std::vector<std::string> stored;
  Sink sink(loop, {.name = "disk", .topics = {"#", health_topic}, .batch_rows = 1, .batch_time = 100ms},
            std::make_unique<Failing>(is_broken, stored));
  Sensor<Count> sensor(loop, {.name = "s", .rate = 10_Hz}, [] { return Count{1}; });
  loop.advance(1s);
  CHECK(heard.texts == std::vector<std::string>{"sink disk faulted: cannot store"});
  is_broken = false;
  loop.advance(10s);
  REQUIRE(heard.texts.size() == 2);
  CHECK(heard.texts[1] == "sink disk ok");
  loop.close();
  CHECK(std::count(stored.begin(), stored.end(), health_topic) == 2);
  CHECK(loop.runtime().balances());
}

TEST_CASE("US-16 changes of health on a tier are heard on the main loop") {
  Loop loop{virtual_time()};
  loop.on_error([](const ErrorReport&) {});
  loop.runtime().on_log([](const LogRecord&) {});
  Tier fast(loop, {.name = "fast"});
  Heard heard(loop);
  bool is_broken = true;
  Sensor<Count> sensor(fast.loop(), {.name = "s", .rate = 100_Hz, .faulted_after = 1000}, [&]() -> Result<Count> {
    if (is_broken) return Error{Errc::io_failed, "cannot read", "", "", ""};
    return Count{1};
  });
  const auto has = [&](const char* text) {
    return std::find(heard.texts.begin(), heard.texts.end(), text) != heard.texts.end();
  };
  CHECK(run_until(loop, [&] { return has("sensor s degraded: cannot read"); }));
  is_broken = false;
  CHECK(run_until(loop, [&] { return has("sensor s ok"); }));
}

TEST_CASE("NFR-1 a tier that hangs is reported by name, is faulted, and ok again when it turns") {
  Loop loop{virtual_time()};
  std::vector<std::string> reports;
  loop.on_error([&](const ErrorReport& report) {
    reports.push_back(std::string(report.object) + " " + std::string(report.error.id()));
  });
  loop.runtime().on_log([](const LogRecord&) {});
  Tier fast(loop, {.name = "fast", .hold_limit = 1h});
  Tier other(loop, {.name = "other"});
  Heard heard(loop);
  const auto count = [&](const std::string& begin) {
    return std::count_if(heard.texts.begin(), heard.texts.end(),
                         [&](const std::string& text) { return text.starts_with(begin); });
  };
  TierWatch watch(loop, 400ms);
  CHECK(watch.all_turn());
  bool is_released = false;
  fast.loop().post([&] {
    while (!is_released) loop.manual_clock().pass(1ms);
  });
  CHECK(run_until(loop, [&] { return count("tier fast faulted: does not turn: ") == 1; }));
  CHECK_FALSE(watch.all_turn());
  CHECK(std::find(reports.begin(), reports.end(), "tier fast not-turning") != reports.end());
  is_released = true;
  CHECK(run_until(loop, [&] { return count("tier fast ok") == 1 && watch.all_turn(); }));
  CHECK(count("tier fast faulted") == 1);
  CHECK_THROWS_AS(TierWatch(loop, Duration{0}), SetupError);
}

TEST_CASE("NFR-5 an error that no handler takes goes to standard error, with its id in brackets") {
  const std::unique_ptr<std::FILE, int (*)(std::FILE*)> file(std::tmpfile(), std::fclose);
  const int before = ::dup(STDERR_FILENO);
  REQUIRE(::dup2(::fileno(file.get()), STDERR_FILENO) >= 0);
  {
    Loop loop{Loop::Manual{}};
    Sensor<Count> sensor(loop, {.name = "s", .rate = 10_Hz, .faulted_after = 1}, []() -> Result<Count> {
      throw SetupError({Errc::not_found, "cannot read", "/dev/x", "", ""});
    });
    loop.advance(100ms);
  }
  std::fflush(stderr);
  ::dup2(before, STDERR_FILENO);
  ::close(before);
  std::rewind(file.get());
  std::string said(10000, '\0');
  said.resize(std::fread(said.data(), 1, said.size(), file.get()));
  CHECK(said.starts_with("rtdata: error: sensor s: "));
  CHECK(said.find("cannot read: /dev/x [handler-threw]\n") != std::string::npos);
  CHECK(said.find("[not-found]") == std::string::npos);
  CHECK(said.find("rtdata: warning: sensor s: faulted: ") != std::string::npos);
  for (std::size_t end = said.find('\n'); end != std::string::npos; end = said.find('\n', end + 1))
    CHECK_MESSAGE(said[end - 1] == ']', said);
}

TEST_SUITE_END();
