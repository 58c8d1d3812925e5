// Tiers. In virtual time, where what is tested is not the threads themselves. In real time stay: what the kernel grants
// a thread, thread identities, processor time and spinning; and of what crosses loops so much that the thread sanitizer
// sees the rings, the announcements and the names at work: events both ways, of different sizes, calls, names that
// move, tiers that go.
#include <doctest/doctest.h>
#include <sched.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <deque>
#include <memory>
#include <optional>
#include <semaphore>
#include <string>
#include <thread>
#include <vector>

#include "loop/core/callback_survey.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/lane_sensor.hpp"
#include "loop/run_until.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/virtual_time.hpp"
#include "rtdata/detail/sensors/transaction.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/topic.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using namespace std::chrono_literals;

namespace {

struct Count {
  std::uint64_t number = 0;
  friend constexpr auto describe(type_tag<Count>) { return record("count", field("number", &Count::number, "1")); }
};

struct Block {
  std::uint64_t number = 0;
  std::array<double, 60> values{};
  friend constexpr auto describe(type_tag<Block>) {
    return record("block", field("number", &Block::number, "1"), field("values", &Block::values));
  }
};

/// Publishes so many numbers, a burst each millisecond, then stops.
class Burst {
 public:
  Burst(Loop& loop, std::uint64_t total, std::uint64_t at_once, std::string name = "count")
      : feed_(loop, {.name = name, .topic = "count"}), ticker_(loop, 1ms, [this, total, at_once](const Tick&) {
          for (std::uint64_t i = 0; i < at_once && next_ < total; ++i) feed_.publish({next_++});
          if (next_ == total) {
            ticker_.stop();
            is_done = true;
          }
        }) {}
  /// On its loop.
  std::uint64_t published() const { return next_; }
  std::atomic<bool> is_done{false};

 private:
  std::uint64_t next_ = 0;
  Feed<Count> feed_;
  Ticker ticker_;
};

/// Runs a function in a child process; true when it returned true.
template <class Function>
bool in_child(Function function) {
  const pid_t child = ::fork();
  if (child == 0) {
    bool good = false;
    try {
      good = function();
    } catch (...) {
    }
    ::_exit(good ? 0 : 1);
  }
  int status = -1;
  ::waitpid(child, &status, 0);
  return WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

}  // namespace

TEST_SUITE("loop") {
  TEST_CASE("US-33 current, lowest and highest priorities can be asked, and a policy be set") {
    CHECK(priority_range(SchedulingPolicy::fifo).lowest == 1);
    CHECK(priority_range(SchedulingPolicy::fifo).highest == 99);
    CHECK(priority_range(SchedulingPolicy::round_robin).highest == 99);
    CHECK(priority_range(SchedulingPolicy::other).highest == 0);
    CHECK(current_scheduling().policy == SchedulingPolicy::other);
    std::thread([] {
      const auto set = set_scheduling({SchedulingPolicy::fifo, 3});
      if (!set) {
        CHECK(set.error().code == Errc::not_permitted);
        CHECK(set.error().text().find("limits.conf") != std::string::npos);
        MESSAGE("skipped: " << set.error().text());
        return;
      }
      CHECK(current_scheduling().policy == SchedulingPolicy::fifo);
      CHECK(current_scheduling().priority == 3);
      std::thread([] { CHECK(current_scheduling().policy == SchedulingPolicy::other); }).join();  // not inherited
      CHECK(set_scheduling({SchedulingPolicy::round_robin, 4}));
      CHECK(current_scheduling().policy == SchedulingPolicy::round_robin);
      const auto refused = set_scheduling({SchedulingPolicy::fifo, 100});
      REQUIRE(!refused);
      CHECK(refused.error().code == Errc::bad_argument);
    }).join();
  }

  TEST_CASE("US-16 what a tier publishes reaches handlers of the main loop, all of it, in order, on their thread") {
    Loop loop;
    Tier fast(loop, {});
    Burst burst(fast.loop(), 5000, 10);
    std::vector<std::uint64_t> seen;
    std::uint64_t elsewhere = 0;
    const auto main_thread = std::this_thread::get_id();
    auto subscription = loop.subscribe<Count>("count", [&](const Event<Count>& event) {
      seen.push_back(event->number);
      if (std::this_thread::get_id() != main_thread || event.origin != "count" || event.sequence != event->number + 1)
        ++elsewhere;
    });
    CHECK(run_until(loop, [&] { return burst.is_done && seen.size() + subscription.counts().dropped == 5000; }));
    const auto counts = subscription.counts();
    CHECK(counts.balances());
    CHECK(counts.offered == 5000);
    CHECK(seen.size() == counts.delivered);
    CHECK(std::is_sorted(seen.begin(), seen.end()));
    CHECK(elsewhere == 0);
  }

  TEST_CASE("US-16 what the main loop publishes reaches handlers of a tier, and one tier's those of another") {
    Loop loop;
    Tier fast(loop, {.name = "fast"});
    Tier slow(loop, {.name = "slow"});
    Feed<Count> feed(loop, {.name = "main", .topic = "main"});
    std::atomic<unsigned> on_fast{0};
    std::atomic<unsigned> on_slow{0};
    Feed<Count> echo(fast.loop(), {.name = "echo"});
    auto a = fast.loop().subscribe<Count>("main", [&](const Event<Count>& event) {
      ++on_fast;
      echo.publish(*event);
    });
    auto b = slow.loop().subscribe<Count>("echo", [&](const Event<Count>&) { ++on_slow; });
    unsigned sent = 0;
    Ticker ticker(loop, 1ms, [&](const Tick&) {
      if (sent < 100) feed.publish({sent++});
    });
    CHECK(run_until(loop, [&] { return on_slow == 100; }));
    CHECK(on_fast == 100);
  }

  TEST_CASE("US-25 a full ring drops the new events and counts each with the subscription that misses it") {
    Loop loop{virtual_time()};
    Tier fast(loop, {.ring_bytes = 4096});
    Burst burst(fast.loop(), 20'000, 1000);
    std::uint64_t delivered = 0;
    auto subscription = loop.subscribe<Count>("count", [&](const Event<Count>&) {
      if (delivered++ == 0) loop.manual_clock().pass(50ms);
    });
    CHECK(run_until(loop, [&] {
      return burst.is_done && subscription.counts().offered == 20'000 && subscription.counts().queued == 0;
    }));
    const auto counts = subscription.counts();
    CHECK(counts.offered == 20'000);
    CHECK(counts.delivered == delivered);
    CHECK(counts.dropped > 0);
    CHECK(counts.balances());
    loop.close();
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("what found no room is known although the tier goes before the main loop has turned") {
    constexpr std::uint64_t feeds = 50;
    Loop loop{virtual_time()};
    auto subscription = loop.subscribe<Count>("shared", [](const Event<Count>&) {});
    {
      Tier fast(loop, {.hold_limit = 60s, .ring_bytes = 8192});
      fast.start();
      std::deque<Feed<Count>> all;
      fast.call([&](Loop& on) {
        for (std::uint64_t i = 0; i < feeds; ++i)
          all.emplace_back(on, FeedConfig{.name = "f" + std::to_string(i), .topic = "shared"});
        for (std::uint64_t round = 0; round < 100; ++round) {
          for (Feed<Count>& feed : all) feed.publish({round});
        }
      });
    }
    CHECK(subscription.counts().offered == 100 * feeds);
    CHECK(subscription.counts().dropped > 0);
    CHECK(subscription.counts().balances());
    REQUIRE(loop.runtime().topics().size() == 1);
    CHECK(loop.runtime().topics()[0].published == 100 * feeds);
  }

  TEST_CASE("a ring that is too small is refused, and events that are long for it are told of") {
    Loop loop;
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) {
      if (report.error.code != Errc::held_too_long) errors.push_back(report.error.text());
    });
    CHECK_THROWS_AS(Tier(loop, {.ring_bytes = 1023}), SetupError);
    Tier fast(loop, {.ring_bytes = 1024});
    const Feed<Block> feed(loop, {.name = "large"});
    loop.poll();
    REQUIRE(errors.size() == 1);
    CHECK(errors[0].find("make the tier's ring_bytes larger") != std::string::npos);
  }

  TEST_CASE("US-16 events of different sizes share a small ring: each arrives once, in order") {
    Loop loop;
    Tier fast(loop, {.ring_bytes = 8192});
    Feed<Count> small(fast.loop(), {.name = "small"});
    Feed<Block> large(fast.loop(), {.name = "large"});
    constexpr int rounds = 3000;
    std::atomic<int> round{0};
    std::atomic<std::uint64_t> published_small{0}, published_large{0};
    std::uint32_t state = 1;
    const Ticker ticker(fast.loop(), 200us, [&](const Tick&) {
      if (round == rounds) return;
      state = state * 1664525U + 1013904223U;
      // A large one goes to the beginning of the ring when it does not fit at the end, where old small ones lie.
      for (std::uint32_t i = 0; i < (state >> 16) % 40; ++i) small.publish({++published_small});
      if ((state >> 24) % 2 == 0) large.publish({++published_large, {}});
      ++round;
    });
    std::uint64_t last_small = 0, last_large = 0, wrong = 0;
    auto on_small = loop.subscribe<Count>("small", [&](const Event<Count>& event) {
      wrong += event->number <= last_small || event.sequence != event->number ? 1 : 0;
      last_small = event->number;
    });
    auto on_large = loop.subscribe<Block>("large", [&](const Event<Block>& event) {
      wrong += event->number <= last_large || event.sequence != event->number ? 1 : 0;
      last_large = event->number;
    });
    CHECK(run_until(loop, [&] {
      return round == rounds && on_small.counts().offered >= published_small && on_small.counts().queued == 0 &&
             on_large.counts().offered >= published_large && on_large.counts().queued == 0;
    }));
    CHECK(wrong == 0);
    CHECK(on_small.counts().offered == published_small);
    CHECK(on_large.counts().offered == published_large);
    CHECK(on_small.counts().delivered > 0);
    CHECK(on_large.counts().delivered > 0);
    loop.close();
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("what a callback publishes gets to other loops before it ends, when it is much or the ring is full") {
    const auto is_received_meanwhile = [](std::size_t ring_bytes, unsigned new_feeds, std::uint64_t events) {
      Loop loop{virtual_time()};
      Tier fast(loop, {.hold_limit = 60s, .ring_bytes = ring_bytes});
      Feed<Count> feed(fast.loop(), {.name = "count"});
      std::uint64_t received = 0;
      auto subscription = loop.subscribe<Count>("count", [&](const Event<Count>&) { ++received; });
      bool was_in_time = false;
      std::deque<Feed<Count>> others;
      fast.start();
      loop.run_for(1ms);
      fast.loop().post([&] {
        for (unsigned i = 0; i < new_feeds; ++i)
          others.emplace_back(fast.loop(), FeedConfig{.name = "new." + std::to_string(i), .topic = "count"});
        for (std::uint64_t i = 0; i < events; ++i) feed.publish({i});
        for (int i = 0; i < 100 && received == 0; ++i) loop.manual_clock().pass(1ms);
        was_in_time = received > 0;
        loop.stop();
      });
      loop.run();
      return was_in_time;
    };
    CHECK(is_received_meanwhile(1 << 20, 0, 1000));
    CHECK(is_received_meanwhile(1 << 20, 200, 1000));
    CHECK(is_received_meanwhile(2048, 0, 100));
  }

  TEST_CASE("US-28 a handler that subscribes while a tier publishes sees nothing from before") {
    Loop loop{virtual_time()};
    Tier fast(loop, {});
    Burst burst(fast.loop(), 3000, 3);
    Subscription first = loop.subscribe<Count>("count", [](const Event<Count>&) {});
    unsigned rounds = 0;
    unsigned past = 0;
    Subscription again;
    Ticker ticker(loop, 5ms, [&](const Tick&) {
      const std::uint64_t published = fast.call([&](Loop&) { return burst.published(); });
      again = loop.subscribe<Count>("count", [&, published](const Event<Count>& event) {
        if (event.sequence <= published) ++past;
      });
      ++rounds;
    });
    CHECK(run_until(loop, [&] { return burst.is_done && rounds > 20; }));
    CHECK(past == 0);
    again.close();
    ticker.close();
    CHECK(run_until(loop, [&] { return first.counts().queued == 0; }));
    CHECK(first.counts().balances());
  }

  TEST_CASE("US-8 a handle may be closed from the main thread while its tier runs") {
    Loop loop;
    std::atomic<std::uint64_t> reads{0};
    Tier fast(loop, {});
    Sensor<Count> sensor(fast.loop(), {.name = "reader", .rate = 1_kHz}, [&] { return Count{++reads}; });
    std::uint64_t seen = 0;
    auto subscription = loop.subscribe<Count>("reader", [&](const Event<Count>&) { ++seen; });
    CHECK(run_until(loop, [&] { return seen > 20; }));
    sensor.close();
    const std::uint64_t after = reads;
    loop.run_for(20ms);
    CHECK(reads == after);
    CHECK(fast.call([](Loop& on) { return on.runtime().sensors().size(); }) == 0);
  }

  TEST_CASE("objects are made on a running tier in call(), which returns and throws what its function does") {
    Loop loop;
    Tier fast(loop, {});
    fast.start();
    CHECK(fast.is_running());
    CHECK_THROWS_AS(Feed<Count>(fast.loop(), {.name = "wrong thread"}), SetupError);
    auto feed = fast.call([](Loop& on) { return Feed<Count>(on, {.name = "made.there"}); });
    CHECK(fast.call([](Loop& on) { return on.runtime().sensors().at(0).name; }) == "made.there");
    std::uint64_t received = 0;
    auto subscription = loop.subscribe<Count>("made.there", [&](const Event<Count>&) { ++received; });
    loop.poll();
    std::binary_semaphore is_received{0};
    fast.call([&](Loop& on) {
      feed.publish({});
      on.post([&] { is_received.acquire(); });
    });
    loop.poll();  // what a call has published is on its way when it returns
    is_received.release();
    CHECK(received == 1);
    CHECK_THROWS_WITH(fast.call([](Loop&) { throw std::runtime_error("from the tier"); }), "from the tier");
    const auto thread = fast.call([](Loop&) { return std::this_thread::get_id(); });
    CHECK(thread != std::this_thread::get_id());
    fast.stop();
    CHECK_FALSE(fast.is_running());
    CHECK(fast.call([](Loop&) { return std::this_thread::get_id(); }) == std::this_thread::get_id());
    fast.start();
    CHECK(fast.call([](Loop& on) { return on.runtime().sensors().size(); }) == 1);
  }

  TEST_CASE("a tier that cannot be made says why") {
    Loop loop;
    CHECK_THROWS_WITH_AS(Tier(loop, {.name = "main"}), doctest::Contains("the main loop has that name"), SetupError);
    for (const std::string& name : {std::string(), std::string("a\nb"), std::string("a\x7f"), std::string(201, 'a')})
      CHECK_THROWS_WITH_AS(Tier(loop, {.name = name}), doctest::Contains("a name has 1 to 200 characters"), SetupError);
    CHECK_THROWS_WITH_AS(Tier(loop, {.name = "a\nb"}), doctest::Contains("\"a?b\""), SetupError);
    CHECK_THROWS_AS(Tier(loop, {.policy = SchedulingPolicy::fifo, .priority = 0}), SetupError);
    CHECK_THROWS_AS(Tier(loop, {.policy = SchedulingPolicy::other, .priority = 5}), SetupError);
    CHECK_THROWS_AS(Tier(loop, {.cpus = {-1}}), SetupError);
    CHECK_THROWS_WITH_AS(Tier(loop, {.spin = 1s}), doctest::Contains("give `spin` 0 s to 10 ms"), SetupError);
    CHECK_THROWS_AS(Tier(loop, {.spin = -1us}), SetupError);
    { const Tier at_most(loop, {.name = "spinning", .spin = 10ms}); }
    Tier fast(loop, {.name = "fast"});
    CHECK_THROWS_AS(Tier(loop, {.name = "fast"}), SetupError);
    CHECK_THROWS_AS(Tier(fast.loop(), {.name = "below"}), SetupError);
    fast.start();
    CHECK_THROWS_AS(Tier(loop, {.name = "late"}), SetupError);
  }

  TEST_CASE("US-33 a system without any permission warns what to set, and runs on") {
    CHECK(in_child([] {
      if (::geteuid() == 0 && (::setgid(65534) != 0 || ::setuid(65534) != 0)) return false;
      Loop loop;
      std::vector<std::string> logged;
      loop.runtime().on_log([&](const LogRecord& record) { logged.emplace_back(record.text); });
      Tier fast(
          loop,
          {.policy = SchedulingPolicy::fifo, .priority = 80, .cpus = {4000 % CPU_SETSIZE}, .keep_cpu_awake = true});
      Burst burst(fast.loop(), 100, 10);
      std::uint64_t seen = 0;
      auto subscription = loop.subscribe<Count>("count", [&](const Event<Count>&) { ++seen; });
      const bool all = run_until(loop, [&] { return seen == 100; });
      bool says_limits = false;
      for (const std::string& warning : fast.warnings())
        says_limits = says_limits || warning.find("limits.conf") != std::string::npos;
      return all && says_limits && fast.warnings().size() >= 3 && logged.size() >= 3 &&
             fast.scheduling().policy == SchedulingPolicy::other;
    }));
  }

  TEST_CASE("US-33 processors that are not there are warned of, though the tier runs on those that are") {
    const int absent = CPU_SETSIZE - 1;
    cpu_set_t own;
    REQUIRE(::sched_getaffinity(0, sizeof own, &own) == 0);
    if (CPU_ISSET(absent, &own)) return;
    int present = 0;
    while (!CPU_ISSET(present, &own)) ++present;
    Loop loop;
    Tier some(loop, {.name = "some", .cpus = {present, absent}});
    Tier none(loop, {.name = "none", .cpus = {absent}});
    Tier all(loop, {.name = "all", .cpus = {present}});
    Tier any(loop, {.name = "any", .cpus = {}});
    for (Tier* tier : {&some, &none, &all, &any}) tier->start();
    REQUIRE(some.warnings().size() == 1);
    CHECK(some.warnings()[0] == "cannot bind to processors: " + std::to_string(absent) +
                                    ": this machine does not have them, or the process may not use them: use "
                                    "processors that there are; the tier runs on " +
                                    std::to_string(present));
    CHECK(none.warnings().size() == 1);
    CHECK(all.warnings().empty());
    CHECK(any.warnings().empty());
  }

  TEST_CASE("US-33 a tier has the policy, priority, name and processor that it was given, its lanes have not") {
    Loop loop;
    Tier fast(
        loop,
        {.name = "pressure-loop-of-the-bench", .policy = SchedulingPolicy::round_robin, .priority = 7, .cpus = {0}});
    fast.start();
    if (fast.scheduling().policy != SchedulingPolicy::round_robin) {
      MESSAGE("skipped: no permission: " << (fast.warnings().empty() ? "" : fast.warnings().front()));
      return;
    }
    CHECK(fast.scheduling().priority == 7);
    const auto [cpu, child] = fast.call([](Loop&) {
      Scheduling inherited;
      std::thread([&] { inherited = current_scheduling(); }).join();
      return std::pair{::sched_getcpu(), inherited};
    });
    CHECK(cpu == 0);
    CHECK(child.policy == SchedulingPolicy::other);
  }

  TEST_CASE("NFR-1 a handler that blocks the main loop costs its tier nothing but a queue") {
    Loop loop{virtual_time()};
    Tier fast(loop, {});
    std::uint64_t reads{0};
    Sensor<Count> sensor(fast.loop(), {.name = "reader", .rate = 1_kHz}, [&] { return Count{++reads}; });
    std::uint64_t seen = 0;
    std::uint64_t reads_while_blocked = 0;
    auto subscription = loop.subscribe<Count>("reader", [&](const Event<Count>&) {
      if (seen++ != 10) return;
      const std::uint64_t before = reads;
      for (int i = 0; i < 1000 && reads < before + 20; ++i) loop.manual_clock().pass(1ms);
      reads_while_blocked = reads - before;
    });
    CHECK(run_until(loop, [&] { return seen > 50; }));
    CHECK(reads_while_blocked >= 20);
    loop.close();
    CHECK(loop.runtime().balances());
    const auto status = loop.runtime().sensors();
    REQUIRE(status.size() == 1);
    CHECK(status[0].counts.balances());
    CHECK(status[0].counts.published == reads);
    CHECK(subscription.counts().offered == status[0].counts.published);
  }

  TEST_CASE("the main loop's run does not return while a tier runs, though nothing else keeps it") {
    Loop loop{virtual_time()};
    Tier fast(loop, {});
    bool is_fired{false};
    Timer timer(fast.loop(), 5ms, [&] {
      is_fired = true;
      loop.stop();
    });
    loop.run();
    CHECK(is_fired);
    fast.stop();
    loop.run();  // nothing is left to wait for
  }

  TEST_CASE("a name that a sensor of another loop has is refused") {
    Loop loop{virtual_time()};
    Tier fast(loop, {.name = "fast"});
    Tier slow(loop, {.name = "slow"});
    const Feed<Count> there(fast.loop(), {.name = "there"});
    const Feed<Count> here(loop, {.name = "here"});
    CHECK_THROWS_WITH_AS(Feed<Count>(loop, {.name = "there", .topic = "other"}),
                         "cannot make sensor: there: there is one of that name already on loop fast: give each sensor "
                         "a `name` of its own [busy]",
                         SetupError);
    CHECK_THROWS_AS(Feed<Count>(slow.loop(), {.name = "there"}), SetupError);
    CHECK_THROWS_AS(Feed<Count>(slow.loop(), {.name = "here"}), SetupError);
    loop.run_for(5ms);  // all have heard of each other
    CHECK_THROWS_AS(Feed<Count>(loop, {.name = "there", .topic = "other"}), SetupError);
    CHECK_THROWS_AS(slow.call([](Loop& on) { return Feed<Count>(on, {.name = "here"}); }), SetupError);
  }

  TEST_CASE(
      "US-8 a name that was freed belongs to its loop until the end of the run, where it goes on in its sequence") {
    Loop loop{virtual_time()};
    Tier fast(loop, {.name = "fast"});
    Tier slow(loop, {.name = "slow"});
    std::uint64_t last = 0, out_of_order = 0;
    auto subscription = loop.subscribe<Count>("x", [&](const Event<Count>& event) {
      if (event.sequence != ++last) ++out_of_order;
    });
    fast.start();
    slow.start();
    const auto burst = [&](Loop& on) {
      Feed<Count> feed(on, {.name = "x"});
      for (int i = 0; i < 7; ++i) feed.publish({});
    };
    for (int round = 0; round < 10; ++round) {
      fast.call(burst);
      const char* const refusal =
          "cannot make sensor: x: earlier in this run it was on loop fast, to which its name belongs: start the "
          "program again, or give it another name [busy]";
      CHECK_THROWS_WITH_AS(slow.call(burst), refusal, SetupError);
      CHECK_THROWS_WITH_AS(burst(loop), refusal, SetupError);
      if (round % 3 == 0) loop.run_for(1ms);
    }
    CHECK(run_until(loop, [&] { return last == 70; }));
    CHECK(out_of_order == 0);
    loop.run_for(5ms);
    CHECK(loop.runtime().sensors().empty());  // its end was told
    loop.close();
    CHECK(subscription.counts().offered == 70);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("a tier that is made again with the same sensors reaches the main loop again") {
    Loop loop{virtual_time()};
    std::uint64_t seen = 0;
    std::uint64_t last = 0;
    auto subscription = loop.subscribe<Count>("x", [&](const Event<Count>& event) {
      ++seen;
      last = event.sequence;
    });
    for (std::uint64_t round = 1; round <= 3; ++round) {
      Tier fast(loop, {});
      fast.start();
      auto feed = fast.call([](Loop& on) { return Feed<Count>(on, {.name = "x"}); });
      fast.call([&](Loop& on) {
        on.topic<Count>("own").publish({});
        for (int i = 0; i < 10; ++i) feed.publish({});
      });
      if (round == 2) continue;  // the tier goes before anything of it was taken
      CHECK(run_until(loop, [&] { return seen == 10 * round; }));
    }
    CHECK(seen == 30);
    CHECK(last == 30);
    for (const TopicStatus& topic : loop.runtime().topics()) {
      if (topic.name == "own") CHECK(topic.published == 3);
    }
    CHECK(loop.runtime().balances());
  }

  TEST_CASE(
      "a payload that cannot cross is refused where its topic is subscribed to, and told of once where it is wanted by "
      "name") {
    Loop loop{virtual_time()};
    std::vector<std::string> errors;
    loop.on_error(
        [&](const ErrorReport& report) { errors.push_back(std::string(report.object) + ": " + report.error.text()); });
    Tier fast(loop, {});
    const auto words = fast.loop().topic<std::string>("words");
    CHECK_THROWS_AS((void)words.subscribe(loop, [](const Event<std::string>&) {}), SetupError);
    std::uint64_t there = 0;
    auto on_tier = words.subscribe(fast.loop(), [&](const Event<std::string>&) { ++there; });
    auto typed = loop.subscribe<std::string>("words", [](const Event<std::string>&) {});
    Ticker ticker(fast.loop(), 1ms, [&](const Tick&) {
      words.publish("a word");
      fast.loop().topic<std::string>("others").publish("another");
      fast.loop().topic<Count>("numbers").publish({});
    });
    CHECK(run_until(loop, [&] { return !errors.empty(); }));
    loop.run_for(20ms);
    REQUIRE(errors.size() == 1);  // nobody wants the others
    CHECK(errors[0].starts_with(
        "handler of words: cannot subscribe: words, which is published on loop fast: its payload std::"));
    CHECK(errors[0].find("cannot cross tiers: use text<N>") != std::string::npos);
    auto late = loop.subscribe<std::string>("#", [](const Event<std::string>&) {});
    std::erase_if(errors, [](const std::string& error) { return error.find("others") == std::string::npos; });
    REQUIRE(errors.size() == 1);
    CHECK(errors[0].find("others, which is published on loop fast") != std::string::npos);
    errors.clear();
    loop.run_for(20ms);
    CHECK(errors.empty());
    CHECK(fast.call([&](Loop&) { return there; }) > 0);
  }

  TEST_CASE("what a subscription on a tier drops is a loss to the main loop, also when the tier is gone") {
    for (const unsigned published : {4U, 5U}) {
      ManualClock clock;
      Runtime runtime({.clock = &clock, .ring_events = 4});
      Loop loop(runtime, {});
      {
        Tier fast(loop, {});
        auto subscription = fast.loop().subscribe<Count>("x", [](const Event<Count>&) {});
        Feed<Count> feed(fast.loop(), {.name = "x"});
        bool is_published{false};
        Timer timer(fast.loop(), 1ms, [&] {
          for (unsigned i = 0; i < published; ++i) feed.publish({});
          is_published = true;
        });
        CHECK(run_until(loop, [&] { return is_published; }));
        loop.close();
        CHECK(fast.is_running());
        CHECK(runtime.has_loss() == (published > 4));
        fast.stop();
        CHECK(runtime.has_loss() == (published > 4));
      }
      CHECK(runtime.has_loss() == (published > 4));
      CHECK(runtime.balances());
    }
  }

  TEST_CASE("events that another loop cannot take, since the topic is another one there, are a loss") {
    Loop loop{virtual_time()};
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) {
      if (report.error.code != Errc::held_too_long) errors.push_back(report.error.text());
    });
    Tier fast(loop, {});
    loop.topic<Count>("one");
    const auto topic = fast.loop().topic<double>("one");
    Ticker ticker(fast.loop(), 1ms, [&](const Tick&) { topic.publish(1); });
    CHECK(run_until(loop, [&] { return loop.runtime().has_loss(); }));
    CHECK(errors.size() == 1);
  }

  TEST_CASE("errors and log lines of a tier come out on the main loop") {
    Loop loop{virtual_time()};
    std::vector<std::string> told;
    loop.runtime().on_log(
        [&](const LogRecord& record) { told.push_back(std::string(record.object) + ": " + std::string(record.text)); });
    Tier fast(loop, {});
    Sensor<Count> sensor(fast.loop(), {.name = "broken", .rate = 100_Hz}, []() -> Result<Count> {
      return Error{Errc::disconnected, "cannot read", "the device", "it is gone", ""};
    });
    CHECK(run_until(loop, [&] {
      return std::any_of(told.begin(), told.end(),
                         [](const std::string& line) { return line.find("it is gone") != std::string::npos; });
    }));
    CHECK(run_until(loop, [&] {
      const auto sensors = loop.runtime().sensors();
      return sensors.size() == 1 && sensors[0].health == Health::faulted &&
             sensors[0].reason.find("it is gone") != std::string::npos;
    }));
  }

  TEST_CASE("publishing or feeding on a loop from the thread of another is refused") {
    Loop loop;
    loop.on_error([](const ErrorReport&) {});
    Tier tier(loop, {.name = "fast"});
    const auto topic = loop.topic<Count>("a");
    Feed<Count> feed(loop, {.name = "f"});
    std::atomic<int> refused{0};
    const Ticker wrong(tier.loop(), 1ms, [&](const Tick&) {
      if (refused >= 4) return;
      for (const bool feeds : {false, true}) {
        try {
          if (feeds) {
            feed.publish({1});
          } else {
            topic.publish({1});
          }
        } catch (const SetupError& e) {
          if (e.error().code == Errc::busy) ++refused;
        }
      }
    });
    CHECK(run_until(loop, [&] { return refused >= 4; }));
    CHECK(feed.counts().received == 0);
  }

  TEST_CASE("US-24 a read of a tier that outlasts the end is counted as failed, and its account arrives") {
    Loop loop{virtual_time()};
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) {
      if (report.error.code != Errc::held_too_long) errors.push_back(report.error.what);
    });
    Tier tier(loop, {.name = "fast"});
    tier.loop().script_lane_duration(700ms);
    lane_sensor::LaneSensor<Count> sensor(tier.loop(), {.name = "slow", .rate = 1_Hz});
    CHECK(run_until(loop, [&] {
      const auto all = loop.runtime().sensors();
      return !all.empty() && all[0].counts.in_flight == 1;
    }));
    loop.close(800ms);
    CHECK(std::find(errors.begin(), errors.end(), "did not stop in time") == errors.end());
    const auto all = loop.runtime().sensors();
    REQUIRE(all.size() == 1);
    CHECK(all[0].counts.in_flight == 0);
    CHECK(all[0].counts.failed == 1);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("US-24 a tier that a drain has given up is unknown, which is told, and known again once it has come out") {
    Loop loop{virtual_time()};
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) {
      if (report.error.code != Errc::held_too_long) errors.push_back(report.error.what);
    });
    const auto times_told = [&] { return std::count(errors.begin(), errors.end(), "did not stop in time"); };
    Tier tier(loop, {.name = "fast", .hold_limit = 1h});
    Feed<Count> feed(tier.loop(), {.name = "f"});
    tier.call([&](Loop&) { feed.publish({1}); });
    tier.start();
    bool is_let_go = false;
    tier.loop().post([&] {
      while (!is_let_go) loop.manual_clock().pass(1ms);
    });
    SUBCASE("by itself") {
      loop.close(20ms);
      CHECK(times_told() == 1);
      CHECK_FALSE(loop.runtime().balances());
      is_let_go = true;
      CHECK(run_until(loop, [&] { return loop.runtime().balances(); }));
    }
    SUBCASE("stopped") {
      loop.close(20ms);
      CHECK_FALSE(loop.runtime().balances());
      is_let_go = true;
      tier.stop();
      CHECK(loop.runtime().balances());
    }
    SUBCASE("closed again") {
      loop.close(20ms);
      CHECK_FALSE(loop.runtime().balances());
      is_let_go = true;
      loop.close(1h);
      CHECK(loop.runtime().balances());
    }
    SUBCASE("by a longer drain, begun before it was given up") {
      int done = 0;
      loop.drain(20ms, [&](std::uint64_t) { ++done; });
      loop.drain(1h, [&](std::uint64_t) { ++done; });
      CHECK(run_until(loop, [&] { return done == 1; }));
      CHECK(times_told() == 1);
      CHECK_FALSE(loop.runtime().balances());
      is_let_go = true;
      CHECK(run_until(loop, [&] { return done == 2; }));
      CHECK(loop.runtime().balances());
    }
    CHECK(times_told() == 1);
  }

  TEST_CASE("drains of a tier end when there is no room for its accounts until the main loop turns") {
    Loop loop{virtual_time()};
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) {
      if (report.error.code != Errc::held_too_long) errors.push_back(report.error.what);
    });
    Tier tier(loop, {.name = "fast", .ring_bytes = 4096});
    std::vector<Feed<Count>> feeds;
    for (int i = 0; i < 100; ++i) feeds.emplace_back(tier.loop(), FeedConfig{.name = "f" + std::to_string(i)});
    tier.call([&](Loop&) {
      for (auto& feed : feeds) feed.publish({1});
    });
    tier.start();
    int done = 0;
    int asked = 1;
    SUBCASE("two at once") {
      for (asked = 0; asked < 2; ++asked) loop.drain(1h, [&](std::uint64_t) { ++done; });
      tier.call([](Loop&) {});  // it has come to both
    }
    SUBCASE("stopped meanwhile") {
      loop.drain(1h, [&](std::uint64_t) { ++done; });
      tier.stop();
    }
    SUBCASE("stopped and started again meanwhile") {
      loop.drain(1h, [&](std::uint64_t) { ++done; });
      tier.stop();
      tier.start();
    }
    CHECK(run_until(loop, [&] { return done == asked; }));
    CHECK(std::find(errors.begin(), errors.end(), "did not stop in time") == errors.end());
    CHECK(loop.runtime().balances());
    std::uint64_t published = 0;
    for (const SensorStatus& sensor : loop.runtime().sensors()) published += sensor.counts.published;
    CHECK(published == 100);
  }

  TEST_CASE("changes of health on a tier that the main loop does not take are dropped beyond a number, and counted") {
    Loop loop{virtual_time(), {.hold_limit = 60s}};
    std::vector<std::string> lines;
    loop.runtime().on_log([&](const LogRecord& record) { lines.emplace_back(record.text); });
    Tier tier(loop, {.name = "fast", .hold_limit = 60s});
    tier.start();
    tier.call([](Loop& on) {
      for (int i = 0; i < 5000; ++i)  // those of one are joined
        on.core().runtime.health_changed("sensor", "s" + std::to_string(i), Health::faulted, "gone");
    });
    CHECK(run_until(loop, [&] { return !lines.empty(); }));
    CHECK(lines[0] == "4000 lines, errors and changes of health of tiers were dropped: too many at once");
  }

  TEST_CASE("a tier that goes leaves the others as they were") {
    Loop loop;
    std::vector<std::string> lines;
    loop.runtime().on_log([&](const LogRecord& record) { lines.emplace_back(record.text); });
    auto goes = std::make_unique<Tier>(loop, Tier::Config{.name = "goes"});
    Tier stays(loop, {.name = "stays", .cpus = {1000}});
    Tier idle(loop, {.name = "idle"});
    std::atomic<unsigned> ticks{0};
    const Ticker ticker(stays.loop(), 1ms, [&](const Tick&) { ++ticks; });
    CHECK(run_until(loop, [&] { return ticks > 10; }));
    idle.stop();
    const std::size_t told = lines.size();
    goes.reset();
    CHECK(stays.is_running());
    CHECK_FALSE(idle.is_running());
    const unsigned before = ticks;
    CHECK(run_until(loop, [&] { return ticks > before + 10; }));
    CHECK(lines.size() == told);  // the warning is not repeated
  }

  TEST_CASE("a handler of log records that throws costs a line, nothing else") {
    Loop loop{Loop::Manual{}};
    unsigned lines = 0;
    loop.on_error([](const ErrorReport&) {});
    loop.runtime().on_log([&](const LogRecord&) {
      ++lines;
      throw std::runtime_error("the log is full");
    });
    bool fails = true;
    Sensor<Count> sensor(loop, {.name = "s", .rate = 10_Hz}, [&]() -> Result<Count> {
      if (std::exchange(fails, false)) return Error{Errc::bad_data, "cannot read", "", "", ""};
      return Count{};
    });
    loop.advance(1s);
    CHECK(lines > 0);  // "ok again"
    CHECK(sensor.counts().taken >= 9);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("lines of a tier that the main loop does not take are dropped beyond a number, and counted") {
    Loop loop{virtual_time(), {.hold_limit = 60s}};
    std::vector<std::string> lines;
    loop.runtime().on_log([&](const LogRecord& record) { lines.emplace_back(record.text); });
    Tier tier(loop, {.name = "fast", .hold_limit = 60s});
    tier.start();  // the main loop does not run yet
    tier.call([](Loop& on) {
      for (int i = 0; i < 5000; ++i) on.core().runtime.log(LogLevel::info, "talk", std::to_string(i));
    });
    CHECK(run_until(loop, [&] { return lines.size() >= 1001; }));
    CHECK(lines.size() == 1001);
    CHECK(lines[0] == "4000 lines, errors and changes of health of tiers were dropped: too many at once");
  }

  TEST_CASE("a feed of a tier that was faulted and publishes again is ok on the main loop too") {
    Loop loop{virtual_time()};
    Tier fast(loop, {});
    Feed<Count> feed(fast.loop(), {.name = "echo"});
    const auto told = [&] {
      return loop.runtime().sensors().empty() ? SensorStatus{} : loop.runtime().sensors().front();
    };
    fast.start();
    fast.call([&](Loop&) { feed.fault({Errc::disconnected, "cannot hear", "", "it is gone", ""}); });
    CHECK(run_until(loop, [&] { return told().health == Health::faulted; }));
    CHECK(told().outages.number == 1);
    CHECK(run_until(loop, [&] { return told().outages.time > 1ms; }));  // while it lasts
    fast.call([&](Loop&) { feed.publish({1}); });                       // as much more in the account as health is less
    CHECK(run_until(loop, [&] { return told().health == Health::ok && told().counts.published == 1; }));
    const Outages ended = told().outages;
    CHECK(ended.number == 1);
    CHECK(ended.time > 1ms);
    loop.run_for(2ms);
    CHECK(told().outages.time == ended.time);
    CHECK(loop.runtime().has_loss());
  }

  TEST_CASE("a tier may be destroyed by the handler of a report about what it announced") {
    Loop loop{virtual_time(), {.hold_limit = 60s}};  // no reports but those of the tier
    auto fast = std::make_unique<Tier>(loop, Tier::Config{});
    loop.topic<Count>("one");
    fast->loop().topic<double>("one");
    fast->loop().topic<Count>("two");
    unsigned reports = 0;
    bool had_heard_all = false;
    loop.on_error([&](const ErrorReport&) {
      ++reports;
      had_heard_all = loop.runtime().core().find_topic("two") != nullptr;
      fast.reset();
    });
    CHECK(run_until(loop, [&] { return fast == nullptr; }));
    CHECK(reports == 1);
    CHECK(had_heard_all);
  }

  TEST_CASE("the time of day noted on a tier is kept by the main loop") {
    Loop loop;
    Tier fast(loop, {});
    fast.start();
    const auto pairs = [&] { return loop.runtime().core().clock_log.pairs(); };
    const auto noted = fast.call([](Loop& on) {
      return on.runtime()
          .note_wall_clock({.monotonic = on.now(), .realtime = Time{1h}, .source = "gps", .accuracy = 1us})
          .has_value();
    });
    CHECK(noted);
    CHECK(run_until(loop, [&] {
      for (const ClockPair& pair : pairs()) {
        if (pair.source == "gps") return true;
      }
      return false;
    }));
  }

  TEST_CASE("a tier may go while its events are under way, and before or after its handles") {
    Loop loop;
    std::uint64_t seen = 0;
    auto subscription = loop.subscribe<Count>("count", [&](const Event<Count>&) { ++seen; });
    for (int round = 0; round < 5; ++round) {
      auto fast = std::make_unique<Tier>(loop, Tier::Config{});
      auto burst = std::make_unique<Burst>(fast->loop(), 1'000'000, 50, "count" + std::to_string(round));
      CHECK(run_until(loop, [&, from = seen] { return seen > from + 100; }));
      if (round % 2 == 0) burst.reset();
      fast.reset();
    }
    loop.run_for(5ms);
    CHECK(subscription.counts().balances());
  }

  TEST_CASE("a million events to a subscriber that is too slow: each is delivered or counted") {
    Loop loop{virtual_time()};
    Tier fast(loop, {});
    Burst burst(fast.loop(), 1'000'000, 20'000);
    std::uint64_t seen = 0;
    auto subscription = loop.subscribe<Count>("count", [&](const Event<Count>&) {
      if (++seen % 1000 == 0) loop.manual_clock().pass(1ms);
    });
    CHECK(run_until(loop, [&] {
      const auto counts = subscription.counts();
      return burst.is_done && counts.offered == 1'000'000 && counts.queued == 0;
    }));
    const auto counts = subscription.counts();
    CHECK(counts.delivered == seen);
    CHECK(counts.balances());
  }

  TEST_CASE("NFR-1 a tier that hangs refuses what needs it, at once when that is known, and does none of it later") {
    for (const bool is_watched : {false, true}) {
      CAPTURE(is_watched);
      Loop loop{virtual_time(), {.hold_limit = 60s}};
      loop.runtime().on_log([](const LogRecord&) {});
      loop.on_error([](const ErrorReport&) {});
      int readings = 0;
      bool hangs{false}, let_go{false};
      Tier fast(loop, {.name = "fast", .hold_limit = 60s});
      std::optional<TierWatch> watch;
      if (is_watched) watch.emplace(loop, 1s);
      Sensor<Count> sensor(fast.loop(), {.name = "reader", .rate = 100_Hz}, [&] {
        if (++readings < 200) return Count{1};
        hangs = true;
        while (!let_go) loop.manual_clock().pass(1ms);
        return Count{1};
      });
      fast.start();
      CHECK(run_until(loop, [&] { return hangs; }));
      if (is_watched) loop.advance(2s);
      bool was_called = false;
      const auto refused = [&](const auto& verb) {
        const MonotonicTime began = loop.now();
        try {
          verb();
          CHECK_MESSAGE(false, "it was done");
        } catch (const SetupError& error) {
          CHECK(error.error().code == Errc::not_turning);
          CHECK(error.error().why.find("it has not returned from sensor reader") != std::string::npos);
        }
        return loop.now() - began;
      };
      const Duration first = refused([&] { fast.call([&](Loop&) { was_called = true; }); });
      CHECK(first >= (is_watched ? 0s : 1s));
      CHECK(first <= (is_watched ? 0s : 1100ms));
      CHECK(refused([&] { sensor.stop(); }) == 0s);
      CHECK(refused([&] { sensor.set_rate(1_Hz); }) == 0s);
      // What the main loop knows, and not nothing.
      CHECK(sensor.counts().received > 50);
      CHECK(sensor.is_running());
      CHECK(sensor.rate() == 100_Hz);
      CHECK(sensor.health() == Health::faulted);
      CHECK(sensor.status().reason.find("does not turn") != std::string::npos);
      let_go = true;
      loop.advance(1s);
      CHECK(fast.call([](Loop&) { return 7; }) == 7);
      CHECK(sensor.is_running());
      CHECK_FALSE(was_called);
      CHECK(sensor.health() == Health::ok);
    }
  }

  TEST_CASE("NFR-1 what has begun on a tier and does not come back is given up, told, and done once") {
    Loop loop{virtual_time(), {.hold_limit = 60s}};
    loop.runtime().on_log([](const LogRecord&) {});
    int opened = 0;
    bool let_go{false};
    struct Device {
      Loop& loop;
      int& opened;
      bool& let_go;
      Result<void> open() {
        ++opened;
        while (!let_go) loop.manual_clock().pass(1ms);
        return {};
      }
      Count read() { return Count{1}; }
    };
    Tier fast(loop, {.name = "fast", .hold_limit = 60s});
    Sensor<Count> sensor(fast.loop(), {.name = "slow", .rate = 100_Hz, .start = false}, Device{loop, opened, let_go});
    fast.start();
    const MonotonicTime began = loop.now();
    std::string advice;
    try {
      sensor.start();
    } catch (const SetupError& error) {
      CHECK(error.error().code == Errc::not_turning);
      advice = error.error().advice;
    }
    CHECK(advice.find("the loop has begun to do what was asked") != std::string::npos);
    CHECK(loop.now() - began >= 1s);
    CHECK(loop.now() - began <= 1100ms);
    CHECK_THROWS_AS(sensor.stop(), SetupError);  // at once, and not done later
    CHECK(loop.now() - began <= 1100ms);
    let_go = true;
    loop.advance(1s);
    CHECK(opened == 1);
    CHECK(sensor.is_running());
    CHECK_FALSE(sensor.start());
    CHECK(sensor.stop());
    CHECK_FALSE(sensor.stop());
  }

  TEST_CASE("NFR-1 a tier that is held for a moment is waited for, and what it was asked is done once") {
    Loop loop{virtual_time(), {.hold_limit = 60s}};
    loop.runtime().on_log([](const LogRecord&) {});
    Tier fast(loop, {.name = "fast", .hold_limit = 60s});
    fast.start();
    int calls = 0;
    for (int i = 0; i < 3; ++i) {
      fast.loop().post([&] { loop.manual_clock().pass(700ms); });
      fast.call([&](Loop&) { ++calls; });
      CHECK(calls == i + 1);
      loop.advance(1s);
    }
    CHECK(calls == 3);
  }

  TEST_CASE("NFR-1 what is closed on a tier that hangs is waited for for 5 s, and closed by the tier when it turns") {
    Loop loop{virtual_time(), {.hold_limit = 60s}};
    loop.runtime().on_log([](const LogRecord&) {});
    std::vector<std::string> errors;
    bool let_go{false};
    int ticks{0};
    Tier fast(loop, {.name = "fast", .hold_limit = 60s});
    fast.loop().on_error([&](const ErrorReport& report) { errors.push_back(report.error.what); });
    Ticker ticker(fast.loop(), Ticker::Config{.period = 1ms, .name = "beat"}, [&](const Tick&) { ++ticks; });
    Ticker other(fast.loop(), Ticker::Config{.period = 1ms, .name = "other"}, [&](const Tick&) {
      while (!let_go) loop.manual_clock().pass(1ms);
    });
    fast.start();
    loop.advance(10ms);
    const MonotonicTime began = loop.now();
    ticker.close();
    CHECK(loop.now() - began >= 5s);
    CHECK(loop.now() - began <= 5100ms);
    other.close();  // it is known by now
    CHECK(loop.now() - began <= 5100ms);
    let_go = true;
    loop.advance(1s);
    CHECK(errors == std::vector<std::string>{"was closed late", "was closed late"});
    const int after = ticks;
    loop.advance(1s);
    CHECK(ticks == after);
  }

  TEST_CASE("NFR-1 what is closed on a tier that hangs says so, and for which callback") {
    Loop loop{virtual_time(), {.hold_limit = 60s}};
    bool hangs{false}, let_go{false};
    std::vector<std::string> told;
    loop.runtime().on_log([&](const LogRecord& record) {
      told.push_back(std::string(record.object) + ": " + std::string(record.text));
      let_go = true;
    });
    Tier fast(loop, {.name = "fast", .hold_limit = 60s});
    Ticker ticker(fast.loop(), Ticker::Config{.period = 1ms, .name = "beat"}, [&](const Tick&) {
      hangs = true;
      while (!let_go) loop.manual_clock().pass(1ms);
    });
    fast.start();
    CHECK(run_until(loop, [&] { return hangs; }));
    ticker.close();
    REQUIRE(told.size() == 1);
    CHECK(told[0] == "loop fast: is waited for: it has not returned from beat for 1 s");
  }

  TEST_CASE("NFR-1 a tier that was given up and then ends is stopped: nobody waits for it, and it starts again") {
    for (const bool ends_while_waited_for : {false, true}) {
      CAPTURE(ends_while_waited_for);
      bool hangs{false}, let_go{false};
      unsigned ticks{0};
      Loop loop{virtual_time()};
      loop.runtime().on_log([&](const LogRecord&) { let_go = true; });  // "is waited for: it has not returned from ..."
      Tier fast(loop, {.name = "fast", .hold_limit = 60s});
      Ticker ticker(fast.loop(), 1ms, [&](const Tick&) {
        hangs = true;
        while (!let_go) loop.manual_clock().pass(1ms);
        ++ticks;
      });
      Ticker other(fast.loop(), Ticker::Config{.period = 1h}, [](const Tick&) {});
      fast.start();
      CHECK(run_until(loop, [&] { return hangs; }));
      CHECK_FALSE(fast.stop_within(5ms));
      if (ends_while_waited_for) {
        other.close();  // "is waited for: it has not returned from ..."
      } else {
        let_go = true;
        CHECK(run_until(loop, [&] { return !fast.is_running(); }));
      }
      other.close();
      CHECK_FALSE(fast.is_running());
      const unsigned before = ticks;
      fast.start();
      CHECK(run_until(loop, [&] { return ticks > before + 10; }));
      fast.stop();
      CHECK(loop.close() == 0);
      CHECK(loop.runtime().balances());
    }
  }

  TEST_CASE("NFR-1 a tier that hangs is not waited for longer than asked, and says which callback it is in") {
    Loop loop{virtual_time()};
    loop.runtime().on_log([](const LogRecord&) {});
    Tier fast(loop, {.name = "fast"});
    CHECK(fast.doing().empty());
    CHECK(fast.stop_within(0ms));  // it does not run
    bool hangs{false}, let_go{false};
    const auto hang = [&] {
      hangs = true;
      while (!let_go) loop.manual_clock().pass(1ms);
    };
    const auto check = [&](const std::string& what) {
      CHECK(run_until(loop, [&] { return hangs; }));
      CHECK_FALSE(fast.stop_within(5ms));
      CHECK(fast.is_running());
      CHECK(fast.doing() == what);
      let_go = true;
      CHECK(fast.stop_within(10s));
      CHECK_FALSE(fast.is_running());
      hangs = let_go = false;
    };
    {
      const Sensor<Count> sensor(fast.loop(), {.name = "reader", .rate = 100_Hz}, [&] {
        hang();
        return Count{1};
      });
      fast.start();
      check("sensor reader");
    }
    CHECK(fast.doing().empty());  // it is gone
    {
      const Timer timer(fast.loop(), 1ms, hang);
      fast.start();
      check("timer");
    }
    {
      const Ticker ticker(fast.loop(), Ticker::Config{.period = 5ms, .name = "beat"}, [&](const Tick&) { hang(); });
      fast.start();
      check("beat");
    }
    {
      Feed<Count> feed(fast.loop(), {.name = "feed"});
      auto handler = fast.loop().subscribe("feed", [&](const EventView&) { hang(); });
      handler.set_name("printer");
      fast.start();
      fast.call([&](Loop&) { feed.publish(Count{1}); });
      check("printer");
    }
    fast.start();
    fast.loop().post(hang);
    check("");
  }

  TEST_CASE("callbacks of a tier are surveyed while it runs, a few at a time, whatever goes meanwhile") {
    Loop loop;
    Tier fast(loop, {.name = "fast"});
    std::vector<Sensor<Count>> sensors;
    constexpr std::size_t count = 200;
    for (std::size_t i = 0; i < count; ++i) {
      sensors.push_back(
          Sensor<Count>(fast.loop(), {.name = "s" + std::to_string(i), .rate = 1_kHz}, [] { return Count{1}; }));
    }
    CHECK(run_until(loop, [&] { return sensors.back().counts().taken > 0; }));
    std::shared_ptr<detail::CallbackSurvey> all;
    const auto survey = [&] {
      all = fast.loop().core().nodes.begin_survey();
      return all->wait(30s);
    };
    REQUIRE(survey());
    std::vector<std::string> names;
    for (const CallbackStatus& one : all->callbacks()) {
      if (one.name.starts_with("sensor s")) names.push_back(one.name);
      CHECK(one.times.count > 0);
    }
    REQUIRE(names.size() == count);
    for (std::size_t i = 0; i < count; ++i) CHECK(names[i] == "sensor s" + std::to_string(i));
    // Those that go while it is under way do no harm, and the others are all there.
    fast.call([&](Loop& on) {
      all = on.core().nodes.begin_survey();
      on.post([&] {  // between its first turn and the next
        for (std::size_t i = 0; i < count; i += 2) sensors[i].close();
      });
    });
    REQUIRE(all->wait(30s));
    std::size_t left = 0;
    for (const CallbackStatus& one : all->callbacks()) {
      if (one.name.starts_with("sensor s") && std::stoi(one.name.substr(8)) % 2 == 1) ++left;
    }
    CHECK(left == count / 2);
    loop.close();
  }

  TEST_CASE("NFR-4 everything works on one processor") {
    CHECK(in_child([] {
      cpu_set_t one;
      CPU_ZERO(&one);
      CPU_SET(0, &one);
      if (::sched_setaffinity(0, sizeof one, &one) != 0) return false;
      Loop loop;
      Tier fast(loop, {.policy = SchedulingPolicy::fifo, .priority = 10});
      Burst burst(fast.loop(), 2000, 10);
      auto subscription = loop.subscribe<Count>("count", [](const Event<Count>&) {});
      const bool all = run_until(loop, [&] {
        return burst.is_done && subscription.counts().offered == 2000 && subscription.counts().queued == 0;
      });
      return all && subscription.counts().balances();
    }));
  }

  TEST_CASE("spinning ends at the deadline and leaves the schedule as it is") {
    Loop loop;
    Tier fast(loop, {.spin = 200us});
    std::atomic<unsigned> early{0};
    std::atomic<unsigned> ticks{0};
    Ticker ticker(fast.loop(), 2ms, [&](const Tick& tick) {
      if (tick.now < tick.due) ++early;
      ++ticks;
    });
    CHECK(run_until(loop, [&] { return ticks > 20; }));
    CHECK(early == 0);
  }

  TEST_CASE("the main loop tells of its tiers, which tier a sensor is on, and how long callbacks took") {
    Loop loop;
    Tier fast(loop, {.name = "fast"});
    const Sensor<Count> there(fast.loop(), {.name = "there", .rate = 1_kHz}, [] { return Count{1}; });
    const Sensor<Count> here(loop, {.name = "here", .rate = 1_kHz}, [] { return Count{2}; });
    const auto of = [&](std::string_view name) {
      for (const SensorStatus& sensor : loop.runtime().sensors()) {
        if (sensor.name == name) return sensor;
      }
      return SensorStatus{};
    };
    CHECK_FALSE(loop.runtime().loops().at(1).running);
    CHECK(run_until(loop, [&] { return of("there").counts.taken > 10 && here.counts().taken > 10; }));
    CHECK(of("there").loop == "fast");
    CHECK(of("here").loop == "main");
    CHECK(of("there").first_due > Time{});
    const std::vector<LoopStatus> loops = loop.runtime().loops();
    REQUIRE(loops.size() == 2);
    CHECK(loops[0].name == "main");
    CHECK_FALSE(loops[0].is_tier);
    CHECK(loops[1].name == "fast");
    CHECK(loops[1].is_tier);
    CHECK(loops[1].running);
    CHECK(loops[1].scheduling.policy == SchedulingPolicy::other);
    CHECK(loops[1].processor_time > Duration{0});
    bool has_sensor = false;
    for (const CallbackStatus& one : loop.callbacks()) {
      CHECK(one.name != "sensor there");  // the tier's own
      if (one.name != "sensor here") continue;
      has_sensor = true;
      CHECK(one.times.count == here.counts().taken);
      CHECK(one.times.max <= one.times.total);
    }
    CHECK(has_sensor);
  }
}
