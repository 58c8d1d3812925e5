// Sensors on tiers, recorded by a sink of the main loop; in virtual time, where what is tested is not the threads
// themselves.
#include <array>
#include <atomic>
#include <deque>

#include "loop/run_until.hpp"
#include "loop/virtual_time.hpp"
#include "recordings.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/sinks/recording_writer.hpp"

using namespace recordings;
using namespace std::chrono_literals;

namespace {

/// A reading function whose 20th call does not return until it is let go.
struct Hanging {
  Climate read() {
    if (++reads == 20) {
      while (!is_let_go) loop.manual_clock().pass(1ms);
    }
    return Climate{};
  }
  Loop& loop;
  unsigned reads = 0;
  bool is_let_go = false;
};

}  // namespace

TEST_SUITE("sinks") {
  // In real time, so that the sanitizer sees the threads.
  TEST_CASE("US-26 sensors of two tiers and the main loop in one recording, which balances") {
    const Folder folder;
    const std::string path = folder / "run.db";
    std::uint64_t published = 0;
    {
      Loop loop;
      Tier fast(loop, {.name = "fast"});
      Tier slow(loop, {.name = "slow"});
      SqliteSink sink(loop, {.path = path});
      std::atomic<unsigned> reads{0};
      Sensor<Climate> a(fast.loop(), {.name = "a", .topic = "shared", .rate = 1_kHz}, [&] {
        return Climate{1.0 * ++reads, 0};
      });
      Sensor<Climate> b(slow.loop(), {.name = "b", .topic = "shared", .rate = 200_Hz}, [] { return Climate{2, 0}; });
      Sensor<Climate> c(loop, {.name = "c", .topic = "shared", .rate = 50_Hz}, [] { return Climate{3, 0}; });
      Sensor<Climate> broken(fast.loop(), {.name = "broken", .rate = 100_Hz}, []() -> Result<Climate> {
        return Error{Errc::disconnected, "cannot read", "device", "gone", ""};
      });
      broken.on_error([](const ErrorReport&) {});
      loop.run_for(300ms);
      CHECK(loop.close() == 0);
      CHECK(loop.runtime().balances());
      CHECK(sink.counts().balances());
      CHECK(sink.counts().stored == sink.counts().offered);
      for (const SensorStatus& sensor : loop.runtime().sensors()) published += sensor.counts.published;
      CHECK(sink.counts().stored == published);
    }
    check_balanced(path);
    CHECK(number(path, "SELECT count(*) FROM shared") == static_cast<std::int64_t>(published));
    CHECK(number(path, "SELECT count(*) FROM rtdata_schedule") == 4);
    CHECK(number(path, "SELECT sum(scheduled) FROM rtdata_schedule") ==
          number(path, "SELECT sum(scheduled) FROM rtdata_ledger"));
    CHECK(number(path, "SELECT count(*) FROM rtdata_gap WHERE origin = 'broken' AND kind = 'failed'") >= 1);
  }

  TEST_CASE("a sink on a tier is refused, and says where to make it") {
    const Folder folder;
    Loop loop{virtual_time()};
    Tier fast(loop, {.name = "fast"});
    CHECK_THROWS_WITH_AS(
        SqliteSink(fast.loop(), {.path = folder / "run.db"}),
        doctest::Contains("loop fast is a tier's: make it on the main loop, whose sinks record every tier"),
        SetupError);
    CHECK(loop.runtime().sinks().empty());
  }

  TEST_CASE("US-26 what found no room between tiers is dropped in the ledger, and the recording balances") {
    const Folder folder;
    const std::string path = folder / "run.db";
    std::uint64_t dropped = 0;
    {
      Loop loop{virtual_time()};
      Tier fast(loop, {.ring_bytes = 8192});
      SqliteSink sink(loop, {.path = path});
      Feed<Climate> feed(fast.loop(), {.name = "feed"});
      unsigned bursts = 0;
      Ticker ticker(fast.loop(), 1ms, [&](const Tick&) {
        if (bursts == 20) return;
        for (int i = 0; i < 500; ++i) feed.publish({1.0 * i, 0});
        ++bursts;
      });
      CHECK(run_until(loop, [&] { return bursts == 20; }));
      CHECK(loop.close() == 0);
      dropped = sink.counts().all_dropped();
      CHECK(sink.counts().offered == 20 * 500);
      CHECK(dropped > 0);
      CHECK(loop.runtime().balances());
    }
    check_balanced(path);
    CHECK(number(path, "SELECT dropped_newest FROM rtdata_ledger WHERE origin = 'feed'") ==
          static_cast<std::int64_t>(dropped));
    CHECK(number(path, "SELECT count(*) FROM feed") == static_cast<std::int64_t>(20 * 500 - dropped));
  }

  TEST_CASE("many sensors of a tier that stop at once are balanced in the recording") {
    std::size_t ring_bytes = 0;
    int sensors = 0;
    bool is_stopped_first = false;
    SUBCASE("more than the ring has room for") { ring_bytes = 4096, sensors = 300; }
    SUBCASE("more than the ring of a stopped tier has room for") {
      ring_bytes = 4096, sensors = 300, is_stopped_first = true;
    }
    SUBCASE("more than the sink tells of at once") { ring_bytes = 1 << 20, sensors = 3000; }
    const Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop{virtual_time()};
      Tier fast(loop, {.hold_limit = 60s, .ring_bytes = ring_bytes});
      SqliteSink sink(loop, {.path = path});
      std::deque<Sensor<Climate>> all;
      int reads{0};
      for (int i = 0; i < sensors; ++i) {
        all.emplace_back(fast.loop(), SensorConfig{.name = "s" + std::to_string(i), .topic = "t", .rate = 10_Hz}, [&] {
          ++reads;
          return Climate{};
        });
      }
      CHECK(run_until(loop, [&] { return reads > 5 * sensors; }));
      if (is_stopped_first) fast.stop();
      loop.close(60s);
      CHECK(loop.runtime().balances());
    }
    check_balanced(path);
    CHECK(number(path, "SELECT count(*) FROM rtdata_schedule") >= sensors);
  }

  TEST_CASE("US-26 recordings opened and closed while tiers go on balance, each with what was published meanwhile") {
    const Folder folder;
    const std::string path = folder / "run.db";
    Loop loop{virtual_time()};
    loop.on_error([](const ErrorReport&) {});
    Tier fast(loop, {.name = "fast", .hold_limit = 60s});
    Tier slow(loop, {.name = "slow", .hold_limit = 60s, .ring_bytes = 4096});
    int reads = 0;
    Sensor<Climate> sensor(fast.loop(), {.name = "s", .rate = 1_kHz}, [] { return Climate{}; });
    Sensor<Climate> fails(slow.loop(), {.name = "f", .rate = 500_Hz, .faulted_after = 1000},
                          [&reads]() -> Result<Climate> {
                            if (++reads % 50 < 40) return Error{Errc::io_failed, "no answer", "", "", ""};
                            return Climate{};
                          });
    Feed<Climate> feed(fast.loop(), {.name = "feed"});
    Ticker ticker(fast.loop(), 1ms, [&](const Tick&) {
      for (int i = 0; i < 20; ++i) feed.publish({});
    });
    loop.run_for(20ms);
    enum { at_once, from_a_callback, with_the_loop_at_last } how = at_once;
    SUBCASE("at once") {}
    SUBCASE("closed from a callback") { how = from_a_callback; }
    SUBCASE("closed with the loop at last, while a ticker of a tier goes on publishing") {
      how = with_the_loop_at_last;
    }
    for (int run = 0; run < 5; ++run) {
      SqliteSink sink(loop, {.path = path});
      loop.run_for(70ms);
      Timer closes(loop, 20ms, [&] { sink.close(); });
      if (how == from_a_callback) loop.run_for(50ms);
      if (how == with_the_loop_at_last && run == 4) CHECK(loop.close() == 0);
      sink.close();
    }
    const VerifyReport report = check_balanced(path);
    CHECK(report.runs.size() == 5);
    CHECK(number(path, "SELECT count(DISTINCT run) FROM s") == 5);
  }

  TEST_CASE("US-26 what a tier publishes while a recording is being opened is in it") {
    struct Counted : RecordingWriter {
      Counted(std::function<void()> wait_, OriginAccount& last_) : wait(std::move(wait_)), last(last_) {}
      Result<void> add_topic(std::uint32_t, std::string_view topic, const Description&) override {
        if (topic == "feed") wait();
        return {};
      }
      Result<void> open() override { return {}; }
      Result<void> write(Batch& batch) override {
        if (batch.account() != nullptr && batch.account()->is_last) last = batch.account()->origins.at(0);
        return {};
      }
      const std::function<void()> wait;
      OriginAccount& last;
    };
    Loop loop{virtual_time()};
    Tier fast(loop, {.name = "fast", .hold_limit = 60s});
    Feed<Climate> feed(fast.loop(), {.name = "feed"});
    unsigned published{0};
    Ticker ticker(fast.loop(), 1ms, [&](const Tick&) {
      feed.publish({});
      ++published;
    });
    CHECK(run_until(loop, [&] { return published >= 10; }));
    OriginAccount last;
    const auto wait = [&] {
      const unsigned enough = published + 10;
      const auto is_enough = [&] { return published >= enough; };
      while (!is_enough()) loop.manual_clock().pass(1ms);
    };
    Sink sink(loop, {.name = "counted", .topics = {"feed"}}, std::make_unique<Counted>(wait, last));
    loop.run_for(20ms);
    sink.close();
    CHECK(last.offered >= 10);
    CHECK(last.sensor.published == last.offered);
    CHECK(last.last_sequence - last.first_sequence + 1 == last.offered);
    CHECK(last.first_sequence > 10);
  }

  TEST_CASE("what a sink tells between the end of a schedule on a tier and its next account changes nothing of it") {
    const Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop{virtual_time()};
      Tier fast(loop, {.hold_limit = 60s});
      SqliteSink sink(loop, {.path = path, .sink = {.batch_time = 1ms}});
      int reads{0};
      Sensor<Climate> sensor(fast.loop(), {.name = "s", .rate = 200_Hz}, [&] {
        ++reads;
        return Climate{};
      });
      Ticker ticker(fast.loop(), 170ms,
                    [&](const Tick& tick) { sensor.set_rate(tick.index % 2 == 0 ? 200_Hz : 100_Hz); });
      CHECK(run_until(loop, [&] { return reads > 100; }));
      CHECK(loop.close() == 0);
    }
    check_balanced(path);
    CHECK(number(path, "SELECT count(*) FROM rtdata_schedule") >= 3);
  }

  TEST_CASE("the accounts of a tier get to the recording also when its ring has no room for all of them at once") {
    constexpr std::int64_t feeds = 100;
    const Folder folder;
    const std::string path = folder / "run.db";
    std::uint64_t dropped = 0;
    {
      Loop loop{virtual_time()};
      Tier fast(loop, {.ring_bytes = 8192});
      SqliteSink sink(loop, {.path = path});
      fast.start();
      std::deque<Feed<Climate>> all;
      fast.call([&](Loop& on) {
        for (int i = 0; i < feeds; ++i) all.emplace_back(on, FeedConfig{.name = "f" + std::to_string(i), .topic = "t"});
        for (int round = 0; round < 100; ++round) {
          for (Feed<Climate>& feed : all) feed.publish({});  // most of these find no room
        }
      });
      SUBCASE("of a tier that runs") {}
      SUBCASE("of one that was stopped") { fast.stop(); }
      CHECK(loop.close() == 0);
      CHECK(loop.runtime().balances());
      CHECK(sink.counts().offered == 100 * feeds);
      dropped = sink.counts().all_dropped();
      CHECK(dropped > 0);
    }
    check_balanced(path);
    CHECK(number(path, "SELECT count(*) FROM rtdata_ledger WHERE published = 100") == feeds);
    CHECK(number(path, "SELECT sum(dropped_newest) FROM rtdata_ledger") == static_cast<std::int64_t>(dropped));
    CHECK(number(path, "SELECT count(*) FROM t") == 100 * feeds - static_cast<std::int64_t>(dropped));
  }

  TEST_CASE("a sensor of a tier that goes and is made again is one sequence in a recording, which balances") {
    const Folder folder;
    const std::string path = folder / "run.db";
    std::uint64_t published = 0;
    {
      Loop loop{virtual_time()};
      SqliteSink sink(loop, {.path = path});
      const auto make = [](Loop& on) {
        return Sensor<Climate>(on, {.name = "a", .rate = 1_kHz}, [] { return Climate{}; });
      };
      for (int round = 0; round < 3; ++round) {
        Tier fast(loop, {.name = "fast"});
        {
          const Sensor<Climate> on_fast = make(fast.loop());
          loop.run_for(30ms);
        }
        const Sensor<Climate> again = fast.call(make);
        loop.run_for(30ms);
      }
      Tier fast(loop, {.name = "fast"});
      const Sensor<Climate> on_fast = make(fast.loop());
      loop.run_for(30ms);
      CHECK(loop.close() == 0);
      CHECK(loop.runtime().balances());
      published = loop.runtime().sensors().at(0).counts.published;
      CHECK(sink.counts().stored == published);
    }
    check_balanced(path);
    CHECK(number(path, "SELECT count(*) FROM a") == static_cast<std::int64_t>(published));
    CHECK(number(path, "SELECT max(sequence) FROM a") == static_cast<std::int64_t>(published));
    CHECK(number(path, "SELECT count(*) FROM rtdata_schedule") <= 8);  // on a busy machine a stretch may have no tick
    CHECK(number(path, "SELECT sum(scheduled) FROM rtdata_schedule") ==
          number(path, "SELECT sum(scheduled) FROM rtdata_ledger"));
  }

  TEST_CASE("US-9 rates that change and sensors that stop on a tier leave their segments in the recording") {
    const Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop{virtual_time()};
      Tier fast(loop, {});
      SqliteSink sink(loop, {.path = path});
      Sensor<Climate> sensor(fast.loop(), {.name = "a", .rate = 1_kHz}, [] { return Climate{}; });
      loop.run_for(50ms);
      fast.call([&](Loop&) { sensor.set_rate(100_Hz); });
      loop.run_for(50ms);
      fast.call([&](Loop&) { sensor.stop(); });
      loop.run_for(20ms);
      fast.call([&](Loop&) { sensor.start(); });
      loop.run_for(50ms);
      CHECK(loop.close() == 0);
    }
    check_balanced(path);
    CHECK(number(path, "SELECT count(*) FROM rtdata_schedule") == 3);
  }

  TEST_CASE("NFR-1 a tier whose callback hangs does not keep the recording from being closed") {
    const Folder folder;
    const std::string path = folder / "run.db";
    Loop loop{virtual_time()};
    Hanging hanging{loop};
    std::vector<std::string> told;
    loop.runtime().on_log([&](const LogRecord& record) { told.emplace_back(record.text); });
    Tier fast(loop, {});
    SqliteSink sink(loop, {.path = path});
    Sensor<Climate> sensor(fast.loop(), {.name = "a", .rate = 1_kHz}, [&] { return hanging.read(); });
    CHECK(run_until(loop, [&] { return hanging.reads == 20; }));
    loop.run_for(20ms);  // what it read before has come
    loop.close(1s);
    CHECK(std::any_of(told.begin(), told.end(), [](const std::string& line) {
      return line.find("did not stop in time: it has not returned from sensor a") != std::string::npos;
    }));
    CHECK(number(path, "SELECT count(*) FROM a") >= 10);
    const VerifyReport report = verified(path);
    INFO(problems_of(report));
    CHECK(report.verdict() == Verdict::sealed);
    CHECK(report.exit_code() == 0);
    const RunInfo& run = report.runs.at(0).info;
    CHECK(run.remark.find("tier fast did not return from sensor a: what its sensors did after 20") == 0);
    CHECK(run.ended);
    CHECK_FALSE(run.lost);
    CHECK_FALSE(loop.runtime().balances());
    hanging.is_let_go = true;
  }

  TEST_CASE("NFR-1 a recording opened and closed while a tier hangs is closed in time, and says what is not known") {
    const Folder folder;
    const std::string path = folder / "run.db";
    std::vector<std::string> told;
    Loop loop{virtual_time()};
    Hanging hanging{loop};
    Tier fast(loop, {.hold_limit = 60s});
    Sensor<Climate> sensor(fast.loop(), {.name = "a", .rate = 1_kHz}, [&] { return hanging.read(); });
    CHECK(run_until(loop, [&] { return hanging.reads == 20; }));
    loop.runtime().on_log([&](const LogRecord& record) { told.emplace_back(record.text); });
    SqliteSink sink(loop, {.path = path, .sink = {.close_deadline = 1s}});
    CHECK(std::any_of(told.begin(), told.end(), [](const std::string& line) {
      return line.find("begins although tier fast did not return from sensor a: what its sensors did after") == 0;
    }));
    sink.close();
    hanging.is_let_go = true;
    const VerifyReport report = verified(path);
    INFO(problems_of(report));
    CHECK(report.verdict() == Verdict::sealed);
    const std::string& remark = report.runs.at(0).info.remark;
    CHECK(remark.find("the sink began although tier fast did not return from sensor a: what its sensors did") == 0);
    CHECK(remark.find("; tier fast did not return from sensor a: what its sensors did") != std::string::npos);
  }

  TEST_CASE("NFR-1 a handler of log records that throws keeps no recording from beginning while a tier hangs") {
    const Folder folder;
    const std::string path = folder / "run.db";
    unsigned told = 0;
    Loop loop{virtual_time()};
    Hanging hanging{loop};
    Tier fast(loop, {.hold_limit = 60s});
    Sensor<Climate> sensor(fast.loop(), {.name = "a", .rate = 1_kHz}, [&] { return hanging.read(); });
    CHECK(run_until(loop, [&] { return hanging.reads == 20; }));
    loop.runtime().on_log([&](const LogRecord&) {
      ++told;
      throw std::runtime_error("the log is full");
    });
    SqliteSink sink(loop, {.path = path, .sink = {.batch_time = 10ms}});
    CHECK(told > 0);
    loop.runtime().on_log(nullptr);
    hanging.is_let_go = true;
    CHECK(run_until(loop, [&] { return hanging.reads >= 100 && sink.counts().stored >= 20; }));
    CHECK(loop.close() == 0);
    const VerifyReport report = verified(path);
    INFO(problems_of(report));
    CHECK(report.verdict() == Verdict::sealed);
  }

  TEST_CASE("NFR-1 a recording that begins while a tier hangs, which then goes on, is not called complete") {
    const Folder folder;
    const std::string path = folder / "run.db";
    const std::string killed = folder / "killed.db";
    Loop loop{virtual_time()};
    Hanging hanging{loop};
    loop.on_error([](const ErrorReport&) {});
    Tier fast(loop, {.hold_limit = 60s});
    Sensor<Climate> sensor(fast.loop(), {.name = "a", .rate = 1_kHz}, [&] { return hanging.read(); });
    CHECK(run_until(loop, [&] { return hanging.reads == 20; }));
    SqliteSink sink(loop, {.path = path, .sink = {.batch_time = 10ms}});
    hanging.is_let_go = true;
    CHECK(run_until(loop, [&] { return hanging.reads >= 100 && sink.counts().stored >= 20; }));
    CHECK(verified(path).verdict() == Verdict::recording);
    CHECK(verified(path).text().find("the sink began although tier fast did not return from sensor a") !=
          std::string::npos);
    for (const char* part : {"", "-wal"}) std::filesystem::copy_file(path + part, killed + part);
    CHECK(loop.close() == 0);
    {
      Loop next;
      next.runtime().on_log([](const LogRecord&) {});
      SqliteSink seals(next, {.path = killed});
    }
    const VerifyReport sealed = verified(killed);
    INFO(problems_of(sealed));
    CHECK(sealed.verdict() == Verdict::sealed);
    CHECK_FALSE(sealed.runs.at(0).info.lost);
    CHECK(sealed.runs.at(0).info.remark.find("the sink began although tier fast") == 0);
    CHECK(sealed.runs.at(0).info.remark.find("; run 1 ended without closing") != std::string::npos);
    const VerifyReport report = verified(path);
    INFO(problems_of(report));
    CHECK(report.verdict() == Verdict::sealed);
    CHECK(report.runs.at(0).info.remark.find("the sink began although tier fast did not return from sensor a") == 0);
    CHECK(report.text().find("Its account is not complete") != std::string::npos);
  }

  TEST_CASE("NFR-1 a tier that hangs costs recordings that begin and end nothing of the account of other tiers") {
    const Folder folder;
    const std::string path = folder / "run.db";
    bool hangs{false};
    bool let_go{false};
    Loop loop{virtual_time()};
    loop.on_error([](const ErrorReport&) {});
    loop.runtime().on_log([](const LogRecord&) {});
    Tier fast(loop, {.name = "fast", .hold_limit = 60s});
    Tier other(loop, {.name = "other", .hold_limit = 60s, .ring_bytes = 4096});
    std::array<Feed<Climate>, 50> feeds;  // their accounts have no room in the ring all at once
    for (std::size_t i = 0; i < feeds.size(); ++i)
      feeds[i] = Feed<Climate>(other.loop(), {.name = "f" + std::to_string(i)});
    Ticker publishes(other.loop(), 5ms, [&](const Tick& tick) {
      feeds[static_cast<std::size_t>(tick.due.time_since_epoch() / 5ms % 50)].publish({});
    });
    Sensor<Climate> there(other.loop(), {.name = "there", .rate = 1_kHz}, [] { return Climate{}; });
    Ticker ticker(fast.loop(), 1ms, [&](const Tick&) {
      hangs = true;
      while (!let_go) loop.manual_clock().pass(1ms);
    });
    CHECK(run_until(loop, [&] { return hangs; }));
    SqliteSink sink(loop, {.path = path, .sink = {.close_deadline = 1s}});
    loop.run_for(50ms);
    sink.close();
    let_go = true;
    const VerifyReport report = verified(path);
    INFO(problems_of(report));
    CHECK(report.verdict() == Verdict::sealed);
    CHECK(report.runs.at(0).info.remark.find("tier fast") != std::string::npos);
    CHECK(report.runs.at(0).info.remark.find("tier other") == std::string::npos);
    CHECK(number(path, "SELECT published FROM rtdata_ledger WHERE origin = 'there'") >= 40);
    CHECK(number(path, "SELECT published - offered FROM rtdata_ledger WHERE origin = 'there'") == 0);
  }

  TEST_CASE(
      "US-26 a recording that is opened while a tier takes a name again has all that others publish from then on") {
    const Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop{virtual_time(), {.hold_limit = 60s}};
      Tier fast(loop, {.name = "fast", .hold_limit = 60s});
      Tier busy(loop, {.name = "busy", .hold_limit = 60s});
      Feed<Climate> feed(busy.loop(), {.name = "feed"});
      Ticker ticker(busy.loop(), 100us, [&](const Tick&) {
        for (int i = 0; i < 10; ++i) feed.publish({});
      });
      Feed<Climate> moves;
      loop.run_for(10ms);
      for (int run = 0; run < 10; ++run) {
        fast.loop().post([&] {  // while the recording waits for what this tier tells
          loop.manual_clock().pass(5ms);
          moves = Feed<Climate>(fast.loop(), {.name = "moves"});
        });
        SqliteSink sink(loop, {.path = path});
        loop.run_for(3ms);
        sink.close();
        fast.call([&](Loop&) { moves.close(); });
      }
      CHECK(loop.close() == 0);
    }
    const VerifyReport report = check_balanced(path);
    CHECK(report.runs.size() == 10);
  }

  TEST_CASE("NFR-1 a tier that hangs costs the other tiers and the main loop nothing of their account") {
    const Folder folder;
    const std::string path = folder / "run.db";
    bool let_go{false};
    {
      Loop loop{virtual_time()};
      loop.runtime().on_log([](const LogRecord&) {});
      Tier fast(loop, {.name = "fast"});
      Tier other(loop, {.name = "other"});
      SqliteSink sink(loop, {.path = path});
      Sensor<Climate> here(loop, {.name = "here", .rate = 100_Hz}, [] { return Climate{}; });
      Sensor<Climate> there(other.loop(), {.name = "there", .rate = 100_Hz}, [] { return Climate{}; });
      Sensor<Climate> hangs(fast.loop(), {.name = "hangs", .rate = 100_Hz}, [] { return Climate{}; });
      unsigned handled{0};
      auto handler = fast.loop().subscribe("hangs", [&](const EventView&) {
        while (++handled > 5 && !let_go) loop.manual_clock().pass(1ms);
      });
      CHECK(run_until(loop, [&] { return handled > 5; }));
      loop.close(1s);
      CHECK_FALSE(fast.stop_within(1ms));
      CHECK(fast.doing() == "handler of hangs");
      CHECK(other.stop_within(10s));
      let_go = true;
      CHECK(fast.stop_within(10s));
    }
    const VerifyReport report = verified(path);
    INFO(problems_of(report));
    CHECK(report.verdict() == Verdict::sealed);
    CHECK(report.runs.at(0).info.remark.find("tier fast did not return from handler of hangs") == 0);
    CHECK(report.runs.at(0).info.remark.find("tier other") == std::string::npos);
    for (const char* name : {"here", "there"}) {
      const std::string of = " FROM rtdata_ledger WHERE origin = '" + std::string(name) + "'";
      CHECK(number(path, "SELECT scheduled - taken - missed - failed" + of) == 0);
      CHECK(number(path, "SELECT published - stored" + of) == 0);
    }
  }
}
