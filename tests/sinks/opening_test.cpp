// Sinks that are added while the program runs: opening them, which may take long, holds nothing up.
#include <doctest/doctest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <fstream>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "rtdata/loop/timer.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/recording/verify.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "rtdata/sinks/file.hpp"
#include "rtdata/sinks/recording_writer.hpp"
#include "sinks/killed.hpp"
#include "sinks/recordings.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using namespace sinks;
using namespace std::chrono_literals;
using recordings::number;
using recordings::verified;

namespace {

/// What a writer that is opened at set-up was asked, and how it is to answer.
struct OpeningScript {
  std::vector<std::string> calls;
  std::vector<double> values;
  std::vector<LiveCounts> live = std::vector<LiveCounts>(8);
  std::optional<Error> failure;
};

class OpeningWriter final : public RecordingWriter {
 public:
  explicit OpeningWriter(OpeningScript& script) : script_(script) {}
  Opening opening() const override { return Opening::at_set_up; }
  Result<void> open() override {
    script_.calls.emplace_back("open");
    if (script_.failure) return *script_.failure;
    return {};
  }
  Result<void> write(Batch& batch) override {
    for (const Record& record : batch) {
      double value = 0;
      std::memcpy(&value, record.payload.data(), sizeof value);
      script_.values.push_back(value);
    }
    return {};
  }
  Result<void> close() override {
    script_.calls.emplace_back("close");
    return {};
  }
  LiveCounts* live_counts(std::uint32_t slot) override {
    script_.calls.emplace_back("live_counts");
    return &script_.live.at(slot);
  }

 private:
  OpeningScript& script_;
};

/// A loop in virtual time that makes a sink in one of its callbacks, whose opening takes so long.
struct Adding {
  Loop loop{Loop::Manual{}};
  std::optional<Sink> sink;
  std::vector<std::string> errors;
  std::vector<std::string> health;
  Subscription changes;

  Adding() {
    loop.on_error([this](const ErrorReport& report) { errors.emplace_back(report.error.id()); });
    changes = loop.subscribe("$rtdata/health", [this](const EventView& event) {
      const std::string text = to_json(event);
      health.push_back(text);
    });
  }
  static std::string to_json(const EventView& event) {
    std::vector<std::byte> bytes;
    CodecRegistry::standard().make("json").or_throw()->encode(event, bytes).or_throw();
    return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
  }
  template <class Make>
  void add(Duration opening, Make make) {
    Timer timer(loop, 0ms, [&] {
      loop.script_lane_duration(opening);
      sink.emplace(make());
      loop.script_lane_duration(0ms);
    });
    loop.advance(1ms);
  }
  Sink scripted(OpeningScript& script, Duration close_deadline = 10s) {
    return Sink(loop, {.name = "script", .close_deadline = close_deadline}, std::make_unique<OpeningWriter>(script));
  }
};

std::string remark(const std::string& path) {
  const auto database = sqlite::Database::open(path, sqlite::Database::Mode::read);
  auto statement = database.prepare("SELECT remark FROM rtdata_run WHERE run = 1");
  return statement.step() ? std::string(statement.text(0)) : std::string();
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE(
      "NFR-1 a recording is added while 1 kHz is sampled: no tick is missed or late, and it has each from then on") {
    Directory directory;
    const std::string path = directory / "run.db";
    {
      Adding adding;
      Loop& loop = adding.loop;
      Sensor<Number> sensor(loop, {.name = "a", .topic = "a", .rate = 1_kHz}, [] { return Number{1}; });
      loop.advance(100ms);
      adding.add(1s, [&] { return SqliteSink(loop, {.path = path}); });
      loop.advance(500ms);
      CHECK(adding.sink->counts().queued >= 499);
      CHECK(adding.sink->counts().stored == 0);
      CHECK(adding.sink->counts().balances());
      loop.advance(2s);
      CHECK(adding.sink->counts().stored > 1000);
      CHECK(loop.close() == 0);
      const SensorCounts counts = loop.runtime().sensors().at(0).counts;
      CHECK(counts.taken == 2602);  // one at each ms, from 0 to 2601
      CHECK(counts.missed == 0);
      CHECK(counts.late == 0);
      CHECK(adding.errors.empty());
      CHECK(loop.runtime().balances());
    }
    CHECK(verified(path).verdict() == Verdict::balanced);
    CHECK(number(path, "SELECT count(*) FROM a") == number(path, "SELECT scheduled FROM rtdata_ledger"));
    CHECK(number(path, "SELECT count(*) FROM a") >= 2500);
  }

  TEST_CASE("NFR-1 while a recording that is added waits for another program, the loop goes on") {
    Directory directory;
    const std::string path = directory / "run.db";
    auto other = sqlite::Database::open(path, sqlite::Database::Mode::write);
    other.execute("PRAGMA journal_mode = WAL; BEGIN IMMEDIATE");
    int ticks = 0;
    std::int64_t stored = 0;
    {
      Loop loop;
      std::optional<SqliteSink> sink;
      loop.on_error([](const ErrorReport&) {});  // busy, on a machine that stood still
      loop.runtime().on_log([](const LogRecord&) {});
      const auto topic = loop.topic<Number>("a");
      Ticker ticker(loop, 1ms, [&](const Tick&) {
        if (++ticks == 1) sink.emplace(loop, SqliteConfig{.path = path, .sink = {.batch_time = 10ms}});
        topic.publish({1});
        if (ticks == 100) other.execute("COMMIT");
        if (sink->counts().stored >= 100) loop.stop();
      });
      Timer limit(loop, 60s, [&] { loop.stop(); });
      loop.run();
      ticker.close();
      CHECK(ticks >= 100);
      CHECK(sink->counts().stored >= 100);
      CHECK(loop.close() == 0);
      CHECK(loop.runtime().balances());
      stored = static_cast<std::int64_t>(loop.runtime().sinks().at(0).counts.stored);
    }
    CHECK(number(path, "SELECT count(*) FROM a") == stored);
    CHECK(number(path, "SELECT first_sequence FROM rtdata_ledger") == 1);
    CHECK(verified(path).verdict() == Verdict::balanced);
  }

  TEST_CASE("a recording that cannot be opened: at the start it throws and leaves nothing behind") {
    Directory directory;
    const std::string path = directory / "run.db";
    std::ofstream(path) << "this is not a recording, and longer than the head of one: " << std::string(200, 'x');
    for (const bool is_manual : {true, false}) {
      CAPTURE(is_manual);
      std::optional<Loop> loop;
      if (is_manual) {
        loop.emplace(Loop::Manual{});
      } else {
        loop.emplace();
      }
      std::vector<std::string> errors;
      loop->on_error([&](const ErrorReport& report) { errors.emplace_back(report.error.id()); });
      loop->topic<Number>("a").publish({1});
      std::optional<Error> thrown;
      try {
        SqliteSink sink(*loop, {.path = path});
      } catch (const SetupError& error) {
        thrown = error.error();
      }
      REQUIRE(thrown);
      CHECK(thrown->id() == "not-a-recording");
      CHECK(errors.empty());
      CHECK(loop->runtime().sinks().empty());
      CHECK(loop->close() == 0);
      CHECK(loop->runtime().balances());
    }
  }

  TEST_CASE("a recording that is added and cannot be opened is told, tried again, and has what waited") {
    Directory directory;
    const std::string path = directory / "run.db";
    std::ofstream(path) << "this is not a recording, and longer than the head of one: " << std::string(200, 'x');
    {
      Adding adding;
      const auto topic = adding.loop.topic<Number>("a");
      adding.add(0ms, [&] { return SqliteSink(adding.loop, {.path = path}); });
      for (int i = 0; i < 10; ++i) topic.publish({1});
      adding.loop.advance(1s);
      CHECK(adding.sink->health() == Health::faulted);
      CHECK(adding.sink->status().reason.find("run.db") != std::string::npos);
      REQUIRE(!adding.errors.empty());
      CHECK(adding.errors[0] == "not-a-recording");
      CHECK(adding.sink->counts().queued == 10);
      REQUIRE(::unlink(path.c_str()) == 0);
      adding.loop.advance(20s);
      CHECK(adding.sink->health() == Health::ok);
      CHECK(adding.sink->counts().stored == 10);
      CHECK(adding.loop.close() == 0);
      CHECK(adding.loop.runtime().balances());
    }
    CHECK(number(path, "SELECT count(*) FROM a") == 10);
    CHECK(verified(path).verdict() == Verdict::balanced);
  }

  TEST_CASE("a file sink that is added and cannot be opened is told, tried again, and has what waited") {
    Directory directory;
    Adding adding;
    const auto topic = adding.loop.topic<Number>("a");
    const FileConfig config{.path = directory / "later/run.csv", .format = "csv"};
    adding.add(0ms, [&] { return FileSink(adding.loop, config); });
    for (int i = 0; i < 10; ++i) topic.publish({1});
    adding.loop.advance(1s);
    CHECK(adding.sink->health() == Health::faulted);
    CHECK(adding.sink->counts().queued == 10);
    std::filesystem::create_directory(directory / "later");
    adding.loop.advance(20s);
    CHECK(adding.sink->health() == Health::ok);
    CHECK(adding.sink->counts().stored == 10);
    CHECK(adding.loop.close() == 0);
    const std::string text = content(config.path);
    CHECK(std::count(text.begin(), text.end(), '\n') == 11);  // and the header
  }

  TEST_CASE("an opening that takes half a minute is told after a while, and drops only what finds no room") {
    OpeningScript script;
    Adding adding;
    const auto topic = adding.loop.topic<Number>("a");
    adding.add(30s, [&] { return adding.scripted(script); });
    for (int second = 0; second < 20; ++second) {
      topic.publish({static_cast<double>(second)});
      if (second == 4) CHECK(adding.sink->health() == Health::ok);
      adding.loop.advance(1s);
    }
    CHECK(adding.sink->health() == Health::degraded);
    CHECK(adding.sink->status().reason.starts_with("opening"));
    CHECK(adding.sink->counts().queued == 20);
    adding.loop.advance(11s);
    CHECK(adding.sink->health() == Health::ok);
    CHECK(adding.sink->counts().stored == 20);
    REQUIRE(adding.health.size() == 2);
    CHECK(adding.health[0].find("opening") != std::string::npos);
    CHECK(adding.errors.empty());
    // Its counts began before it was open, where it keeps them.
    CHECK(script.live[0].offered == 20);
    topic.publish({20});
    CHECK(script.live[0].offered == 21);
    CHECK(adding.loop.close() == 0);
    CHECK(script.values.size() == 21);
    CHECK(script.calls == std::vector<std::string>{"open", "live_counts", "close"});
    CHECK(adding.loop.runtime().balances());
  }

  TEST_CASE("a sink that is drained or closed while it opens: what is queued is stored, or counted as lost in time") {
    for (const bool is_drained : {true, false}) {
      for (const Duration deadline : {Duration{60s}, Duration{2s}}) {
        CAPTURE(is_drained);
        CAPTURE(deadline.count());
        OpeningScript script;
        Adding adding;
        const auto topic = adding.loop.topic<Number>("a");
        adding.add(30s, [&] { return adding.scripted(script, deadline); });
        for (int i = 0; i < 20; ++i) topic.publish({1});
        adding.loop.advance(100ms);
        const MonotonicTime begin = adding.loop.now();
        const std::uint64_t lost = deadline > 30s ? 0 : 20;
        if (is_drained) {
          std::optional<std::uint64_t> told;
          adding.loop.drain(deadline, [&](std::uint64_t count) { told = count; });
          adding.loop.advance(deadline + 1s);
          CHECK(told == lost);
        } else {
          adding.sink->close();
          CHECK(adding.loop.now() - begin <= deadline);
        }
        CHECK(script.values.size() == 20 - lost);
        const std::vector<SinkStatus> all = adding.loop.runtime().sinks();
        REQUIRE(all.size() == 1);
        CHECK(all[0].counts.balances());
        CHECK(all[0].counts.offered == 20);
        CHECK(all[0].counts.stored == 20 - lost);
        CHECK(adding.errors == (lost == 0 ? std::vector<std::string>{} : std::vector<std::string>{"timed-out"}));
        CHECK(adding.loop.runtime().balances());
      }
    }
  }

  TEST_CASE("a sink whose opening fails while it closes is tried again while the deadline lasts") {
    OpeningScript script;
    script.failure = Error{Errc::busy, "cannot open", "script", "", ""};
    Adding adding;
    const auto topic = adding.loop.topic<Number>("a");
    adding.add(0ms, [&] { return adding.scripted(script, 5s); });
    topic.publish({1});
    adding.loop.advance(10ms);
    adding.sink->close();
    CHECK(script.calls.size() >= 4);  // and no close
    CHECK(std::count(script.calls.begin(), script.calls.end(), "open") ==
          static_cast<std::ptrdiff_t>(script.calls.size()) - 1);  // and the first, live_counts
    CHECK(adding.loop.runtime().sinks().at(0).counts.all_dropped() == 1);
    CHECK(adding.loop.runtime().balances());
  }

  TEST_CASE("killed after the recording is open, with what was published before it: the seal counts all of it") {
    for (const bool has_topic_before : {true, false}) {
      CAPTURE(has_topic_before);
      Directory directory;
      const std::string path = directory / "run.db";
      killed_in([&] {
        Adding adding;
        std::optional<Topic<Number>> topic;
        if (has_topic_before) topic = adding.loop.topic<Number>("a");
        adding.add(1s, [&] { return SqliteSink(adding.loop, {.path = path, .sink = {.batch_time = 500ms}}); });
        if (!has_topic_before)
          topic = adding.loop.topic<Number>("a");  // open on the lane, which the loop has not heard
        for (int i = 0; i < 5; ++i) topic->publish({1});
        adding.loop.advance(10s);  // these are stored
        for (int i = 0; i < 7; ++i) topic->publish({1});
        ::raise(SIGKILL);
      });
      recordings::start_again(path);
      CHECK(number(path, "SELECT count(*) FROM a") == 5);
      CHECK(number(path, "SELECT offered FROM rtdata_ledger WHERE run = 1") == 12);
      CHECK(number(path, "SELECT lost FROM rtdata_run WHERE run = 1") == 7);
      CHECK(verified(path).verdict() == Verdict::sealed);
    }
  }

  TEST_CASE("killed while the loop has not heard that the recording is open: the seal counts what was published") {
    enum class Topic { none, before, meanwhile };
    for (const Topic topic : {Topic::none, Topic::before, Topic::meanwhile}) {
      CAPTURE(static_cast<int>(topic));
      Directory directory;
      const std::string path = directory / "run.db";
      killed_in([&] {
        Adding adding;
        const auto publish = [&] {
          for (int i = 0; i < 5; ++i) adding.loop.topic<Number>("a").publish({1});
        };
        if (topic == Topic::before) publish();
        adding.add(1s, [&] { return SqliteSink(adding.loop, {.path = path}); });
        if (topic != Topic::none) publish();
        adding.loop.advance(500ms);
        ::raise(SIGKILL);
      });
      recordings::start_again(path);
      CHECK(number(path, "SELECT coalesce(lost, -1) FROM rtdata_run WHERE run = 1") == (topic == Topic::none ? 0 : 5));
      CHECK(remark(path).find("is unknown") == std::string::npos);
      CHECK(verified(path).verdict() == Verdict::sealed);
    }
  }

  TEST_CASE("a sink that is destroyed by the handler of the error at its opening is gone") {
    OpeningScript script;
    script.failure = Error{Errc::busy, "cannot open", "script", "", ""};
    Adding adding;
    adding.loop.on_error([&](const ErrorReport&) { adding.sink.reset(); });
    adding.add(100ms, [&] { return adding.scripted(script, 1s); });
    adding.loop.topic<Number>("a").publish({1});
    adding.loop.advance(10s);
    CHECK(!adding.sink);
    CHECK(adding.loop.runtime().balances());
  }
}
