#include "rtdata/sensors/pps.hpp"

#include <doctest/doctest.h>
#include <unistd.h>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/loop/timer.hpp"
#include "sensors/fixture.hpp"
#include "sensors/kernel/pps_time.hpp"

using namespace rtdata;
using namespace rtdata::literals;

TEST_SUITE_BEGIN("sensors");

namespace {

/// Writes what the kernel would, at each whole second of the loop's clock and `after` it.
class FakePulses {
 public:
  explicit FakePulses(Loop& loop) : loop_(loop) { set("0.000000000#0\n"); }
  void set(const std::string& text) {
    ScratchDirectory::write(directory.path() + "/new", text);
    ::rename((directory.path() + "/new").c_str(), file.c_str());
  }
  void begin(Duration after, Duration period = 1s) {
    after_ = after;
    ticker_ = Ticker(loop_, {.period = period, .phase = after}, [this](const Tick&) {
      ++count;
      if (is_on) write();
    });
  }
  void write() {
    const Time now = loop_.core().runtime.clock_log.clock().realtime() + off;
    const auto ns = now.time_since_epoch().count();
    std::string rest = std::to_string(ns % 1'000'000'000);
    rest.insert(0, 9 - rest.size(), '0');
    set(std::to_string(ns / 1'000'000'000) + "." + rest + "#" + std::to_string(count) + "\n");
  }
  ScratchDirectory directory;
  std::string file = directory.file("sys/class/pps/pps0/assert");
  std::uint32_t count = 0;
  bool is_on = true;
  Duration off{0};

 private:
  Loop& loop_;
  Duration after_{0};
  Ticker ticker_;
};

struct Stage {
  Stage() {
    be_quiet(loop);
    loop.on_error([this](const ErrorReport& report) {
      if (report.error.code != Errc::held_too_long) errors.push_back(report.error);
    });
    heard = loop.topic<PpsPulse>("pps").subscribe(loop, [this](const Event<PpsPulse>& event) {
      pulses.push_back(*event);
      times.push_back(event.time);
    });
  }
  ManualClock& clock() { return static_cast<ManualClock&>(loop.core().runtime.clock_log.clock()); }
  std::vector<ClockPair> wall() {
    std::vector<ClockPair> of_pps;
    for (ClockPair& pair : loop.core().runtime.clock_log.pairs()) {
      if (pair.source == "pps0") of_pps.push_back(pair);
    }
    return of_pps;
  }
  Loop loop{Loop::Manual{}};
  FakePulses fake{loop};
  std::vector<Error> errors;
  std::vector<PpsPulse> pulses;
  std::vector<Time> times;
  Subscription heard;
};

}  // namespace

TEST_CASE("FW-2 the kernel's text of a pulse is its time and number") {
  using detail::parse_pps;
  CHECK(parse_pps("1700000000.123456789#42\n").or_throw() ==
        detail::PpsStamp{from_nanoseconds(1'700'000'000'123'456'789), 42});
  CHECK(parse_pps("1.000000000#-1").or_throw().count == 4294967295u);
  CHECK(parse_pps("").error().why == "its driver does not report this edge");
  for (const char* bad : {"x", "1#2", "1.5#2", "1.123456789", "1.123456789#", "1.12345678x#2", "-1.123456789#2",
                          "1.-12345678#2", "9000000001.000000000#1", "1.123456789#4294967296"}) {
    CAPTURE(bad);
    CHECK(parse_pps(bad).error().code == Errc::bad_data);
  }
}

TEST_CASE("FW-2 each pulse is an event at its instant; those that nobody saw are lost, exactly counted") {
  Stage stage;
  stage.fake.begin(300ms);
  PpsSensor sensor(stage.loop, {.name = "pps"}, {.root = stage.fake.directory.path()});
  stage.loop.advance(5s);
  REQUIRE(stage.pulses.size() == 5);
  CHECK(stage.pulses[0].count == 1);
  CHECK(!stage.pulses[0].interval);
  CHECK(*stage.pulses[1].interval == doctest::Approx(1));
  CHECK(stage.pulses[1].clock_error == doctest::Approx(0.3));
  for (std::size_t i = 1; i < stage.times.size(); ++i) CHECK(stage.times[i] - stage.times[i - 1] == 1s);
  CHECK(sensor.counts().lost_is_known);
  CHECK(sensor.counts().lost == 0);

  stage.fake.is_on = false;  // three pulses that nobody reads
  stage.loop.advance(3s);
  stage.fake.is_on = true;
  stage.loop.advance(1s);
  CHECK(stage.pulses.size() == 6);
  CHECK(sensor.counts().lost == 3);
  CHECK(!stage.pulses.back().interval);
  CHECK(sensor.counts().balances());
}

TEST_CASE("FW-2 pulses at another rate are followed") {
  Stage stage;
  stage.fake.begin(0ms, 100ms);
  PpsSensor sensor(stage.loop, {.name = "pps"}, {.accuracy = 0s, .root = stage.fake.directory.path()});
  stage.loop.advance(5s);
  CHECK(stage.pulses.size() >= 49);
  CHECK(sensor.counts().lost <= 1);
}

TEST_CASE("FW-2 pulses tell the time of day when the clock is kept well enough to know which second they begin") {
  Stage stage;
  stage.fake.begin(0ms);
  stage.fake.off = -20ms;
  stage.clock().set_accuracy(100ms);
  stage.clock().set_realtime(Time{1'800'000'000s} + 20ms);  // the machine's clock is 20 ms fast
  PpsSensor sensor(stage.loop, {.name = "pps"}, {.root = stage.fake.directory.path()});
  stage.fake.off = 0ms;
  stage.loop.advance(3s + 500ms);
  CHECK(stage.wall().empty());  // too few to be sure
  stage.loop.advance(5s);
  const auto wall = stage.wall();
  REQUIRE(!wall.empty());
  CHECK(wall.back().realtime.time_since_epoch() % 1s == 0s);
  CHECK(*wall.back().accuracy == 50us);
  CHECK(wall.back().realtime - Time{1'800'000'000s} ==
        wall.back().monotonic - stage.clock().monotonic() + (stage.clock().realtime() - 20ms - Time{1'800'000'000s}));
  CHECK(stage.errors.empty());
}

TEST_CASE("FW-2 pulses are no source of the time of day: a clock that nobody keeps, another phase, an accuracy of 0") {
  Stage stage;
  PpsConfig config{.root = stage.fake.directory.path()};
  SUBCASE("nobody keeps the clock") { stage.fake.begin(0ms); }
  SUBCASE("they do not begin seconds") {
    stage.clock().set_accuracy(100ms);
    stage.fake.begin(400ms);
  }
  SUBCASE("by configuration") {
    stage.clock().set_accuracy(1ms);
    config.accuracy = 0s;
    stage.fake.begin(0ms);
  }
  SUBCASE("the clock is set all the time") {
    stage.clock().set_accuracy(1ms);
    stage.fake.begin(0ms);
    PpsSensor sensor(stage.loop, {.name = "pps"}, config);
    for (int i = 0; i < 20; ++i) {
      stage.loop.advance(990ms);
      stage.clock().set_realtime(stage.clock().realtime() + 5s);
    }
    CHECK(stage.pulses.size() > 15);
    CHECK(stage.wall().empty());
    return;
  }
  PpsSensor sensor(stage.loop, {.name = "pps"}, config);
  stage.loop.advance(20s);
  CHECK(stage.pulses.size() >= 19);
  CHECK(stage.wall().empty());
  CHECK(stage.errors.size() <= 1);
}

TEST_CASE("FW-2 a source that is silent or goes away is told, and comes back") {
  Stage stage;
  stage.fake.begin(0ms);
  PpsSensor sensor(stage.loop, {.name = "pps"}, {.root = stage.fake.directory.path()});
  stage.loop.advance(3s);
  stage.fake.is_on = false;
  stage.loop.advance(5s);
  CHECK(sensor.health() == Health::degraded);
  CHECK(stage.errors.back().code == Errc::timed_out);
  stage.fake.is_on = true;
  stage.loop.advance(2s);
  CHECK(sensor.health() == Health::ok);
  CHECK(sensor.status().outages.number == 1);

  stage.fake.is_on = false;
  ::unlink(stage.fake.file.c_str());
  stage.loop.advance(5s);
  CHECK(sensor.health() == Health::faulted);
  const std::size_t before = stage.pulses.size();
  stage.fake.is_on = true;
  stage.loop.advance(20s);
  CHECK(stage.pulses.size() > before);
  CHECK(sensor.health() == Health::ok);
  CHECK(sensor.counts().balances());
}

TEST_SUITE_END();
