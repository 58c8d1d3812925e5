// What nobody thought of: sensors and feeds of three loops are made, moved, sped up, stopped and overrun at random
// while two sinks record. Whatever happened, the recordings balance. In virtual time a seed chooses all of it,
// also how the loops are interleaved, and brings it again.
#include <array>
#include <cstdlib>
#include <map>
#include <random>
#include <string>
#include <thread>

#include "loop/core/loop_core.hpp"
#include "loop/lane_sensor.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "recordings.hpp"
#include "rtdata/loop/tier.hpp"

using namespace recordings;
using namespace std::chrono_literals;

namespace {

constexpr int names = 12;
constexpr int topics = 3;
constexpr int loops = 3;

/// A program that does something else at every step.
class Chaos {
 public:
  enum class Time { real, manual };
  Chaos(const std::string& path, std::string other_path, unsigned seed, Time time)
      : random_(seed),
        other_path_(std::move(other_path)),
        loop_(made(time, {.seed = seed, .jitter = 1ms * below(10)})),
        fast_(loop_, {.name = "fast", .hold_limit = 60s, .ring_bytes = ring_bytes()}),
        slow_(loop_, {.name = "slow", .hold_limit = 60s, .ring_bytes = ring_bytes()}),
        sink_(loop_, {.path = path, .sink = {.batch_time = below(2) == 0 ? 1ms : 1ms * (1 + below(100))}}) {
    open_other();
    loop_.on_error([](const ErrorReport&) {});
  }

  void run(Duration time) {
    Ticker steps(loop_, 3ms, [this](const Tick&) { step(); });
    loop_.run_for(time);
  }
  void end() {
    CHECK(loop_.close(60s) == 0);
    CHECK(loop_.runtime().balances());
    CHECK(sink_.counts().balances());
    CHECK(other_.counts().balances());
  }
  /// What the recordings in this file said of their runs at their ends.
  std::map<std::int64_t, std::vector<std::string>> said_of(const std::string& path) const {
    std::map<std::int64_t, std::vector<std::string>> said;
    for (const detail::ClosedSink& sink : loop_runtime().core().closed_sinks)
      if (sink.name == path && sink.recorded != nullptr) said[sink.recorded->info.run] = sink.recorded->lines;
    return said;
  }
  /// What came of it all.
  std::string account() const {
    std::string all;
    for (const SensorStatus& sensor : loop_runtime().sensors()) {
      const SensorCounts& counts = sensor.counts;
      for (const std::uint64_t count : {counts.scheduled, counts.taken, counts.missed, counts.failed, counts.published})
        all += std::to_string(count) + " ";
      all += sensor.name + "\n";
    }
    for (const SinkStatus& sink : loop_runtime().sinks())
      all += std::to_string(sink.counts.stored) + " " + std::to_string(sink.counts.all_dropped()) + "\n";
    return all;
  }

 private:
  static Loop made(Time time, Loop::Manual manual) { return time == Time::manual ? Loop(manual) : Loop(); }
  static bool is_manual(Loop& loop) { return loop.core().is_manual(); }
  /// What is called on the loop lasts so long.
  static void take(Loop& here, Duration time) {
    if (is_manual(here)) {
      here.manual_clock().pass(time);
    } else {
      std::this_thread::sleep_for(time);
    }
  }
  Runtime& loop_runtime() const { return const_cast<Loop&>(loop_).runtime(); }
  int below(int n) { return static_cast<int>(random_() % static_cast<unsigned>(n)); }
  std::size_t ring_bytes() { return std::size_t{1} << (10 + below(11)); }
  Rate rate() { return below(3) == 0 ? 1_kHz : Rate::hertz(10.0 * (1 + below(20))); }

  /// On the thread of one of the three loops.
  template <class Function>
  void on(int which, Function function) {
    switch (which) {
      case 0:
        return function(loop_);
      case 1:
        return fast_.call(function);
      default:
        return slow_.call(function);
    }
  }
  template <class Function>
  void on_some_loop(Function function) {
    on(below(loops), function);
  }

  void step() {
    const int which = below(names);
    AnySensor& sensor = sensors_[static_cast<std::size_t>(which)];
    Feed<Climate>& feed = feeds_[static_cast<std::size_t>(which % topics)];
    int& home = homes_[static_cast<std::size_t>(which % topics)];  // only there may the feed publish
    Subscription& subscription = subscriptions_[static_cast<std::size_t>(below(topics))];
    const std::string topic = "t" + std::to_string(which % topics);
    switch (below(15)) {
      case 0:
      case 1:
      case 2:
        if (!sensor.is_open()) return make(which, sensor, topic);
        return sensor.set_rate(rate());
      case 3:
        return sensor.close();
      case 4:
        if (sensor.is_open()) sensor.stop();
        return;
      case 5:
        if (sensor.is_open()) sensor.start();
        return;
      case 6:
        if (subscription.is_open()) return subscription.close();
        return on_some_loop(
            [&](Loop& here) { subscription = here.subscribe<Climate>(topic, [](const Event<Climate>&) {}); });
      case 7:
        return take(loop_, 1ms * below(30));  // meanwhile rings fill up
      case 8:
        return on_some_loop([this, time = 1ms * below(30)](Loop& here) {
          here.script_lane_duration(1ms * below(20));
          take(here, time);
        });
      case 9:
        return fast_.is_running() ? fast_.stop() : fast_.start();
      case 10:
        return slow_.is_running() ? slow_.stop() : slow_.start();
      case 11:
        if (feed.is_open()) return feed.close();
        home = below(loops);
        return on(home, [&](Loop& here) { feed = Feed<Climate>(here, {.name = "feed" + topic, .topic = topic}); });
      case 12:
        return other_.is_open() ? other_.close() : open_other();
      default:
        return feed.is_open() ? on(home, [&](Loop&) { publish(feed); }) : void();
    }
  }

  /// A recording of some of it, in several runs, that has not always room.
  void open_other() {
    SinkConfig config{.batch_rows = 1000, .batch_time = 1ms * (1 + below(300)), .queue_bytes = 256 << 10};
    if (below(2) == 0) config.topics = {"t1", "t2"};
    if (below(2) == 0) config.when_full = WhenFull::drop_oldest;
    other_ = SqliteSink(loop_, {.path = other_path_, .sink = config});
  }

  void make(int which, AnySensor& sensor, const std::string& topic) {
    const int kind = below(6);
    const SensorConfig config{.name = "s" + std::to_string(which),
                              .topic = topic,
                              .rate = rate(),
                              .retry_first = 10ms,
                              .start = below(4) != 0};
    const lane_sensor::Reads reads{.take = is_manual(loop_) ? 0ms : 1ms * below(20), .fail_every = below(2) * 10};
    on_some_loop([&](Loop& here) {
      if (kind >= 4) {
        sensor = lane_sensor::LaneSensor<Climate>(here, config, reads);
        return;
      }
      sensor = Sensor<Climate>(here, config, [kind, &here, n = 0]() mutable -> Reading<Climate> {
        ++n;
        if (kind == 0 && n % 50 > 45) return Error{Errc::io_failed, "no answer", "", "", ""};
        if (kind == 1 && n % 3 == 0) return nothing_new;
        if (kind == 2 && n % 100 == 0) take(here, 7ms);
        return Climate{1.0 * n, 0};
      });
    });
  }

  void publish(Feed<Climate>& feed) {
    const int count = below(4000);
    for (int i = 0; i < count; ++i) feed.publish({1.0 * i, 0});
    if (count % 3 == 0) feed.lost(2);
    if (count % 5 == 0) feed.repeated();
  }

  std::mt19937 random_;
  const std::string other_path_;
  Loop loop_;
  Tier fast_;
  Tier slow_;
  SqliteSink sink_;
  SqliteSink other_;
  std::array<AnySensor, names> sensors_;
  std::array<Feed<Climate>, topics> feeds_;
  std::array<int, topics> homes_{};
  std::array<Subscription, topics> subscriptions_;
};

struct Seeds {
  unsigned long first, count;
};
/// RTDATA_TEST_SEEDS="FIRST COUNT", or a few.
Seeds seeds(unsigned long few) {
  const char* const wanted = std::getenv("RTDATA_TEST_SEEDS");
  if (wanted == nullptr) return {1, few};
  char* rest = nullptr;
  const unsigned long first = std::strtoul(wanted, &rest, 10);
  return {first, std::strtoul(rest, nullptr, 10)};
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("US-26 a row that has to come after the one before is as late in the ledger as in the recording") {
    std::uint64_t pushed = 0;
    for (std::uint64_t seed = 1; seed <= 10; ++seed) {
      CAPTURE(seed);
      const Folder folder;
      const std::string path = folder / "run.db";
      {
        Loop loop{Loop::Manual{.seed = seed, .jitter = 0s}, {.hold_limit = 1s}};
        loop.script_lane_duration(2ms);
        SqliteSink sink(loop, {.path = path});
        lane_sensor::LaneSensor<Climate> sensor(loop, {.name = "s", .rate = 200_Hz, .late_after = 1ms});
        // Two reads may begin at 31 ms, when the loop is let go: that of 10 ms, and that of 30 ms, which is 1 ms late
        // and so is not counted as late; but its row comes 1 ns later.
        const Timer holds(loop, 11ms, [&] { loop.manual_clock().pass(20ms); });
        loop.advance(40ms);
        if (sensor.counts().lateness % 2 == 1) ++pushed;
        CHECK(loop.close() == 0);
      }
      check_balanced(path);
    }
    CHECK(pushed > 0);
  }

  TEST_CASE("US-26 whatever happens at random on three loops, the recordings balance") {
    const auto [first, count] = seeds(10);
    for (unsigned long seed = first; seed < first + count; ++seed) {
      CAPTURE(seed);
      std::string account;
      for (int time = 0; time < (seed == first ? 2 : 1); ++time) {
        const Folder folder;
        std::map<std::string, std::map<std::int64_t, std::vector<std::string>>> said;
        {
          Chaos chaos(folder / "all.db", folder / "some.db", static_cast<unsigned>(seed), Chaos::Time::manual);
          chaos.run(1s);
          chaos.end();
          for (const char* name : {"all.db", "some.db"}) said[name] = chaos.said_of(folder / name);
          if (time == 1) CHECK(chaos.account() == account);  // the same again
          account = chaos.account();
        }
        for (const char* name : {"all.db", "some.db"}) {
          CAPTURE(name);
          const VerifyReport report = check_balanced(folder / name);
          std::map<std::int64_t, std::vector<std::string>> found;
          for (const RunReport& run : report.runs) found[run.info.run] = run.lines;
          CHECK(said[name] == found);
        }
      }
    }
  }

  // In real time, so that the sanitizer sees the threads.
  TEST_CASE("US-26 the same at random with threads: the recordings balance") {
    const auto [first, count] = seeds(1);
    for (unsigned long seed = first; seed < first + count; ++seed) {
      CAPTURE(seed);
      const Folder folder;
      {
        Chaos chaos(folder / "all.db", folder / "some.db", static_cast<unsigned>(seed), Chaos::Time::real);
        chaos.run(500ms);
        chaos.end();
      }
      for (const char* name : {"all.db", "some.db"}) check_balanced(folder / name);
    }
  }
}
