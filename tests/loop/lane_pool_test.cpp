// Lanes that share a pool of threads. All of it is about threads, so it takes real ones.
#include "loop/core/lane_pool.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <atomic>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "loop/core/loop_core.hpp"
#include "loop/lane_job.hpp"
#include "loop/lane_sensor.hpp"
#include "loop/observed.hpp"
#include "loop/run_until.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/timer.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using detail::Lane;
using detail::LanePool;
using lane_job::job;
using lane_job::Outcome;
using lane_job::Stuck;
using lane_sensor::LaneSensor;
using lane_sensor::Reads;

namespace {

/// A loop of whose lanes so many may have a slow job at once; one is quick whose last job took no longer than `quick`,
/// however slow the machine is.
struct Bench {
  std::vector<Outcome> told;
  Stuck stuck;
  Loop loop;
  std::shared_ptr<LanePool> pool;
  int numbered = 0;

  explicit Bench(std::size_t threads, Duration quick = 1h) : pool(std::make_shared<LanePool>(threads, quick)) {
    loop.core().lanes.set_pool(pool);
  }
  Lane& lane(const std::string& name, Duration limit = 1h) { return loop.core().lanes.of(name, limit); }
  Lane& new_lane(Duration limit = 1h) { return lane("lane " + std::to_string(numbered++), limit); }
  Lane& quick_lane() {
    Lane& made = new_lane();
    ask(made);
    return made;
  }
  /// Runs a job, and the loop until it has ended.
  void ask(Lane& of) {
    bool is_done = false;
    REQUIRE(of.submit(job({}, [&](Outcome outcome) {
      CHECK(outcome == Outcome::finished);
      is_done = true;
    })));
    run_until(loop, [&] { return is_done; });
  }
  void hang(Lane& of) {
    REQUIRE(of.submit(job(stuck.work(), [this](Outcome outcome) { told.push_back(outcome); })));
  }
};

}  // namespace

TEST_SUITE("loop") {
  TEST_CASE("NFR-1 devices that answer do not wait for those that hang, however many there are") {
    constexpr int threads = 4;
    Bench bench(threads);
    std::vector<Lane*> good;
    for (int i = 0; i < 3; ++i) good.push_back(&bench.quick_lane());
    const auto ask_all = [&] {
      for (int round = 0; round < 20; ++round)
        for (Lane* one : good) bench.ask(*one);
    };
    ask_all();
    SUBCASE("devices of which nothing is known: more than there are threads") {
      for (int i = 0; i < threads + 2; ++i) bench.hang(bench.new_lane());
      ask_all();
      CHECK(bench.stuck.begun() == threads);  // the others wait
      bench.stuck.release();
      bench.loop.run();
      CHECK(bench.told == std::vector<Outcome>(threads + 2, Outcome::finished));
    }
    SUBCASE("devices that were quick until now: each may have a thread") {
      for (int i = 0; i < threads + 2; ++i) {
        bench.hang(bench.quick_lane());
        ask_all();
      }
      CHECK(bench.stuck.begun() == threads + 2);
      CHECK(bench.pool->threads() >= threads + 3);
      bench.stuck.release();
      bench.loop.run();
      CHECK(bench.told == std::vector<Outcome>(threads + 2, Outcome::finished));
      ask_all();
    }
    SUBCASE("both, at once with those that answer") {
      std::vector<Lane*> were_quick;
      for (int i = 0; i < threads; ++i) were_quick.push_back(&bench.quick_lane());
      int finished = 0;
      for (int i = 0; i < threads; ++i) {
        bench.hang(bench.new_lane());
        bench.hang(*were_quick[static_cast<std::size_t>(i)]);
        for (Lane* one : good) CHECK(one->submit(job({}, [&](Outcome) { ++finished; })));
      }
      run_until(bench.loop, [&] { return finished == 3 * threads; });
      CHECK(bench.told.empty());
      bench.stuck.release();
      bench.loop.run();
      CHECK(bench.told.size() == 2 * threads);
    }
  }

  TEST_CASE("NFR-1 a device of which nothing is known waits for those that hang no longer than their limits") {
    constexpr int threads = 3, count = 9;
    Bench bench(threads, 0ns);  // none is ever known to be quick
    std::vector<Lane*> bad;
    for (int i = 0; i < count; ++i) bad.push_back(&bench.new_lane(20ms));
    for (Lane* one : bad) bench.hang(*one);
    Lane& good = bench.new_lane();
    bench.ask(good);
    CHECK(bench.told.size() >= count - threads + 1);
    for (const Outcome outcome : bench.told) CHECK(outcome == Outcome::given_up);
    bench.loop.run();
    CHECK(bench.told.size() == count);
    CHECK(bench.pool->abandoned_threads() == count);
    for (Lane* one : bad) CHECK(one->abandoned_threads() == 1);
    for (Lane* one : bad) bench.ask(*one);  // each goes on with another thread
    bench.stuck.release();
    while (bench.pool->abandoned_threads() > 0) std::this_thread::yield();
    for (Lane* one : bad) bench.ask(*one);
  }

  TEST_CASE("what waits behind a job that is given up goes on, in order") {
    Bench bench(4);
    Lane& lane = bench.new_lane(20ms);
    std::vector<int> order;
    bench.hang(lane);
    for (int i = 0; i < 20; ++i) CHECK(lane.submit(job({}, [&order, i](Outcome) { order.push_back(i); }), 1h));
    bench.loop.run();
    CHECK(bench.told == std::vector<Outcome>{Outcome::given_up});
    CHECK(order.size() == 20);
    CHECK(std::is_sorted(order.begin(), order.end()));
  }

  TEST_CASE("NFR-1 a job that has ended is told of, although the next of its device hangs on the same thread") {
    Bench bench(4);
    Lane& lane = bench.quick_lane();
    Lane& other = bench.quick_lane();
    Stuck first;
    bool is_first_done = false, is_other_done = false;
    REQUIRE(lane.submit(job(first.work(), [&](Outcome) { is_first_done = true; })));
    REQUIRE(other.submit(job({}, [&](Outcome) { is_other_done = true; })));
    run_until(bench.loop, [&] { return is_other_done; });  // another thread goes on
    bench.hang(lane);
    bench.ask(other);          // that thread has put the second job behind the first
    bench.loop.run_for(20ms);  // until it does not look after its threads any more
    first.release();
    run_until(bench.loop, [&] { return is_first_done; });
    CHECK(bench.told.empty());
    bench.stuck.release();
    bench.loop.run();
    CHECK(bench.told == std::vector<Outcome>{Outcome::finished});
  }

  TEST_CASE("each lane runs one job at a time, in order, whichever thread has it") {
    Duration quick{0};
    std::size_t threads = 4;
    SUBCASE("all are quick") { quick = 1h; }
    SUBCASE("none is") {}
    SUBCASE("some are") { quick = 20us; }
    SUBCASE("few may be slow at once") { threads = 1; }
    Bench bench(threads, quick);
    constexpr int lanes = 12, rounds = 60;
    struct Device {
      std::atomic<int> users{0};
      std::atomic<int> collisions{0};
      std::vector<int> ran;  // on the lane
      std::vector<int> told;
    };
    std::vector<std::unique_ptr<Device>> devices;
    for (int i = 0; i < lanes; ++i) devices.push_back(std::make_unique<Device>());
    int outstanding = 0;
    for (int round = 0; round < rounds; ++round) {
      for (int i = 0; i < lanes; ++i) {
        Device& device = *devices[static_cast<std::size_t>(i)];
        ++outstanding;
        CHECK(bench.lane(std::to_string(i))
                  .submit(job(
                      [&device, round, i] {
                        if (++device.users != 1) ++device.collisions;
                        device.ran.push_back(round);
                        if ((round + i) % 7 == 0) detail::lane_sleep(200us);
                        --device.users;
                      },
                      [&device, &outstanding, round](Outcome outcome) {
                        CHECK(outcome == Outcome::finished);
                        device.told.push_back(round);
                        --outstanding;
                      })));
      }
      if (round % 5 == 0) run_until(bench.loop, [&] { return outstanding < 3 * lanes; });
    }
    bench.loop.run();
    for (const auto& device : devices) {
      CHECK(device->collisions == 0);
      CHECK(device->ran.size() == rounds);
      CHECK(std::is_sorted(device->ran.begin(), device->ran.end()));
      CHECK(device->told == device->ran);
    }
  }

  TEST_CASE("a device is quick again when one job was, and slow when one was: quick ones share a thread") {
    constexpr Duration quick = 300ms, slow = 350ms;
    Bench bench(4, quick);
    Lane& lane = bench.quick_lane();
    Lane& other = bench.quick_lane();
    // Whether a job of the other lane, which was submitted after one of `lane`, runs before that one has ended. The
    // loop does not run meanwhile, so that it sends no other thread.
    const auto other_runs_beside_it = [&](Duration at_most) {
      std::atomic<bool> other_ran{false};
      std::atomic<int> ended{0};
      bool is_beside = false;
      REQUIRE(lane.submit(job(
          [&] {
            const auto end = std::chrono::steady_clock::now() + at_most;
            while (!other_ran && std::chrono::steady_clock::now() < end) std::this_thread::yield();
            is_beside = other_ran;
            ++ended;
          },
          {})));
      REQUIRE(other.submit(job(
          [&] {
            other_ran = true;
            ++ended;
          },
          {})));
      while (ended < 2) std::this_thread::yield();
      bench.loop.run();
      return is_beside;
    };
    const auto ask_slowly = [&] {
      bool is_done = false;
      REQUIRE(lane.submit(job([slow] { detail::lane_sleep(slow); }, [&](Outcome) { is_done = true; })));
      run_until(bench.loop, [&] { return is_done; });
    };
    CHECK_FALSE(other_runs_beside_it(20ms));
    ask_slowly();
    CHECK(other_runs_beside_it(1h));
    CHECK_FALSE(other_runs_beside_it(20ms));
  }

  TEST_CASE("NFR-1 eight devices hang at their first read together, and one that answers misses nothing") {
    Loop loop;
    std::vector<std::unique_ptr<LaneSensor<observed::Count>>> hung;
    for (int i = 0; i < 8; ++i) {
      hung.push_back(std::make_unique<LaneSensor<observed::Count>>(
          loop, SensorConfig{.name = "hung" + std::to_string(i), .rate = Rate::from_period(100ms)}, Reads{.take = 2s}));
    }
    const LaneSensor<observed::Count> good(loop, {.name = "good", .rate = Rate::from_period(100ms)});
    run_until(loop, [&] { return good.counts().published >= 8; });
    CHECK(good.counts().missed == 0);
    for (const auto& one : hung) CHECK(one->counts().published == 0);
  }

  TEST_CASE("quick devices that all hang at once are set apart, and those behind them go on") {
    Bench bench(1);
    std::vector<Lane*> bad;
    for (int i = 0; i < 8; ++i) bad.push_back(&bench.quick_lane());
    Lane& good = bench.quick_lane();
    for (Lane* one : bad) bench.hang(*one);
    for (int round = 0; round < 20; ++round) bench.ask(good);
    CHECK(bench.stuck.begun() == 8);
    CHECK(bench.told.empty());
    bench.stuck.release();
    bench.loop.run();
    CHECK(bench.told == std::vector<Outcome>(8, Outcome::finished));
  }

  TEST_CASE("a device that waits longer than its limit, since so many are slow, is told of once") {
    Bench bench(2);
    bench.loop.runtime().on_log([](const LogRecord&) {});
    std::vector<std::string> heard;
    const auto health = bench.loop.subscribe<HealthChange>(health_topic, [&](const Event<HealthChange>& event) {
      heard.push_back(std::string(event.data.name) + ' ' + std::string(name_of(event.data.state)) + ": " +
                      std::string(event.data.reason));
    });
    for (int i = 0; i < 2; ++i) bench.hang(bench.new_lane());
    bool is_done = false;
    REQUIRE(bench.lane("late", 10ms).submit(job({}, [&](Outcome outcome) {
      CHECK(outcome == Outcome::finished);
      is_done = true;
    })));
    run_until(bench.loop, [&] { return !heard.empty(); });
    bench.loop.run_for(50ms);
    CHECK(heard ==
          std::vector<std::string>{
              "late degraded: a job waits for longer than its limit of 10 ms: all threads for slow devices are "
              "busy"});
    CHECK_FALSE(is_done);
    bench.stuck.release();
    bench.loop.run();
    CHECK(is_done);
    CHECK(heard.back() == "late ok: ");
    CHECK(heard.size() == 2);
  }

  TEST_CASE("what is submitted in a callback of a deadline can be waited for there, and is run without that, too") {
    Bench bench(4);
    Lane& lane = bench.new_lane();
    bool is_done = false, is_done_later = false;
    Timer timer(bench.loop, 0ns, [&] {
      CHECK(lane.submit(job({}, [&](Outcome) { is_done = true; })));
      lane.wait(1h);
      CHECK(is_done);
      CHECK(lane.submit(job({}, [&](Outcome) { is_done_later = true; })));
    });
    bench.loop.run();
    CHECK(is_done_later);
  }

  TEST_CASE("with many threads left behind, a lane leaves only its first behind") {
    constexpr std::size_t many = 64;
    Bench bench(many);
    std::vector<Lane*> lanes;
    for (std::size_t i = 0; i < many; ++i) lanes.push_back(&bench.new_lane(5ms));
    for (Lane* one : lanes) bench.hang(*one);
    bench.loop.run();
    CHECK(bench.pool->abandoned_threads() == many);
    CHECK(lanes[0]->is_stuck());
    CHECK_FALSE(lanes[0]->lacks_thread());
    CHECK_FALSE(lanes[0]->submit(job({}, {})));
    bench.ask(bench.new_lane());
    bench.stuck.release();
    while (bench.pool->abandoned_threads() > 0) std::this_thread::yield();
    bench.ask(*lanes[0]);
  }

  TEST_CASE("a thousand devices that answer have a few threads") {
    constexpr int count = 1000;
    std::mutex mutex;
    std::set<std::thread::id> threads;
    Bench bench(detail::Lanes::most_slow);
    for (int round = 0; round < 3; ++round) {
      for (int i = 0; i < count; ++i) {
        CHECK(bench.lane(std::to_string(i))
                  .submit(job(
                      [&] {
                        const std::lock_guard lock(mutex);
                        threads.insert(std::this_thread::get_id());
                      },
                      {})));
      }
      bench.loop.run();
    }
    CHECK(threads.size() <= 2 * detail::Lanes::most_slow);
  }

  TEST_CASE("a loop ends while devices of its pool hang") {
    auto stuck = std::make_unique<Stuck>();
    std::vector<Outcome> told;
    {
      Loop loop;
      for (int i = 0; i < 5; ++i) {
        Lane& lane = loop.core().lanes.of(std::to_string(i), 10ms);
        CHECK(lane.submit(job(stuck->work(), [&](Outcome outcome) { told.push_back(outcome); })));
      }
      for (int i = 5; i < 8; ++i)
        CHECK(loop.core().lanes.of(std::to_string(i), 1h).submit(job({}, [&](Outcome outcome) {
          told.push_back(outcome);
        })));
    }
    CHECK(told.size() == 8);
    const auto hung = stuck->begun();
    CHECK(hung <= 5);
  }

  TEST_CASE("what waits behind the job that runs when a loop ends is not kept") {
    for (int round = 0; round < 300; ++round) {  // the thread ends its job about when the loop ends
      std::atomic<bool> runs{false}, may_end{false};
      std::vector<Outcome> told;
      std::weak_ptr<lane_job::Job> last;
      {
        Loop loop;
        Lane& lane = loop.core().lanes.of("device", 1h);
        const auto tell = [&](Outcome outcome) { told.push_back(outcome); };
        CHECK(lane.submit(job(
            [&] {
              runs = true;
              while (!may_end) std::this_thread::yield();
            },
            tell)));
        const auto behind = job({}, tell);
        last = behind;
        CHECK(lane.submit(behind));
        while (!runs) {
          loop.core().lanes.wake_threads();
          std::this_thread::yield();
        }
        may_end = true;
      }
      REQUIRE(told.size() == 2);  // the other one may have been taken, too
      CHECK(told[0] == Outcome::finished);
      for (int waited = 0; !last.expired() && waited < 1000; ++waited) std::this_thread::sleep_for(1ms);
      REQUIRE(last.expired());
    }
  }
}
