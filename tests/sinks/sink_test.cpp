// What a sink does with its writer, told by a script.
#include <doctest/doctest.h>
#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <thread>

#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sinks/recording_writer.hpp"
#include "sinks/core/sink_notes.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;

namespace {

using Script = ScriptedWriter::Script;

SinkConfig config() {
  return {.name = "script", .batch_rows = 10, .batch_time = 1s, .queue_bytes = 256 << 10, .retry_first = 100ms};
}

struct Large {
  std::array<double, 500> values{};
  friend constexpr auto describe(type_tag<Large>) { return record("large", field("values", &Large::values)); }
};

struct Bench {
  Loop loop{Loop::Manual{}};
  std::shared_ptr<Script> script = std::make_shared<Script>();
  std::vector<std::string> errors;
  std::vector<std::uint64_t> error_counts;
  double published = 0;

  Bench() {
    loop.on_error(
        [this](const ErrorReport& report) { errors.push_back(std::string(report.object) + ": " + report.error.what); });
  }
  Sink make(SinkConfig with = config()) {
    Sink sink(loop, std::move(with), std::make_unique<ScriptedWriter>(script));
    sink.on_error([this](const ErrorReport& report) {
      errors.push_back(std::string(report.object) + ": " + report.error.what);
      error_counts.push_back(report.count);
    });
    return sink;
  }
  void publish(int count) {
    for (int i = 0; i < count; ++i) loop.topic<Number>("a").publish({++published});
  }
  void check_all_once() const {
    REQUIRE(script->rows.size() == static_cast<std::size_t>(published));
    for (std::size_t i = 0; i < script->rows.size(); ++i)
      CHECK(script->rows[i] == Row{"a", i + 1, static_cast<double>(i + 1)});
  }
};

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("in virtual time a sink with nothing to do has no ticks, and those that it has come when they always do") {
    Loop loop{Loop::Manual{}};
    const auto script = std::make_shared<ScriptedWriter::Script>();
    std::vector<MonotonicTime> stored;
    script->before_write = [&] { stored.push_back(loop.now()); };
    const auto ticks = [&] {
      for (const CallbackStatus& status : loop.callbacks())
        if (status.name == "sink script") return status.times.count;
      return std::uint64_t{0};
    };
    Sink sink(loop, {.name = "script", .batch_rows = 100, .batch_time = 1s}, std::make_unique<ScriptedWriter>(script));
    loop.advance(300ms);
    loop.topic<Number>("a").publish({1});
    loop.advance(60s);
    REQUIRE(script->rows.size() == 1);
    const MonotonicTime first = stored.front();
    const std::uint64_t before = ticks();
    CHECK(before >= 1);
    loop.advance(24h * 30);
    CHECK(ticks() - before <= 2);
    stored.clear();
    loop.topic<Number>("a").publish({2});
    const MonotonicTime published = loop.now();
    loop.advance(2s);
    REQUIRE(script->rows.size() == 2);
    CHECK(stored.front() - published <= 1s);
    CHECK((stored.front() - first) % 1s == 0s);
    // A timer is on time, and what it publishes is stored as soon as ever.
    stored.clear();
    MonotonicTime fired{};
    Timer timer(loop, 24h * 30 + 400ms, [&] {
      fired = loop.now();
      loop.topic<Number>("a").publish({3});
    });
    loop.advance(24h * 31);
    CHECK(fired - published == 24h * 30 + 2400ms);
    REQUIRE(script->rows.size() == 3);
    CHECK(stored.front() > fired);
    CHECK(stored.front() - fired <= 1s);
    CHECK((stored.front() - first) % 1s == 0s);
    CHECK(loop.close() == 0);
  }

  TEST_CASE("a batch that fails is tried again, with a delay that doubles, and nothing is lost or doubled") {
    for (const bool throws : {false, true}) {
      Bench bench;
      bench.script->throws = throws;
      Sink sink = bench.make();
      bench.loop.advance(1ms);
      const int before = bench.script->writes;
      bench.script->failures = 3;
      bench.publish(10);
      CHECK(bench.script->writes == before + 1);
      // After 100, 200 and 400 ms, each less up to a quarter.
      bench.loop.advance(75ms);
      CHECK(sink.health() == Health::faulted);
      CHECK(bench.script->writes == before + 1);
      bench.loop.advance(25ms);
      CHECK(bench.script->writes == before + 2);
      bench.publish(25);
      bench.loop.advance(125ms);  // 225 ms
      CHECK(bench.script->writes == before + 2);
      bench.loop.advance(75ms);
      CHECK(bench.script->writes == before + 3);
      bench.loop.advance(225ms);  // 525 ms
      CHECK(bench.script->writes == before + 3);
      bench.loop.advance(175ms);
      CHECK(bench.script->writes > before + 3);
      bench.loop.advance(2s);
      bench.check_all_once();
      CHECK(sink.health() == Health::ok);
      CHECK(sink.counts().stored == 35);
      CHECK(sink.counts().balances());
      CHECK(bench.errors.size() == 3);
      CHECK(bench.errors.front() == (throws ? "sink script: the writer threw" : "sink script: failed by the script"));
    }
  }

  TEST_CASE("sinks that fail together do not come back in step") {
    std::vector<Duration> delays;
    for (const char* name : {"one", "two", "three", "four"}) {
      Bench bench;
      SinkConfig with = config();
      with.name = name;
      const Sink sink = bench.make(with);
      bench.script->failures = 1;
      bench.publish(10);
      const MonotonicTime from = bench.loop.now();
      while (bench.script->rows.empty()) bench.loop.advance(100us);
      delays.push_back(bench.loop.now() - from);
      CHECK(delays.back() >= 75ms);
      CHECK(delays.back() <= 101ms);
    }
    CHECK(*std::max_element(delays.begin(), delays.end()) - *std::min_element(delays.begin(), delays.end()) >= 1ms);
  }

  TEST_CASE("closing in real time waits between its tries, and the deadline ends that wait too") {
    Loop loop;
    loop.on_error([](const ErrorReport&) {});
    const auto script = std::make_shared<Script>();
    SUBCASE("until they are stored") {
      script->failures = 3;
      SinkConfig with = config();
      with.retry_first = 1ms;
      Sink sink(loop, with, std::make_unique<ScriptedWriter>(script));
      loop.topic<Number>("a").publish({1});
      sink.close();
      CHECK(script->rows.size() == 1);
      CHECK(script->has_last_account);
    }
    SUBCASE("until the deadline") {
      script->failures = 1'000'000;
      SinkConfig with = config();
      with.retry_first = with.retry_longest = 1h;
      with.close_deadline = 20ms;
      Sink sink(loop, with, std::make_unique<ScriptedWriter>(script));
      loop.topic<Number>("a").publish({1});
      sink.close();
      CHECK(loop.runtime().sinks().front().counts.all_dropped() == 1);
      while (script->writers.load() > 0) std::this_thread::yield();  // the lane does not wait out its hour
    }
  }

  TEST_CASE("what a recording holds besides events is bounded while storage stalls, and what is left out is counted") {
    detail::SinkNotes notes;
    const Time start{std::chrono::hours{1}};
    const auto at = [&](std::size_t i) { return start + std::chrono::seconds{i}; };
    constexpr std::size_t most_gaps = 4096;
    constexpr std::size_t more = 100;
    for (std::size_t i = 0; i < most_gaps + more; ++i)
      notes.add(0, Gap{Gap::Kind::missed, i == 0 ? "loop held" : "still reading", at(i), at(i), 2}, 1);
    for (std::size_t i = 0; i < detail::SinkNotes::most_segments + more; ++i)
      notes.add(0, Segment{at(i), std::chrono::seconds{1}, at(i), 1});
    for (std::size_t i = 0; i < detail::SinkNotes::most_clock_pairs + more; ++i)
      notes.add(ClockPair{MonotonicTime{std::chrono::seconds{i}}, at(i)});
    for (std::size_t i = 0; i < detail::SinkNotes::most_errors + more; ++i)
      notes.add(at(i), at(i), "object " + std::to_string(i), Error{Errc::io_failed, "it fails", "", "", ""}, 3);
    Account account;
    account.at = at(7);
    notes.report_lost(account.at);
    notes.move_into(account);
    REQUIRE(account.gaps.size() == most_gaps);
    std::uint64_t ticks = 0;
    for (const Account::GapEntry& entry : account.gaps) ticks += entry.gap.count;
    CHECK(ticks == 2 * (most_gaps + more));
    CHECK(account.gaps.back().gap.last == at(most_gaps + more - 1));
    CHECK(account.segments.size() == detail::SinkNotes::most_segments);
    REQUIRE(account.clock.size() == detail::SinkNotes::most_clock_pairs);
    CHECK(account.clock.back().realtime == at(detail::SinkNotes::most_clock_pairs + more - 1));
    REQUIRE(account.errors.size() == detail::SinkNotes::most_errors + 3);
    const auto told = [&](std::string_view what) {
      for (const Account::ErrorEntry& entry : account.errors)
        if (entry.text.find(what) != std::string::npos) return entry.count;
      return std::uint64_t{0};
    };
    CHECK(told("not kept: segments of schedules") == more);
    CHECK(told("not kept: errors") == 3 * more);
    CHECK(told("not kept: pairs of clocks") == more);
    Account next;
    notes.report_lost(next.at);
    notes.move_into(next);
    CHECK(next.is_empty());
  }

  TEST_CASE("closing tries on while the deadline lasts") {
    Bench bench;
    Sink sink = bench.make();
    bench.script->failures = 5;  // 100 + 200 + 400 + 800 + 1600 ms
    bench.publish(7);
    sink.close();
    bench.check_all_once();
    CHECK(bench.script->closes == 1);
    CHECK(bench.script->has_last_account);
    CHECK(bench.loop.now().time_since_epoch() == 3100ms);
  }

  TEST_CASE("what cannot be stored before the deadline of closing is counted as lost") {
    Bench bench;
    Sink sink = bench.make();
    bench.publish(20);
    bench.loop.advance(10ms);
    bench.script->failures = 1'000'000;
    bench.publish(13);
    SUBCASE("of a sink") {
      sink.close();
      CHECK(bench.loop.now().time_since_epoch() == 10s + 10ms);
    }
    SUBCASE("of a loop") {
      CHECK(bench.loop.close(5s) == 13);
      CHECK(bench.script->writes > 5);  // tried often, told once
      CHECK(bench.errors ==
            std::vector<std::string>{"sink script: failed by the script", "sink script: lost 13 events"});
      CHECK(sink.counts().queued == 0);
      CHECK(sink.counts().dropped[static_cast<std::size_t>(DropReason::refused)] == 13);
      bench.script->failures = 0;
      bench.loop.advance(1min);
    }
    CHECK(bench.script->rows.size() == 20);
    const SinkStatus last = bench.loop.runtime().sinks().front();
    CHECK(last.counts.stored == 20);
    CHECK(last.counts.dropped[static_cast<std::size_t>(DropReason::refused)] == 13);
    CHECK(last.counts.balances());
    CHECK(bench.loop.runtime().has_loss());
    CHECK(bench.errors.back() == "sink script: lost 13 events");
  }

  TEST_CASE("refused events are counted and reported once, also when their batch is tried again") {
    Bench bench;
    Sink sink = bench.make();
    bench.script->refused_value = 4;
    bench.script->failures = 2;
    bench.publish(10);
    bench.loop.advance(1s);
    CHECK(sink.counts().stored == 9);
    CHECK(sink.counts().dropped[static_cast<std::size_t>(DropReason::refused)] == 1);
    CHECK(sink.counts().balances());
    CHECK(bench.script->rows.size() == 9);
    REQUIRE(bench.errors.size() == 3);
    CHECK(bench.errors.back() == "sink script: refused by the script");
    CHECK(bench.error_counts == std::vector<std::uint64_t>{1, 1, 1});
  }

  TEST_CASE("a writer that has ended is not tried again, and what comes is refused") {
    Bench bench;
    Sink sink = bench.make();
    bench.publish(10);
    bench.loop.advance(1ms);
    bench.script->ends = true;
    bench.publish(10);
    bench.loop.advance(1min);
    const int writes = bench.script->writes;
    bench.publish(15);
    bench.loop.advance(1min);
    CHECK(bench.script->writes == writes);
    CHECK(sink.health() == Health::faulted);
    CHECK(sink.counts().stored == 10);
    CHECK(sink.counts().dropped[static_cast<std::size_t>(DropReason::refused)] == 25);
    CHECK(sink.counts().balances());
    CHECK(bench.errors == std::vector<std::string>{"sink script: it has ended"});
    CHECK(bench.loop.close(1s) == 0);
    CHECK(bench.loop.runtime().sinks().front().health == Health::faulted);
  }

  TEST_CASE("large events do not wait for the queue to be full") {
    Bench bench;
    SinkConfig with = config();
    with.batch_rows = 100;
    Sink sink = bench.make(with);
    for (int i = 0; i < 1000; ++i) {
      bench.loop.topic<Large>("large").publish({});
      if (i % 20 == 0) bench.loop.advance(1us);  // so that the end of a batch is noticed
    }
    CHECK(sink.counts().all_dropped() == 0);
    bench.loop.advance(2s);
    CHECK(sink.counts().stored == 1000);
  }

  TEST_CASE("a stalled writer does not make the queue small: slow events share its memory") {
    Bench bench;
    Sink sink = bench.make();
    bench.loop.advance(1500ms);
    bench.script->failures = 20;  // for minutes
    for (int second = 0; second < 100; ++second) {
      bench.publish(1);
      bench.loop.advance(1s);
    }
    CHECK(sink.counts().all_dropped() == 0);
    CHECK(sink.counts().offered == 100);
    bench.loop.advance(5min);
    bench.check_all_once();
  }

  TEST_CASE("a topic that the writer refuses is a set-up error, or reported when it comes later") {
    Bench bench;
    bench.script->on_topic = [](std::string_view topic) -> Result<void> {
      if (topic == "no") return Error{Errc::bad_argument, "not this one", std::string(topic), "", ""};
      return {};
    };
    {
      Sink sink = bench.make();
      bench.loop.topic<Number>("no").publish({1});
      bench.publish(1);
      bench.loop.advance(2s);
      CHECK(bench.errors == std::vector<std::string>{"sink script: not this one"});
      CHECK(sink.counts().offered == 2);
      CHECK(sink.counts().dropped[static_cast<std::size_t>(DropReason::refused)] == 1);
      CHECK(sink.health() == Health::faulted);
    }
    CHECK(bench.script->rows.size() == 1);
    CHECK_THROWS_WITH_AS(bench.make(), "not this one: no [bad-argument]", SetupError);
    bench.publish(1);  // no tap is left
    CHECK(bench.loop.runtime().sinks().size() == 1);
  }

  TEST_CASE(
      "a sink's refusal of a topic is reported when all sinks have heard of it, so that its handler may close "
      "another") {
    Bench bench;
    std::vector<std::string> heard;
    bench.script->on_topic = [](std::string_view topic) -> Result<void> {
      if (topic == "no") return Error{Errc::bad_argument, "not this one", std::string(topic), "", ""};
      return {};
    };
    Sink refusing = bench.make();
    auto script = std::make_shared<Script>();
    script->on_topic = [&](std::string_view topic) -> Result<void> {
      heard.emplace_back(topic);
      return {};
    };
    Sink other(bench.loop, config(), std::make_unique<ScriptedWriter>(script));
    bool had_heard = false;
    refusing.on_error([&](const ErrorReport&) {
      had_heard = std::find(heard.begin(), heard.end(), "no") != heard.end();
      other.close();
    });
    bench.loop.topic<Number>("no");
    CHECK(had_heard);
    CHECK_FALSE(other.is_open());
  }

  TEST_CASE("a sink may be closed from its own error handler, and from the loop's") {
    for (const bool own : {true, false}) {
      Bench bench;
      Sink sink(bench.loop, config(), std::make_unique<ScriptedWriter>(bench.script));
      int reports = 0;
      const auto handler = [&](const ErrorReport&) {
        ++reports;
        bench.script->failures = 0;
        sink.close();
      };
      if (own) {
        sink.on_error(handler);
      } else {
        bench.loop.on_error(handler);
      }
      bench.script->failures = 1;
      bench.publish(10);
      bench.loop.advance(1s);
      CHECK(reports == 1);
      CHECK(!sink.is_open());
      bench.check_all_once();
      CHECK(bench.loop.runtime().balances());
    }
  }

  TEST_CASE("a sink closed while its loop drains tells both") {
    Bench bench;
    bench.loop.script_lane_duration(1s);
    Sink sink = bench.make();
    bench.publish(30);
    std::vector<std::uint64_t> lost;
    bench.loop.drain(10s, [&](std::uint64_t count) { lost.push_back(count); });
    bench.loop.drain(10s, [&](std::uint64_t count) { lost.push_back(count); });
    CHECK(lost.empty());
    sink.close();
    CHECK(lost == std::vector<std::uint64_t>{0, 0});
    bench.check_all_once();
  }

  TEST_CASE("every account reaches the writer, the last one last") {
    Bench bench;
    Sink sink = bench.make();
    bench.script->failures = 8;  // longer than four accounts would take
    for (int second = 0; second < 10; ++second) {
      bench.publish(3);
      bench.loop.advance(1s);
    }
    CHECK(bench.loop.close(1min) == 0);
    CHECK(bench.script->has_last_account);
    bench.check_all_once();
  }

  TEST_CASE("accounts of many origins come in parts, a few in each turn, and miss none") {
    constexpr int feeds = 1234;
    struct Accounts final : RecordingWriter {
      explicit Accounts(std::vector<std::vector<std::uint32_t>>& parts_) : parts(parts_) {}
      Result<void> open() override { return {}; }
      Result<void> write(Batch& batch) override {
        if (batch.account() == nullptr) return {};
        parts.emplace_back();
        for (const OriginAccount& origin : batch.account()->origins) parts.back().push_back(origin.slot);
        return {};
      }
      std::vector<std::vector<std::uint32_t>>& parts;
    };
    std::vector<std::vector<std::uint32_t>> parts;
    Loop loop{Loop::Manual{}};
    Sink sink(loop, config(), std::make_unique<Accounts>(parts));
    std::vector<Feed<Number>> all;
    for (int i = 0; i < feeds; ++i) all.emplace_back(loop, FeedConfig{.name = "f" + std::to_string(i), .topic = "a"});
    loop.advance(500ms);
    parts.clear();
    for (int second = 0; second < 3; ++second) {
      for (auto& feed : all) feed.publish({1});
      loop.advance(1s);
      std::vector<std::uint32_t> slots;
      for (const auto& part : parts) {
        CHECK(part.size() <= 500);
        slots.insert(slots.end(), part.begin(), part.end());
      }
      std::sort(slots.begin(), slots.end());
      REQUIRE(slots.size() == feeds);
      for (std::uint32_t i = 0; i < feeds; ++i) CHECK(slots[i] == i);
      parts.clear();
    }
    all[700].publish({1});
    loop.advance(1s);
    std::size_t told = 0;
    for (const auto& part : parts) told += part.size();
    CHECK(told == 1);
    parts.clear();
    sink.close();
    REQUIRE(parts.size() == 1);
    CHECK(parts[0].size() == feeds);
  }

  TEST_CASE("what waits already is stored together, in batches that stay small") {
    Bench bench;
    SinkConfig with = config();
    with.queue_bytes = 64 << 20;
    Sink sink = bench.make(with);
    bench.loop.advance(1ms);
    bench.script->failures = 1;
    bench.publish(200'000);
    bench.loop.advance(1s);
    bench.check_all_once();
    const std::size_t most = *std::max_element(bench.script->batches.begin(), bench.script->batches.end());
    CHECK(most > 10'000);
    CHECK(most < 40'000);
  }

  TEST_CASE("NFR-1 a writer that hangs delays the end by the deadline only, and its events count as lost") {
    // In real time: the writer is stuck until the test lets it go.
    int ends[2];
    REQUIRE(::pipe2(ends, O_CLOEXEC) == 0);
    const auto released = std::make_shared<std::atomic<bool>>(false);
    const auto script = std::make_shared<Script>();
    const auto stuck = std::make_shared<std::atomic<bool>>(false);
    script->before_write = [reader = ends[0], released, stuck] {
      stuck->store(true);
      char byte = 0;
      CHECK(::read(reader, &byte, 1) == 1);
      released->store(true);
    };
    for (const bool by_loop : {false, true}) {
      released->store(false);
      stuck->store(false);
      Loop loop;
      std::vector<std::string> errors;
      loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.what); });
      SinkConfig with = config();
      with.close_deadline = 20ms;
      Sink sink(loop, with, std::make_unique<ScriptedWriter>(script));
      const auto topic = loop.topic<Number>("a");
      for (int i = 0; i < 25; ++i) topic.publish({1});
      Ticker ticker(loop, 1ms, [&](const Tick&) {
        if (stuck->load()) loop.stop();
      });
      loop.run();
      ticker.close();
      if (by_loop) {
        CHECK(loop.close(20ms) == 25);
      } else {
        sink.close();
      }
      CHECK(!released->load());
      const SinkStatus last = loop.runtime().sinks().front();
      CHECK(last.counts.offered == 25);
      CHECK(last.counts.dropped[static_cast<std::size_t>(DropReason::refused)] == 25);
      CHECK(last.counts.balances());
      CHECK(errors.back() == "lost 25 events");
      // The loop goes on, and a second sink works.
      const auto other = std::make_shared<Script>();
      Sink next(loop, config(), std::make_unique<ScriptedWriter>(other));
      topic.publish({2});
      next.close();
      CHECK(other->rows.size() == 1);
      sink.close();
      CHECK(::write(ends[1], "x", 1) == 1);
      // The thread left behind ends by itself, and what it held goes with it.
      while (script->writers.load() > 0) std::this_thread::yield();
      CHECK(released->load());
    }
    CHECK(script->rows.size() <= 40);
    ::close(ends[0]);
    ::close(ends[1]);
  }

  TEST_CASE("a writer is told to sync so long after the first storing, in silence too, and again when that fails") {
    struct Syncing : RecordingWriter {
      explicit Syncing(std::vector<std::string>& calls_, int& failures_) : calls(calls_), failures(failures_) {}
      Result<void> open() override { return {}; }
      Result<void> write(Batch& batch) override {
        if (batch.size() > 0) calls.emplace_back("write");
        return {};
      }
      Result<void> sync() override {
        calls.emplace_back("sync");
        if (failures-- > 0) return Error{Errc::io_failed, "cannot sync", "", "", ""};
        return {};
      }
      StorePace pace() const override { return {.account_time = 1h, .sync_time = 10s}; }
      std::vector<std::string>& calls;
      int& failures;
    };
    for (const int failures : {0, 2}) {
      CAPTURE(failures);
      std::vector<std::string> calls;
      int left = 0;
      Loop loop{Loop::Manual{}};
      loop.on_error([](const ErrorReport&) {});
      Sink sink(loop, {.name = "s", .batch_time = 1s, .retry_first = 100ms}, std::make_unique<Syncing>(calls, left));
      Feed<Number> feed(loop, {.name = "feed", .topic = "a"});
      loop.advance(20s);  // what is stored of the sensor itself
      calls.clear();
      left = failures;
      feed.publish({1});
      loop.advance(5s);
      feed.publish({2});
      loop.advance(5s);
      CHECK(calls == std::vector<std::string>{"write", "write"});
      loop.advance(2s);
      std::vector<std::string> expected{"write", "write"};
      expected.insert(expected.end(), static_cast<std::size_t>(1 + failures), "sync");
      CHECK(calls == expected);
      CHECK(sink.health() == Health::ok);
      loop.advance(1h - 1min);
      if (failures > 0) expected.emplace_back("sync");  // of the account that tells of the failure
      CHECK(calls == expected);
      loop.close();
    }
  }
}
