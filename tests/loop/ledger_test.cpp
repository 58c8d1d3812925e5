#include "rtdata/loop/ledger.hpp"

#include <doctest/doctest.h>

#include <string>
#include <vector>

#include "loop/observed.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using observed::Number;

namespace {

/// Notes what a recording would hold of the account.
struct Account final : detail::Recorder {
  struct NamedGap {
    Gap::Kind kind;
    std::string reason;
    Duration first, last;  // since the start of the run
    std::uint64_t count;
    bool operator==(const NamedGap&) const = default;
  };
  explicit Account(Runtime& runtime) : core(runtime.core()) { core.attach(*this); }
  ~Account() { core.detach(*this); }
  Duration since_start(Time time) const { return time - core.clock_log.start().realtime; }
  Result<void> on_topic(detail::TopicCore&) override { return {}; }
  void on_gap(detail::OriginCore&, const Gap& gap) override {
    gaps.push_back({gap.kind, std::string(gap.reason), since_start(gap.first), since_start(gap.last), gap.count});
  }
  void on_segment(detail::OriginCore&, const Segment& segment) override { segments.push_back(segment); }
  void on_clock(const ClockPair&) override {}
  void on_error(Time, Time, std::string_view, const Error&, std::uint64_t) override {}
  SinkStatus status() const override { return {}; }
  const std::string& name() const noexcept override { return name_; }
  SinkCounts counts() const noexcept override { return {}; }
  const std::string name_;
  void drain(MonotonicTime, Callback<void(std::uint64_t)> done) override { done(0); }
  detail::RuntimeCore& core;
  std::vector<NamedGap> gaps;
  std::vector<Segment> segments;
};

}  // namespace

TEST_SUITE("loop") {
  TEST_CASE("the equations of the ledger hold or not") {
    SensorCounts sensor;
    sensor.has_schedule = true;
    sensor.scheduled = 10;
    sensor.taken = 6;
    sensor.missed = 2;
    sensor.failed = 1;
    sensor.in_flight = 1;
    sensor.published = 4;
    sensor.repeated = 1;
    sensor.filtered = 1;
    sensor.unreadable = 26;
    sensor.received = 32;
    CHECK(sensor.balances());
    CHECK(sensor.has_loss());
    for (auto term : {&SensorCounts::scheduled, &SensorCounts::taken, &SensorCounts::missed, &SensorCounts::failed,
                      &SensorCounts::in_flight, &SensorCounts::received, &SensorCounts::published,
                      &SensorCounts::repeated, &SensorCounts::filtered, &SensorCounts::unreadable}) {
      SensorCounts off = sensor;
      ++(off.*term);
      CHECK_FALSE(off.balances());
    }
    SensorCounts feed;
    feed.received = 4;
    feed.published = feed.repeated = feed.filtered = feed.unreadable = 1;
    CHECK(feed.balances());
    CHECK(feed.has_loss());
    ++feed.received;
    CHECK_FALSE(feed.balances());
    --feed.received;
    feed.lost = 5;  // stands beside the equation
    CHECK(feed.balances());
    ++feed.failed;  // without a schedule there are no reads
    CHECK_FALSE(feed.balances());
    CHECK(SubscriptionCounts{.offered = 10, .delivered = 4, .dropped = 3, .cancelled = 2, .queued = 1}.balances());
    CHECK_FALSE(SubscriptionCounts{.offered = 10, .delivered = 4}.balances());
    CHECK(SinkCounts{.offered = 10, .stored = 3, .dropped = {1, 2, 3}, .queued = 1}.balances());
    CHECK_FALSE(SinkCounts{.offered = 10, .stored = 3, .dropped = {1, 2, 3}, .queued = 2}.balances());
  }

  TEST_CASE("an outage of a source without a schedule is loss: its number and its time") {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    loop.runtime().on_log([](const LogRecord&) {});
    Account account(loop.runtime());
    Feed<Number> board(loop, {.name = "board"});
    const auto outages = [&] { return loop.runtime().sensors().at(0).outages; };
    const Error gone{Errc::disconnected, "cannot hear", "", "it is gone", ""};
    board.publish({1});
    loop.advance(1s);
    CHECK(outages().number == 0);
    CHECK_FALSE(loop.runtime().has_loss());
    board.fault(gone);
    loop.advance(2s);
    board.fault(gone);  // still the same
    loop.advance(500ms);
    CHECK(outages().number == 1);
    CHECK(outages().time == 2500ms);  // it lasts
    CHECK(loop.runtime().has_loss());
    board.publish({2});
    loop.advance(3s);
    CHECK(outages().time == 2500ms);
    CHECK(to_string(outages()) == "1 outage of 2.5 s");
    board.fault(gone);
    loop.advance(100s);
    loop.close();
    loop.advance(5s);
    CHECK(outages().number == 2);
    CHECK(outages().time == 102500ms);
    CHECK(to_string(outages()) == "2 outages of 1 min 42 s together");
    CHECK(loop.runtime().has_loss());
    CHECK(loop.runtime().balances());
    REQUIRE(account.gaps.size() == 2);
    CHECK(account.gaps[0] == Account::NamedGap{Gap::Kind::disconnected, "disconnected", 1s, 3500ms, 0});
    CHECK(account.gaps[1].last - account.gaps[1].first == 100s);
  }

  TEST_CASE("outages are told in the unit that fits") {
    CHECK(to_string(Outages{1, 0s}) == "1 outage of unknown length");
    CHECK(to_string(Outages{2, 0s}) == "2 outages of unknown length");
    CHECK(to_string(Outages{1, 3600s}) == "1 outage of 1 h");
    CHECK(to_string(Outages{40, 12min, true}) == "40 outages of at most 12 min together");
    CHECK(to_string(Outages{3, 50h}) == "3 outages of 2 d 2 h together");
  }

  TEST_CASE("a segment's ticks are computed from its start, period and end") {
    CHECK(Segment{Time{10s}, 1s, Time{10s}, 0}.computed() == 1);
    CHECK(Segment{Time{10s}, 1s, Time{13s}, 0}.computed() == 4);
    CHECK(Segment{Time{10s}, 1s, Time{13s} - 1ns, 0}.computed() == 3);
    CHECK(Segment{Time{10s}, 1s, Time{10s} - 1ns, 0}.computed() == 0);
    CHECK(Segment{Time{10s}, 0s, Time{13s}, 0}.computed() == 0);
  }

  TEST_CASE("segments begin and end with schedules, and each ends with what was scheduled in it") {
    Loop loop(Loop::Manual{});
    Account account(loop.runtime());
    loop.on_error([](const ErrorReport&) {});
    bool hold = false;
    Sensor<Number> sensor(loop, {.name = "s", .rate = 100_Hz}, [&] {
      if (hold) loop.manual_clock().pass(137ms);
      hold = false;
      return Number{};
    });
    loop.advance(234ms);
    sensor.set_rate(1_kHz);
    loop.advance(55ms);
    sensor.stop();
    loop.advance(10ms);
    sensor.start();
    hold = true;
    loop.advance(300ms);
    CHECK(loop.close() == 0);
    REQUIRE(account.segments.size() == 3);
    std::uint64_t sum = 0;
    for (const Segment& segment : account.segments) {
      CHECK(segment.scheduled > 0);
      CHECK(segment.computed() == segment.scheduled);
      sum += segment.scheduled;
    }
    CHECK(sensor.counts().scheduled == sum);
    CHECK(sensor.counts().missed > 0);
    CHECK(sensor.counts().balances());
  }

  TEST_CASE("gaps merge while the reason is the same, and close at the next reading or at the end") {
    Loop loop(Loop::Manual{});
    Account account(loop.runtime());
    loop.on_error([](const ErrorReport&) {});
    loop.runtime().on_log([](const LogRecord&) {});
    int reads = 0;
    Sensor<Number> sensor(loop, {.name = "s", .rate = 100_Hz, .faulted_after = 100}, [&]() -> Result<Number> {
      ++reads;
      if (reads == 3 || reads == 4) return Error{Errc::io_failed, "bad", "", "", ""};
      if (reads == 5) return Error{Errc::timed_out, "slow", "", "", ""};
      if (reads == 8) loop.manual_clock().pass(35ms);
      if (reads >= 11) return Error{Errc::io_failed, "bad", "", "", ""};
      return Number{};
    });
    loop.advance(150ms);
    CHECK(account.gaps.size() == 3);
    sensor.stop();
    using Kind = Gap::Kind;
    const std::vector<Account::NamedGap> expected{{Kind::failed, "io-failed", 20ms, 30ms, 2},
                                                  {Kind::failed, "timed-out", 40ms, 40ms, 1},
                                                  {Kind::missed, "loop held", 80ms, 90ms, 2},
                                                  {Kind::failed, "io-failed", 120ms, 150ms, 4}};
    CHECK(account.gaps == expected);
    std::uint64_t absent = 0;
    for (const auto& gap : account.gaps) absent += gap.count;
    CHECK(absent == sensor.counts().missed + sensor.counts().failed);
    CHECK(loop.runtime().balances());
    CHECK(loop.runtime().has_loss());
  }

  TEST_CASE("late is the part of taken that began later than the tolerance") {
    Loop loop(Loop::Manual{});
    Duration hold{};
    Ticker first(loop, 100ms, [&](const Tick&) { loop.manual_clock().pass(hold); });
    Sensor<Number> sensor(loop, {.name = "s", .rate = 10_Hz, .late_after = 2ms}, [] { return Number{}; });
    hold = 2ms;
    loop.advance(250ms);
    CHECK(sensor.counts().late == 0);
    hold = 2ms + 1ns;
    loop.advance(100ms);
    CHECK(sensor.counts().late == 1);
    CHECK(sensor.counts().taken == sensor.counts().scheduled);
    CHECK_FALSE(loop.runtime().has_loss());
  }
}
