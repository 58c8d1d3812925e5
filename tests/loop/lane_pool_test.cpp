// Lanes that share a pool of threads. All of it is about threads, so it takes real ones.
#include "loop/core/lane_pool.hpp"

#include <doctest/doctest.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "loop/core/loop_core.hpp"
#include "loop/run_until.hpp"
#include "rtdata/loop/lane.hpp"
#include "rtdata/loop/timer.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using detail::Lane;
using detail::LaneJob;
using detail::LanePool;
using Outcome = LaneJob::Outcome;

namespace {

struct Job final : LaneJob {
  std::function<void()> work;
  std::function<void(Outcome)> told;
  void run() noexcept override {
    if (work) work();
  }
  void done(Outcome outcome) override {
    if (told) told(outcome);
  }
};

std::shared_ptr<Job> job(std::function<void()> work, std::function<void(Outcome)> told) {
  auto made = std::make_shared<Job>();
  made->work = std::move(work);
  made->told = std::move(told);
  return made;
}

/// Devices that do not answer until they are released: reads of an empty pipe.
struct Stuck {
  int fds[2];
  std::shared_ptr<std::atomic<int>> counted = std::make_shared<std::atomic<int>>(0);  // by threads that outlive this
  Stuck() { REQUIRE(::pipe(fds) == 0); }
  void release() {
    if (fds[1] >= 0) ::close(fds[1]);
    fds[1] = -1;
  }
  std::function<void()> work() {
    return [fd = fds[0], all = counted] {
      ++*all;
      char byte;
      [[maybe_unused]] const auto got = ::read(fd, &byte, 1);
    };
  }
  int begun() const { return *counted; }
  ~Stuck() { release(); }  // the end that is read stays open for a thread that may still be on its way to it
};

/// A loop whose lanes have so many threads; those that have had a job which took no longer than `quick` are known to be
/// quick, however slow the machine is.
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
      CHECK(bench.stuck.begun() == threads - 1);  // the others wait; one thread is kept for those that answer
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
    CHECK(bench.pool->left_behind() == count);
    for (Lane* one : bad) CHECK(one->left_behind() == 1);
    for (Lane* one : bad) bench.ask(*one);  // each goes on with another thread
    bench.stuck.release();
    while (bench.pool->left_behind() > 0) std::this_thread::yield();
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
    run_until(bench.loop, [&] { return is_other_done; });  // another thread leads
    bench.hang(lane);
    bench.ask(other);          // the new leader has put the second job behind the first
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
    SUBCASE("one thread leads, and one more") { threads = 2; }
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

  TEST_CASE("a device that was slow once is still known to be quick, and one that was slow twice is not") {
    constexpr Duration quick = 300ms, slow = 350ms;
    Bench bench(4, quick);
    Lane& lane = bench.quick_lane();
    Lane& other = bench.quick_lane();
    // Whether a job of the other lane, which was submitted after one of `lane`, runs before that one has ended. The
    // loop does not run meanwhile, so that it makes no other thread lead.
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
    const auto ask_quickly = [&](int times) {
      for (int i = 0; i < times; ++i) bench.ask(lane);
    };
    ask_quickly(4);
    bench.ask(other);
    CHECK_FALSE(other_runs_beside_it(20ms));
    ask_slowly();
    CHECK_FALSE(other_runs_beside_it(20ms));
    ask_slowly();
    CHECK(other_runs_beside_it(1h));
    ask_quickly(6);
    CHECK(other_runs_beside_it(1h));
    CHECK_FALSE(other_runs_beside_it(20ms));

    SUBCASE("slow again, after so many that were quick: it is forgotten") {
      ask_quickly(3);
      ask_slowly();
      CHECK_FALSE(other_runs_beside_it(20ms));
    }
    SUBCASE("slow again, sooner") {
      ask_quickly(2);
      ask_slowly();
      CHECK(other_runs_beside_it(1h));
    }
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
    CHECK(bench.pool->left_behind() == many);
    CHECK(lanes[0]->is_stuck());
    CHECK_FALSE(lanes[0]->lacks_thread());
    CHECK_FALSE(lanes[0]->submit(job({}, {})));
    bench.ask(bench.new_lane());
    bench.stuck.release();
    while (bench.pool->left_behind() > 0) std::this_thread::yield();
    bench.ask(*lanes[0]);
  }

  TEST_CASE("a thousand devices that answer have a few threads") {
    constexpr int count = 1000;
    std::mutex mutex;
    std::set<std::thread::id> threads;
    Bench bench(detail::Lanes::most_threads);
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
    CHECK(threads.size() <= 2 * detail::Lanes::most_threads);
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
}
