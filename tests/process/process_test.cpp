// Calibration and filters between a sensor and its topic: what they compute, what they hold back, when they begin anew.
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <random>
#include <vector>

#include "data/payloads.hpp"
#include "has.hpp"
#include "process/processor.hpp"
#include "rtdata/chips/lm75.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/topic.hpp"
#include "rtdata/sensors/driver.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/serial_line.hpp"
#include "rtdata/testing/fake_i2c.hpp"
#include "sensors/fixture.hpp"
#include "sensors/pty.hpp"
#include "sensors/termios2.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using payloads::Climate;
using payloads::Everything;

namespace {

struct Level {
  double level = 0;
  std::int64_t code = 0;
  std::optional<float> maybe;
  RTDATA_FIELDS(Level, (level, "V"), (code), (maybe, "K"))
};

FieldProcessing filtered(std::vector<Filter> filters) { return {.filters = std::move(filters)}; }
FieldProcessing calibrated(Calibration calibration) { return {.calibration = std::move(calibration)}; }

/// A feed of levels on a manual loop, and what is published of them.
struct Bench {
  explicit Bench(Processing process) {
    be_quiet(loop);
    feed = Feed<Level>(loop, {.name = "tank", .process = std::move(process)});
    feed.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
    heard = loop.subscribe("tank", [this](const EventView& event) {
      std::string text;
      for (const Leaf& leaf : event.description().leaves())
        text += (text.empty() ? "" : " ") + to_string(event.value(leaf));
      events.push_back(text);
    });
  }
  void publish(const Level& level) {
    feed.publish(level);
    loop.advance(10ms);
  }
  Loop loop{Loop::Manual{}};
  Feed<Level> feed;
  Subscription heard;
  std::vector<std::string> events;
  std::vector<std::string> errors;
};

std::string mistake(const Processing& process) {
  try {
    processed(description_of<Everything>(), process, "s");
  } catch (const SetupError& error) {
    return error.what();
  }
  return "";
}

using rtdata::test::has;

/// The same by hand, as simply as it can be: from all values since the filters began.
struct ByHand {
  explicit ByHand(FieldProcessing what_) : what(std::move(what_)), before(what.filters.size()) {}
  /// The normal equations, as a book has them.
  static double through(const std::vector<std::array<double, 2>>& points, double raw) {
    long double n = 0, sx = 0, sy = 0, sxx = 0, sxy = 0;
    for (const auto& [x, y] : points) {
      n += 1;
      sx += x;
      sy += y;
      sxx += static_cast<long double>(x) * x;
      sxy += static_cast<long double>(x) * y;
    }
    const long double slope = (n * sxy - sx * sy) / (n * sxx - sx * sx);
    return static_cast<double>(slope * raw + (sy - slope * sx) / n);
  }
  void restart() {
    for (auto& values : before) values.clear();
    published.clear();
  }
  std::optional<double> value(double x) {
    if (what.calibration) {
      const Calibration& c = *what.calibration;
      x = c.points.empty() ? x * c.scale + c.offset : through(c.points, x);
      if (!c.polynomial.empty()) {
        double sum = 0;
        for (auto one = c.polynomial.rbegin(); one != c.polynomial.rend(); ++one) sum = sum * x + *one;
        x = sum;
      }
      if (!std::isfinite(x)) return std::nullopt;
      if (!c.table.empty()) {
        if (x < c.table.front()[0] || x > c.table.back()[0]) {
          if (c.outside == OutsideTable::refuse) return std::nullopt;
          if (c.outside == OutsideTable::clamp) x = std::clamp(x, c.table.front()[0], c.table.back()[0]);
        }
        std::size_t i = 0;
        while (i + 2 < c.table.size() && x >= c.table[i + 1][0]) ++i;
        const auto &low = c.table[i], &high = c.table[i + 1];
        x = low[1] + (high[1] - low[1]) * ((x - low[0]) / (high[0] - low[0]));
      }
      if ((c.least && x < *c.least) || (c.most && x > *c.most)) return std::nullopt;
      x -= c.tare;
    }
    now.assign(what.filters.size(), 0);
    for (std::size_t i = 0; i < what.filters.size(); ++i) {
      const Filter& f = what.filters[i];
      std::vector<double>& all = before[i];
      all.push_back(x);
      now[i] = x;
      std::vector<double> window(all.end() - std::min<std::ptrdiff_t>(std::ssize(all), f.of.value_or(1)), all.end());
      if (f.type == FilterType::median) {
        std::sort(window.begin(), window.end());
        const std::size_t middle = window.size() / 2;
        x = window.size() % 2 == 1 ? window[middle] : (window[middle - 1] + window[middle]) / 2;
      } else if (f.type == FilterType::mean) {
        double sum = 0;
        for (const double one : window) sum += one;
        x = sum / static_cast<double>(window.size());
      } else if (f.type == FilterType::exponential) {
        double y = all.front();
        for (std::size_t n = 1; n < all.size(); ++n) y += *f.weight * (all[n] - y);
        x = y;
      } else if (f.type == FilterType::clamp) {
        x = std::clamp(x, f.least.value_or(-HUGE_VAL), f.most.value_or(HUGE_VAL));
      }
    }
    return x;
  }
  /// Whether a delta lets it pass; all have to.
  bool passes() {
    bool all_pass = true;
    for (std::size_t i = 0; i < what.filters.size(); ++i) {
      if (what.filters[i].type != FilterType::delta) continue;
      all_pass = all_pass && (published.empty() || std::abs(now[i] - published[i]) >= *what.filters[i].by);
    }
    if (all_pass) published = now;
    return all_pass;
  }
  FieldProcessing what;
  std::vector<std::vector<double>> before;
  std::vector<double> now;
  std::vector<double> published;
};

class Dice {
 public:
  explicit Dice(unsigned seed) : random_(seed) {}
  double number(double least, double most) { return std::uniform_real_distribution<double>(least, most)(random_); }
  unsigned whole(unsigned least, unsigned most) {
    return std::uniform_int_distribution<unsigned>(least, most)(random_);
  }

 private:
  std::mt19937 random_;
};

FieldProcessing any_processing(Dice& dice) {
  FieldProcessing what;
  if (dice.whole(0, 3) != 0) {
    Calibration c{.scale = dice.number(0.1, 3), .offset = dice.number(-5, 5)};
    const unsigned kind = dice.whole(0, 3);
    if (dice.whole(0, 2) == 0) c.tare = dice.number(-5, 5);
    if (kind == 3) {
      c.scale = 1;
      c.offset = 0;
      double x = dice.number(-40, -20);
      for (unsigned i = dice.whole(2, 30); i > 0; --i)
        c.points.push_back({x += dice.number(0.1, 10), dice.number(-9, 9)});
      std::shuffle(c.points.begin(), c.points.end(), std::mt19937(dice.whole(0, 999)));
    } else if (kind == 1) {
      for (unsigned i = dice.whole(2, 10); i > 0; --i) c.polynomial.push_back(dice.number(-2, 2));
    } else if (kind == 2) {
      double x = dice.number(-40, -20);
      for (unsigned i = dice.whole(2, 30); i > 0; --i)
        c.table.push_back({x += dice.number(0.1, 10), dice.number(-9, 9)});
      c.outside = static_cast<OutsideTable>(dice.whole(0, 2));
    }
    if (dice.whole(0, 3) == 0) c.most = dice.number(0, 20);
    what.calibration = c;
  }
  for (unsigned i = dice.whole(what.calibration ? 0 : 1, 4); i > 0; --i) {
    const unsigned kind = dice.whole(0, 4);
    if (kind == 0) what.filters.push_back(Filter::median(2 * dice.whole(1, 6) + 1));
    if (kind == 1) what.filters.push_back(Filter::mean(dice.whole(2, 12)));
    if (kind == 2) what.filters.push_back(Filter::exponential(dice.number(0.05, 1)));
    if (kind == 3) what.filters.push_back(Filter::clamp(dice.number(-10, 0), dice.number(0, 10)));
    if (kind == 4) what.filters.push_back(Filter::delta(dice.number(0.01, 3)));
  }
  return what;
}

}  // namespace

TEST_SUITE("process") {
  TEST_CASE("US-27 a calibrated field has its raw value beside it, and typed handlers take it as before") {
    Loop loop(Loop::Manual{});
    Sensor<Climate> room(
        loop, {.name = "room", .rate = 10_Hz, .process = {{"temperature", calibrated({.scale = 2, .offset = -1})}}},
        [] {
          return Climate{20, 55};
        });
    std::vector<Climate> typed;
    const auto handler = loop.subscribe<Climate>("room",
                                                 [&](const Event<Climate>& event) { typed.push_back(event.data); });
    std::string shown;
    const auto view = loop.subscribe("room", [&](const EventView& event) {
      shown.clear();
      for (const Leaf& leaf : event.description().leaves())
        shown += leaf.path + "=" + to_string(event.value(leaf)) + " " + leaf.unit + ";";
    });
    loop.advance(995ms);
    REQUIRE(typed.size() == 10);
    CHECK(typed.back() == Climate{39, 55});
    CHECK(shown == "temperature=39 Cel;humidity=55 %RH;temperature.raw=20 Cel;");
    // As a description it can be stored and read back.
    const auto described = loop.runtime().topics().front().description;
    CHECK(Description::from_json(described->to_json()).or_throw()->same_layout(*described));
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("US-27 a changed unit, and integers: they become double, with the exact ones beside them") {
    Bench bench({{"level", {.calibration = Calibration{.offset = 1}, .unit = "bar"}},
                 {"code", calibrated({.scale = 0.5})},
                 {"maybe", filtered({Filter::clamp(0, 10)})}});
    const std::int64_t exact = (std::int64_t{1} << 53) + 1;
    bench.publish({1.5, exact, 12.5f});
    bench.publish({2.5, -3, std::nullopt});
    REQUIRE(bench.events.size() == 2);
    // level, code, maybe; then in the order of their names code.raw, level.raw, maybe.raw
    CHECK(bench.events[0] == "2.5 4503599627370496 10 9007199254740993 1.5 12.5");
    CHECK(bench.events[1] == "3.5 -1.5 absent -3 2.5 absent");
    const auto description = bench.loop.runtime().topics().front().description;
    CHECK(description->find("level")->unit == "bar");
    CHECK(description->find("level.raw")->unit == "V");
    CHECK(description->find("code")->kind == Kind::f64);
    CHECK(description->find("code.raw")->kind == Kind::i64);
    CHECK(description->find("maybe")->kind == Kind::f32);
    CHECK(description->find("maybe.raw")->optional != nullptr);
  }

  TEST_CASE("US-27 filters that only hold back leave the payload as it is") {
    Bench bench({{"code", filtered({Filter::delta(10)})}});
    CHECK(bench.loop.runtime().topics().front().description == description_of<Level>());
    for (const std::int64_t code : {0, 5, 9, 10, 19, 1, 0}) bench.publish({0, code, {}});
    CHECK(bench.events == std::vector<std::string>{"0 0 absent", "0 10 absent", "0 0 absent"});
    const SensorCounts counts = bench.feed.counts();
    CHECK(counts.received == 7);
    CHECK(counts.published == 3);
    CHECK(counts.filtered == 4);
    CHECK(counts.balances());
  }

  TEST_CASE("US-27 a table is straight between its points; outside it refuses, which is told, or clamps") {
    const std::vector<std::array<double, 2>> points{{0.5, 0}, {2.5, 10}, {4.5, 100}};
    Bench refusing({{"level", calibrated({.table = points})}});
    Bench clamping({{"level", calibrated({.table = points, .outside = OutsideTable::clamp})}});
    for (const double volts : {0.5, 1.5, 2.5, 3.5, 4.5, 0.4, 9.0}) {
      refusing.publish({volts, 0, {}});
      clamping.publish({volts, 0, {}});
    }
    CHECK(refusing.events.size() == 5);
    CHECK(refusing.events[1] == "5 0 absent 1.5");
    CHECK(refusing.events[3] == "55 0 absent 3.5");
    CHECK(refusing.events[4] == "100 0 absent 4.5");
    CHECK(refusing.feed.counts().unreadable == 2);
    CHECK(refusing.feed.counts().balances());
    CHECK(refusing.feed.health() == Health::degraded);
    REQUIRE_FALSE(refusing.errors.empty());
    CHECK(has(refusing.errors[0], "sensor tank, field level: 0.4 is outside the table of its calibration"));
    refusing.publish({1, 0, {}});
    CHECK(refusing.feed.health() == Health::ok);
    REQUIRE(clamping.events.size() == 7);
    CHECK(clamping.events[5] == "0 0 absent 0.4");
    CHECK(clamping.events[6] == "100 0 absent 9");
  }

  TEST_CASE("US-27 points give a line, exact through two, by least squares through more, which goes on outside") {
    const auto read = [](Calibration c, std::initializer_list<double> raws) {
      Bench bench({{"level", calibrated(std::move(c))}});
      std::vector<double> got;
      const auto view = bench.loop.subscribe("tank", [&](const EventView& event) {
        got.push_back(std::get<double>(event.value(*event.description().find("level"))));
      });
      for (const double raw : raws) bench.publish({raw, 0, {}});
      CHECK(bench.errors.empty());
      return got;
    };
    const auto two = read({.points = {{623.4, 98.1}, {123.4, 0}}}, {123.4, 623.4, 1123.4, -376.6});
    REQUIRE(two.size() == 4);
    CHECK(std::abs(two[0]) < 1e-12);
    CHECK(two[1] == 98.1);
    CHECK(two[2] == doctest::Approx(196.2));
    CHECK(two[3] == doctest::Approx(-98.1));
    // Anscombe's first set: y = 3.00009 + 0.500091 x, whose largest residual is that of its third point, -1.92127.
    const std::vector<std::array<double, 2>> anscombe = {{10, 8.04},  {8, 6.95},  {13, 7.58}, {9, 8.81},
                                                         {11, 8.33},  {14, 9.96}, {6, 7.24},  {4, 4.26},
                                                         {12, 10.84}, {7, 4.82},  {5, 5.68}};
    const CalibrationLine line = line_through(anscombe);
    CHECK(line.slope == doctest::Approx(0.5000909).epsilon(1e-6));
    CHECK(line.value(0) == doctest::Approx(3.0000909).epsilon(1e-6));
    CHECK(line.farthest == 2);
    CHECK(line.largest == doctest::Approx(-1.9212727).epsilon(1e-6));
    CHECK(read({.points = anscombe}, {0, 100}) == std::vector<double>{line.value(0), line.value(100)});
    // The raw values of a 24-bit converter whose points lie near each other.
    const CalibrationLine near = line_through(
        std::vector<std::array<double, 2>>{{8388600, 0}, {8388601, 0.25}, {8388602, 0.5}, {8388603, 0.75}});
    CHECK(near.value(8388604) == 1.0);
    CHECK(near.largest == 0);
  }

  TEST_CASE("US-27 a tare is subtracted from the calibrated value, after its bounds and before the filters") {
    Bench bench({{"level",
                  {.calibration = Calibration{.scale = 2, .most = 100, .tare = 20},
                   .filters = {Filter::clamp(0, std::nullopt)}}}});
    for (const double raw : {10.0, 25.0, 50.0, 51.0, 1.0}) bench.publish({raw, 0, {}});
    CHECK(bench.events ==
          std::vector<std::string>{"0 0 absent 10", "30 0 absent 25", "80 0 absent 50", "0 0 absent 1"});
    REQUIRE(bench.errors.size() == 1);
    CHECK(has(bench.errors[0], "102 is above 100"));
  }

  TEST_CASE("US-27 recordings have the points and the tare, and other numbers are another version") {
    const auto text = [](Calibration c) { return detail::text_of({{"level", calibrated(std::move(c))}}, "tank"); };
    const std::vector<std::array<double, 2>> points{{123.4, 0}, {623.4, 98.1}};
    CHECK(has(text({.version = "lab", .points = points, .tare = 0.5}),
              R"("version": "lab, tare 0.5", "calibration": {"points": [[123.4, 0.0], [623.4, 98.1]], "tare": 0.5})"));
    CHECK(has(text({.version = "lab", .points = points}), R"("version": "lab", "calibration": {"points": )"));
    const auto version = [&](Calibration c) { return text(std::move(c)).substr(0, 66); };
    CHECK(has(version({.points = points}), R"("version": ")"));
    CHECK(version({.points = points}) != version({.points = {points[1], points[0]}}));
    CHECK(version({.points = points}) != version({.points = points, .tare = 0.5}));
  }

  TEST_CASE("US-27 the value of a raw one, outside any sensor, is what a sensor publishes") {
    for (unsigned seed = 0; seed < 300; ++seed) {
      CAPTURE(seed);
      Dice dice(seed);
      FieldProcessing what = any_processing(dice);
      if (!what.calibration) continue;
      what.filters.clear();
      what.calibration->most.reset();
      ByHand by_hand(what);
      for (int i = 0; i < 50; ++i) {
        const double raw = dice.number(-50, 50);
        const double got = rtdata::calibrated(*what.calibration, raw);
        const std::optional<double> wanted = by_hand.value(raw);
        REQUIRE(std::isfinite(got) == wanted.has_value());
        if (!wanted) continue;
        const bool is_near = std::abs(got - *wanted) <= 1e-11 * (1 + std::abs(*wanted));
        CHECK_MESSAGE(is_near, got, " instead of ", *wanted);
      }
    }
  }

  TEST_CASE("US-27 samples while a sensor warms up are filtered and counted: after its start, a fault and a stop") {
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    std::vector<std::string> log;
    loop.runtime().on_log(
        [&](const LogRecord& record) { log.push_back(std::string(record.object) + ": " + std::string(record.text)); });
    bool is_broken = false;
    struct Device {
      bool* is_broken;
      Result<void> open() {
        return *is_broken ? Result<void>(Error{Errc::io_failed, "no", "", "", ""}) : Result<void>();
      }
      Result<Level> read() {
        if (*is_broken) return Error{Errc::io_failed, "no", "", "", ""};
        return Level{1, 0, {}};
      }
    };
    Sensor<Level> sensor(loop,
                         {.name = "gas",
                          .rate = 10_Hz,
                          .faulted_after = 1,
                          .retry_first = 1s,
                          .retry_longest = 1s,
                          .process = {{"level", calibrated({.scale = 2})}},
                          .warm_up = 2s},
                         Device{&is_broken});
    loop.advance(1999ms);
    CHECK(sensor.counts().filtered == 20);
    CHECK(sensor.counts().published == 0);
    loop.advance(1s);
    CHECK(sensor.counts().published == 10);
    CHECK(sensor.health() == Health::ok);
    is_broken = true;
    loop.advance(100ms);
    is_broken = false;
    CHECK(sensor.health() == Health::faulted);
    loop.advance(10s);
    CHECK(sensor.counts().filtered == 40);
    const std::uint64_t published = sensor.counts().published;
    CHECK(published > 60);
    sensor.stop();
    loop.advance(1s);
    sensor.start();
    loop.advance(1999ms);
    CHECK(sensor.counts().filtered == 60);
    CHECK(sensor.counts().published == published);
    CHECK(sensor.counts().balances());
    CHECK(std::count(log.begin(), log.end(),
                     "sensor gas: warms up for 2 s: its samples are discarded until then (counted as filtered)") == 3);
  }

  TEST_CASE("US-27 what a device took while it warmed up is filtered when it comes later; its clock may be wrong") {
    Loop loop{Loop::Manual{}};
    be_quiet(loop);
    Feed<Level> feed(loop, {.name = "tank", .warm_up = 1s});
    Time start{};
    Feed<Level> clock(loop, {.name = "clock"});
    const auto heard = loop.subscribe("clock", [&](const EventView& event) { start = event.time(); });
    clock.publish({});
    loop.advance(1500ms);
    feed.publish({1, 0, {}}, start + 900ms);
    CHECK(feed.counts().filtered == 1);
    feed.publish({1, 0, {}}, start + 1s);
    feed.publish({1, 0, {}}, start - std::chrono::hours{1000});
    CHECK(feed.counts().filtered == 1);
    CHECK(feed.counts().published == 2);
    loop.advance(10s);
    feed.publish({1, 0, {}}, start + 900ms);
    CHECK(feed.counts().filtered == 2);  // late, but not warm
    feed.publish({1, 0, {}}, start + 900ms);
    feed.fault({Errc::io_failed, "gone", "", "", ""});
    feed.publish({1, 0, {}});
    CHECK(feed.counts().filtered == 4);
    CHECK(feed.health() == Health::ok);
    CHECK(feed.counts().balances());
  }

  TEST_CASE("US-27 what is not finite, or outside its bounds, is unreadable and never a value") {
    const auto unreadable = [](Processing process, const Level& level) {
      Bench bench(std::move(process));
      bench.publish(level);
      CHECK(bench.events.empty());
      CHECK(bench.feed.counts().unreadable == 1);
      CHECK(bench.feed.counts().balances());
      return bench.errors.empty() ? "" : bench.errors.front();
    };
    const double nan = std::numeric_limits<double>::quiet_NaN();
    CHECK(has(unreadable({{"level", filtered({Filter::median(3)})}}, {nan, 0, {}}), "it is nan"));
    CHECK(has(unreadable({{"level", calibrated({.polynomial = {0, 0, 1}})}}, {1e300, 0, {}}), "not a finite number"));
    CHECK(has(unreadable({{"level", {.calibration = Calibration{.scale = 1e10}, .filters = {Filter::median(3)}}}},
                         {1e305, 0, {}}),
              "not a finite number"));
    // No clamp makes a value of what is none.
    CHECK(has(unreadable({{"level", {.calibration = Calibration{.scale = 1e10}, .filters = {Filter::clamp(0, 1)}}}},
                         {1e305, 0, {}}),
              "not a finite number"));
    CHECK(has(
        unreadable({{"level", calibrated({.scale = 1e10, .table = {{0, 0}, {1, 1}}, .outside = OutsideTable::clamp})}},
                   {1e305, 0, {}}),
        "not a finite number"));
    // As a float.
    CHECK(has(unreadable({{"maybe", calibrated({.scale = 1e30})}}, {0, 0, 1e20f}), "not a finite number"));
    CHECK(has(unreadable({{"level", calibrated({.least = 0})}}, {-0.5, 0, {}}), "-0.5 is below 0 (`least`)"));
    CHECK(has(unreadable({{"level", calibrated({.most = 9})}}, {9.5, 0, {}}), "9.5 is above 9 (`most`)"));
  }

  TEST_CASE("US-27 a scheduled sensor fails the read of an unusable value, and a gap says so") {
    Loop loop(Loop::Manual{});
    be_quiet(loop);
    double value = 1;
    Sensor<Climate> room(
        loop, {.name = "room", .rate = 10_Hz, .process = {{"humidity", calibrated({.least = 0, .most = 100})}}}, [&] {
          return Climate{0, value};
        });
    std::vector<std::string> errors;
    room.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
    loop.advance(495ms);
    value = 101;
    loop.advance(1s);
    CHECK(room.health() == Health::degraded);
    value = 2;
    loop.advance(500ms);
    const SensorCounts counts = room.counts();
    CHECK(counts.scheduled == 20);
    CHECK(counts.taken == 10);
    CHECK(counts.failed == 10);  // each was read: the device is not taken for faulty
    CHECK(counts.unreadable == 10);
    CHECK(counts.published == 10);
    CHECK(counts.balances());
    CHECK_FALSE(errors.empty());
    CHECK(room.health() == Health::ok);
  }

  TEST_CASE("US-27 a throttle lets pass at most one in its time, and what others need goes with it") {
    Loop loop(Loop::Manual{});
    std::vector<Time> times;
    const auto handler = loop.subscribe("room", [&](const EventView& event) { times.push_back(event.time()); });
    unsigned ticks = 0;
    Sensor<Climate> room(
        loop,
        {.name = "room",
         .rate = 100_Hz,
         .process = {{"temperature", filtered({Filter::throttle(95ms)})}, {"humidity", filtered({Filter::delta(1)})}}},
        [&] {
          return Climate{0, ++ticks < 50 ? 0.0 : 5.0};
        });
    loop.advance(995ms);
    // Each 100 ms, and once when the humidity has changed.
    REQUIRE(times.size() == 11);
    CHECK(room.counts().taken == 100);
    CHECK(room.counts().filtered == 89);
    CHECK(room.counts().balances());
    CHECK(times[1] - times[0] == 100ms);
  }

  TEST_CASE("US-27 a rate of change is a field of its own, absent where nobody knows it") {
    Bench bench({{"level", filtered({Filter::rate_of_change()})}});
    const auto description = bench.loop.runtime().topics().front().description;
    CHECK(description->find("level.rate")->unit == "V/s");
    CHECK(description->find("level.raw") == nullptr);
    bench.publish({1, 0, {}});
    bench.publish({1.5, 0, {}});
    bench.feed.publish({7, 0, {}});
    bench.feed.publish({8, 0, {}});  // at the same time
    bench.loop.advance(10ms);
    bench.feed.lost(1);  // a gap
    bench.publish({2, 0, {}});
    bench.publish({1, 0, {}});
    CHECK(bench.events == std::vector<std::string>{"1 0 absent absent", "1.5 0 absent 50", "7 0 absent 550",
                                                   "8 0 absent 650", "2 0 absent absent", "1 0 absent -100"});
  }

  TEST_CASE("US-27 filters begin anew after a gap, a fault, a stop, an absent value and a change of the processing") {
    const FieldProcessing median = filtered({Filter::median(3)});
    const auto published = [&](const std::function<void(Bench&)>& between) {
      Bench bench({{"level", median}, {"maybe", median}});
      bench.publish({1, 0, 1.0f});
      bench.publish({1, 0, 1.0f});
      between(bench);
      bench.publish({9, 0, 9.0f});
      return bench.events.back();
    };
    const Error error{Errc::bad_data, "cannot read", "", "", ""};
    CHECK(published([](Bench&) {}) == "1 0 1 9 9");
    CHECK(published([&](Bench& bench) { bench.feed.fail(error); }) == "9 0 9 9 9");
    CHECK(published([&](Bench& bench) { bench.feed.fault(error); }) == "9 0 9 9 9");
    CHECK(published([](Bench& bench) { bench.feed.lost(2); }) == "9 0 9 9 9");
    CHECK(published([](Bench& bench) { bench.feed.repeated(); }) == "1 0 1 9 9");
    CHECK(published([](Bench& bench) {
            bench.feed.stop();
            bench.feed.start();
          }) == "9 0 9 9 9");
    CHECK(published([&](Bench& bench) {
            bench.feed.set_processing({{"level", median}, {"maybe", median}});
          }) == "9 0 9 9 9");
    CHECK(published([](Bench& bench) { bench.publish({1, 0, std::nullopt}); }) == "1 0 9 9 9");
    CHECK(published([](Bench& bench) {  // a time that goes back
            bench.feed.publish({1, 0, 1.0f}, Time{} + 1s);
            bench.loop.advance(10ms);
          }) == "5 0 5 9 9");
  }

  TEST_CASE("US-27 the processing changes while a sensor runs, but not what its topic carries") {
    Bench bench({{"level", calibrated({.scale = 2})}});
    bench.publish({1, 0, {}});
    bench.feed.set_processing({{"level", calibrated({.scale = 3})}});
    bench.publish({1, 0, {}});
    CHECK(bench.events == std::vector<std::string>{"2 0 absent 1", "3 0 absent 1"});
    const auto refusal = [&](const Processing& next) {
      try {
        bench.feed.set_processing(next);
      } catch (const SetupError& refused) {
        return std::string(refused.what());
      }
      return std::string();
    };
    CHECK(has(refusal({}), "its topic carries other values until the end of the run: field level.raw: only here"));
    CHECK(has(refusal({{"level", {.calibration = Calibration{}, .unit = "bar"}}}), "unit V here, bar there"));
    CHECK(has(refusal({{"levl", calibrated({})}}), "did you mean level?"));
    bench.publish({1, 0, {}});
    CHECK(bench.events.back() == "3 0 absent 1");
  }

  TEST_CASE("US-27 arrays and records: a whole array, or one of its elements") {
    Loop loop(Loop::Manual{});
    Feed<Everything> feed(loop, {.name = "all",
                                 .process = {{"numbers", calibrated({.scale = 2})},
                                             {"points[1].x", calibrated({.offset = 1})},
                                             {"u16", filtered({Filter::mean(2)})},
                                             {"maybes", calibrated({.scale = 0.5})}}});
    Everything all = payloads::full();
    all.numbers = {1, 2, 3};
    all.points[1].x = 10;
    all.maybes = {std::optional<std::uint32_t>(3), std::nullopt};
    std::map<std::string, std::string> values;
    const auto view = loop.subscribe("all", [&](const EventView& event) {
      for (const Leaf& leaf : event.description().leaves()) values[leaf.path] = to_string(event.value(leaf));
    });
    all.u16 = 4;
    feed.publish(all);
    all.u16 = 7;
    feed.publish(all);
    loop.poll();
    const std::map<std::string, std::string> wanted{
        {"numbers[0]", "2"},       {"numbers[2]", "6"},    {"numbers.raw[2]", "3"},    {"points[1].x", "11"},
        {"points[1].x.raw", "10"}, {"u16", "5.5"},         {"u16.raw", "7"},           {"maybes[0]", "1.5"},
        {"maybes[1]", "absent"},   {"maybes.raw[0]", "3"}, {"maybes.raw[1]", "absent"}};
    for (const auto& entry : wanted) {
      const std::string& path = entry.first;
      CAPTURE(path);
      CHECK(values[path] == entry.second);
    }
    // All others are as they were.
    for (const Leaf& leaf : description_of<Everything>()->leaves()) {
      if (wanted.contains(leaf.path) || leaf.path == "numbers[1]") continue;
      CAPTURE(leaf.path);
      CHECK(values[leaf.path] == to_string(read(leaf, reinterpret_cast<const std::byte*>(&all))));
    }
  }

  TEST_CASE("US-17 what is wrong with a processing is told") {
    CHECK(mistake({{"f64", calibrated({.scale = 2})}}).empty());
    CHECK(has(mistake({{"f6", calibrated({.scale = 2})}}), "no such field: did you mean f64?"));
    CHECK(has(mistake({{"origin_point", calibrated({})}}), "there is no such field"));
    CHECK(has(mistake({{"points.x", calibrated({})}}), "there is no such field"));
    CHECK(has(mistake({{"numbers[3]", calibrated({})}}), "there is no such field"));
    CHECK(has(mistake({{"numbers[00]", calibrated({})}}), "there is no such field"));
    CHECK(has(mistake({{"name", calibrated({})}}), "it is of type text"));
    CHECK(has(mistake({{"flag", filtered({Filter::delta(1)})}}), "it is of type bool"));
    CHECK(has(mistake({{"state", filtered({Filter::delta(1)})}}), "it is of type enum"));
    CHECK(has(mistake({{"points[0].label", calibrated({})}}), "this element would become a double"));
    CHECK(mistake({{"points[0].label", filtered({Filter::delta(1), Filter::rate_of_change()})}}).empty());
    CHECK(has(mistake({{"numbers", calibrated({})}, {"numbers[1]", calibrated({})}}), "numbers[1] is named twice"));
    CHECK(has(mistake({{"numbers[1]", {.calibration = Calibration{}, .unit = "V"}}}), "elements of an array have one"));
    CHECK(has(mistake({{"f64", {}}}), "there is nothing to do"));
    CHECK(has(mistake({{"f64", {.filters = {Filter::median(3)}, .unit = "V"}}}),
              "a value without a calibration keeps its unit"));
    CHECK(has(mistake({{"f64", calibrated({.scale = 0})}}), "calibration.scale"));
    CHECK(has(mistake({{"f64", calibrated({.offset = NAN})}}), "calibration.offset"));
    CHECK(has(mistake({{"f64", calibrated({.polynomial = {1}})}}), "it has 1 coefficients"));
    CHECK(has(mistake({{"f64", calibrated({.polynomial = std::vector<double>(11, 1)})}}), "use 2 to 10"));
    CHECK(has(mistake({{"f64", calibrated({.polynomial = {1, 2}, .table = {{0, 0}, {1, 1}}})}}), "polynomial already"));
    CHECK(has(mistake({{"f64", calibrated({.table = {{0, 0}}})}}), "it has 1 points"));
    CHECK(has(mistake({{"f64", calibrated({.table = {{0, 0}, {2, 1}, {2, 3}}})}}),
              "calibration.table[2]: the table is not in ascending order"));
    CHECK(has(mistake({{"f64", calibrated({.table = std::vector<std::array<double, 2>>(1001)})}}), "1001 points"));
    CHECK(has(mistake({{"f64", calibrated({.least = 2, .most = 1})}}), "calibration.least: it is above `most`"));
    CHECK(has(mistake({{"f64", filtered({Filter::median(4)})}}),
              "filters[0].of: 4 samples are not possible, for a median"));
    CHECK(has(mistake({{"f64", filtered({Filter::median(257)})}}), "an odd number from 3 to 255"));
    CHECK(has(mistake({{"f64", filtered({Filter::mean(1001)})}}), "a number from 2 to 1000"));
    CHECK(has(mistake({{"f64", filtered({{.type = FilterType::mean}})}}), "the number of samples is missing"));
    CHECK(has(mistake({{"f64", filtered({Filter::exponential(0)})}}), "filters[0].weight"));
    CHECK(has(mistake({{"f64", filtered({Filter::exponential(1.5)})}}), "filters[0].weight"));
    CHECK(has(mistake({{"f64", filtered({Filter::clamp({}, {})})}}), "it has no limit"));
    CHECK(has(mistake({{"f64", filtered({Filter::clamp(2, 1)})}}), "above `most`"));
    CHECK(has(mistake({{"f64", filtered({Filter::throttle(0s)})}}), "the time is missing"));
    CHECK(has(mistake({{"f64", filtered({Filter::delta(-1)})}}), "the amount is missing"));
    CHECK(has(mistake({{"f64", filtered({Filter::rate_of_change(), Filter::rate_of_change()})}}),
              "there is already a rate of change"));
    CHECK(has(mistake({{"f64", filtered(std::vector<Filter>(9, Filter::median(3)))}}), "at most 8"));
    Loop loop(Loop::Manual{});
    struct Bare {
      int x = 0;
    };
    CHECK_THROWS_WITH_AS(Feed<Bare>(loop, {.name = "bare", .process = {{"x", calibrated({})}}}),
                         doctest::Contains("its payload has no description"), SetupError);
    CHECK(loop.runtime().sensors().empty());
  }

  TEST_CASE("US-27 any processing of any values is what it is by hand, and the ledger balances") {
    for (unsigned seed = 0; seed < 200; ++seed) {
      CAPTURE(seed);
      Dice dice(seed);
      const FieldProcessing what = any_processing(dice);
      ByHand by_hand(what);
      Loop loop(Loop::Manual{});
      be_quiet(loop);
      Feed<Level> feed(loop, {.name = "tank", .process = {{"level", what}}});
      std::vector<double> got;
      const auto view = loop.subscribe("tank", [&](const EventView& event) {
        got.push_back(std::get<double>(event.value(*event.description().find("level"))));
      });
      const bool decides = std::any_of(what.filters.begin(), what.filters.end(),
                                       [](const Filter& f) { return f.type == FilterType::delta; });
      std::vector<double> wanted;
      std::uint64_t unreadable = 0, held = 0;
      for (int i = 0; i < 300; ++i) {
        if (dice.whole(0, 40) == 0) {
          feed.fail({Errc::bad_data, "cannot read", "", "", ""});
          by_hand.restart();
          ++unreadable;
        }
        double raw = dice.whole(0, 3) == 0 ? std::round(dice.number(-3, 3)) : dice.number(-30, 30);
        if (dice.whole(0, 200) == 0) raw = 1e300;
        feed.publish({raw, 0, {}});
        std::optional<double> value = by_hand.value(raw);
        if (value && !std::isfinite(*value)) value.reset();
        if (!value) {
          ++unreadable;
          by_hand.restart();
        } else if (decides && !by_hand.passes()) {
          ++held;
        } else {
          wanted.push_back(*value);
        }
        loop.advance(1ms);
      }
      const SensorCounts counts = feed.counts();
      CHECK(counts.unreadable == unreadable);
      CHECK(counts.filtered == held);
      CHECK(counts.balances());
      REQUIRE(got.size() == wanted.size());
      for (std::size_t i = 0; i < got.size(); ++i) {
        CAPTURE(i);
        const bool is_near = std::abs(got[i] - wanted[i]) <= 1e-11 * (1 + std::abs(wanted[i]));
        CHECK_MESSAGE(is_near, got[i], " instead of ", wanted[i]);
      }
    }
  }

  TEST_CASE("US-27 a mean forgets a value that was huge") {
    Bench bench({{"level", filtered({Filter::mean(3)})}});
    for (const double x : {1.0, 1e300, 2.0, 3.0, 4.0, 5.0}) bench.publish({x, 0, {}});
    CHECK(bench.events[4] == "3 0 absent 4");
    CHECK(bench.events[5] == "4 0 absent 5");
  }

  TEST_CASE("US-12 US-27 a driver's readings on a lane are calibrated, and an unusable one fails its read") {
    const auto wires = std::make_shared<FakeI2c>();
    FakeI2cChip& chip = wires->chip(0x48);
    chip.set_width(FakeI2cChip::Width::words);
    chip.set_word(0, 0x1900);  // 25
    I2cBus bus("i2c1", wires, {});
    Loop loop(Loop::Manual{});
    be_quiet(loop);
    DriverSensor<Lm75> room(
        loop,
        {.name = "room",
         .rate = 10_Hz,
         .process = {{"temperature",
                      {.calibration = Calibration{.scale = 1.8, .offset = 32, .most = 100}, .unit = "[degF]"}}}},
        bus);
    std::vector<double> values;
    const auto view = loop.subscribe("room", [&](const EventView& event) {
      values.push_back(std::get<double>(event.value(*event.description().find("temperature"))));
    });
    loop.advance(495ms);
    chip.set_word(0, 0x3200);  // 50
    loop.advance(200ms);
    CHECK(values == std::vector<double>(5, 77));
    CHECK(room.counts().failed == 2);
    CHECK(room.counts().unreadable == 2);
    room.stop();
    CHECK(room.counts().balances());
  }

  TEST_CASE("US-13 US-27 lines of a serial port are calibrated; one that cannot be used costs no other anything" *
            doctest::skip(!terminals_can_be_set_up())) {
    ScratchDirectory directory;
    Pty pty(directory.file("tty"));
    pty.plug_in();
    Loop loop;
    be_quiet(loop);
    SerialConfig config{.device = pty.path(), .lines = {.fields = {{.name = "volts", .unit = "V"}}}};
    config.lines.first_line = FirstLine::keep;
    SerialLineSensor line(
        loop,
        {.name = "line",
         .process = {{"volts", {.calibration = Calibration{.scale = 10, .most = 50}, .filters = {Filter::delta(5)}}}}},
        config);
    std::vector<std::string> errors;
    line.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
    std::vector<double> values;
    const auto view = loop.subscribe("line", [&](const EventView& event) {
      values.push_back(std::get<double>(event.value(*event.description().find("volts"))));
      if (values.back() == 40) loop.stop();
    });
    Timer limit(loop, 60s, [&] { loop.stop(); });
    REQUIRE(pty.send("1\n1.4\n1.6\n9\n2\n4\n") > 0);
    loop.run();
    CHECK(values == std::vector<double>{10, 16, 20, 40});  // after the 9 the delta begins anew
    CHECK(line.counts().received == 6);
    CHECK(line.counts().filtered == 1);
    CHECK(line.counts().unreadable == 1);
    CHECK(line.counts().balances());
    REQUIRE(errors.size() == 1);
    CHECK(has(errors[0], "90 is above 50"));
  }
}
