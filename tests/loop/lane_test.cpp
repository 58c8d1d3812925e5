#include "rtdata/detail/loop/lane.hpp"

#include <doctest/doctest.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/timer.hpp"

#include "loop/core/loop_core.hpp"
#include "loop/lane_job.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using detail::Lane;
using lane_job::Job;
using lane_job::job;
using lane_job::Outcome;
using lane_job::Stuck;

TEST_SUITE("loop") {
  TEST_CASE("a lane runs its jobs one at a time, not on the loop's thread, in order, and tells of each on the loop") {
    Loop loop;
    Lane& lane = loop.core().lanes.of("device", 10s);
    CHECK(&loop.core().lanes.of("device", 10s) == &lane);
    std::vector<int> ran;
    std::vector<int> told;
    std::vector<std::shared_ptr<Job>> jobs;
    std::atomic<int> running{0};
    std::atomic<bool> overlapped{false};
    for (int i = 0; i < 20; ++i) {
      jobs.push_back(job(
          [&, i] {
            if (running.fetch_add(1) != 0) overlapped = true;
            ran.push_back(i);
            running.fetch_sub(1);
          },
          [&told, i](Outcome outcome) {
            CHECK(outcome == Outcome::finished);
            told.push_back(i);
          }));
      CHECK(lane.submit(jobs.back()));
    }
    CHECK(told.empty());
    loop.run();  // returns when the last one is told of
    CHECK(told.size() == 20);
    CHECK(ran == told);
    CHECK_FALSE(overlapped);
    // Which thread of the pool runs a job is not promised: another one leads when the first is slow to come back.
    for (const auto& j : jobs) CHECK(j->ran_on != std::this_thread::get_id());
    CHECK(lane.submit(jobs[0]));  // a job may be used again
    loop.run();
    CHECK(told.size() == 21);
  }

  TEST_CASE("a lane takes as many jobs as there are") {
    constexpr int count = 10'000;
    Loop loop;
    Lane& lane = loop.core().lanes.of("device", 10s);
    Stuck stuck;
    std::vector<int> told;
    CHECK(lane.submit(job(stuck.work(), [](Outcome) {})));
    for (int i = 0; i < count; ++i) CHECK(lane.submit(job({}, [&told, i](Outcome) { told.push_back(i); })));
    stuck.release();
    loop.run();
    CHECK(told.size() == count);
    CHECK(std::is_sorted(told.begin(), told.end()));
  }

  TEST_CASE("a job that outlives the limit is given up, and the next goes on with a fresh thread") {
    Loop loop;
    Lane& lane = loop.core().lanes.of("device", 20ms);
    Stuck stuck;
    std::vector<std::pair<char, Outcome>> told;
    const auto blocked = job(stuck.work(), [&](Outcome outcome) { told.emplace_back('a', outcome); });
    const auto next = job({}, [&](Outcome outcome) { told.emplace_back('b', outcome); });
    CHECK(lane.submit(blocked));
    CHECK(lane.submit(next));
    loop.run();
    REQUIRE(told.size() == 2);
    bool saw_given_up = false;
    for (const auto& [name, outcome] : told) {
      if (name == 'a') saw_given_up = outcome == Outcome::given_up;
      if (name == 'b') CHECK(outcome == Outcome::finished);
    }
    CHECK(saw_given_up);
    CHECK(lane.abandoned_threads() == 1);
  }

  TEST_CASE("each job has a limit of its own") {
    Loop loop(Loop::Manual{});
    loop.script_lane_duration(300ms);
    Lane& lane = loop.core().lanes.of("device", 100ms);
    std::vector<std::pair<Outcome, Duration>> told;
    const auto note = [&](Outcome outcome) { told.emplace_back(outcome, loop.now().time_since_epoch()); };
    CHECK(lane.submit(job({}, note)));
    CHECK(lane.submit(job({}, note), 500ms));
    CHECK(lane.submit(job({}, note), 200ms));
    loop.advance(1s);
    CHECK(told == std::vector<std::pair<Outcome, Duration>>{
                      {Outcome::given_up, 100ms}, {Outcome::finished, 400ms}, {Outcome::given_up, 600ms}});
  }

  TEST_CASE("a job that hangs is given up by its own limit, also in front of one with a longer limit") {
    Loop loop;
    Lane& lane = loop.core().lanes.of("device", 10s);
    Stuck stuck;
    std::vector<Outcome> told;
    CHECK(lane.submit(job(stuck.work(), [&](Outcome outcome) { told.push_back(outcome); }), 20ms));
    CHECK(lane.submit(job({}, [&](Outcome outcome) { told.push_back(outcome); }), 10s));
    loop.run();
    CHECK(told == std::vector<Outcome>{Outcome::given_up, Outcome::finished});
  }

  TEST_CASE("so many threads are left behind; then nothing is taken, until one comes back") {
    Loop loop;
    Lane& lane = loop.core().lanes.of("device", 10s);
    std::vector<std::unique_ptr<Stuck>> stuck;
    int given_up = 0;
    const auto count = [&](Outcome outcome) { given_up += outcome == Outcome::given_up ? 1 : 0; };
    for (std::size_t i = 0; i < Lane::most_abandoned; ++i) {
      stuck.push_back(std::make_unique<Stuck>());
      CHECK(lane.submit(job(stuck.back()->work(), count)));
      if (i + 1 == Lane::most_abandoned) CHECK(lane.submit(job({}, count)));  // waits behind it
      lane.give_up();
    }
    CHECK(given_up >= static_cast<int>(Lane::most_abandoned));
    CHECK(lane.abandoned_threads() <= Lane::most_abandoned);
    if (lane.abandoned_threads() == Lane::most_abandoned) CHECK_FALSE(lane.submit(job({}, count)));
    stuck[0]->release();
    while (lane.abandoned_threads() == Lane::most_abandoned) std::this_thread::yield();
    bool finished = false;
    CHECK(lane.submit(job({}, [&](Outcome outcome) { finished = outcome == Outcome::finished; })));
    loop.run();
    CHECK(finished);
  }

  TEST_CASE("a lane that goes with its loop tells of every job that is outstanding") {
    std::vector<Outcome> told;
    auto stuck = std::make_unique<Stuck>();
    {
      Loop loop;
      Lane& lane = loop.core().lanes.of("device", 10ms);
      CHECK(lane.submit(job(stuck->work(), [&](Outcome outcome) { told.push_back(outcome); })));
      for (int i = 0; i < 3; ++i) {
        CHECK(lane.submit(job([] {},
                              [&](Outcome outcome) {
                                told.push_back(outcome);
                                loop.core().lanes.of("another", 10ms);  // asked for while the lanes go
                              })));
      }
    }
    CHECK(told == std::vector<Outcome>(4, Outcome::cancelled));
  }

  TEST_CASE("a lane that goes waits for the running job and tells that it finished") {
    std::vector<Outcome> told;
    {
      Stuck stuck;
      Stuck begun;
      Loop loop;  // goes first
      Lane& lane = loop.core().lanes.of("device", 10s);
      CHECK(lane.submit(job(
          [fd = begun.fds[1], work = stuck.work()] {
            CHECK(::write(fd, "x", 1) == 1);
            work();
          },
          [&](Outcome outcome) { told.push_back(outcome); })));
      char byte;
      CHECK(::read(begun.fds[0], &byte, 1) == 1);  // it runs
      stuck.release();
    }
    CHECK(told == std::vector<Outcome>{Outcome::finished});
  }

  TEST_CASE("a lane of one's own, such as that of a recording, is waited for longer than one of a device") {
    std::vector<Outcome> told;
    Stuck slow, hung;
    std::thread release;
    {
      Loop loop;
      const auto note = [&](Outcome outcome) { told.push_back(outcome); };
      Lane own(loop.core(), "recording", 1h);
      CHECK(own.submit(job(slow.work(), note)));
      CHECK(loop.core().lanes.of("device", 1h).submit(job(hung.work(), note)));
      for (int i = 0; i < 5000 && slow.begun() + hung.begun() < 2; ++i) loop.run_for(1ms);
      REQUIRE(slow.begun() + hung.begun() == 2);
      release = std::thread([&] {
        std::this_thread::sleep_for(2500ms);  // longer than a device is waited for
        slow.release();
      });
    }
    CHECK(told == std::vector<Outcome>{Outcome::finished, Outcome::cancelled});
    release.join();
  }

  TEST_CASE("a job that is told of may submit the next, for ever and ever") {
    Loop loop;
    Lane& lane = loop.core().lanes.of("device", 10s);
    int rounds = 0;
    const auto self = std::make_shared<Job>();
    self->told = [&, raw = std::weak_ptr<Job>(self)](Outcome) {
      if (++rounds < 1000) CHECK(lane.submit(raw.lock()));
    };
    CHECK(lane.submit(self));
    loop.run();
    CHECK(rounds == 1000);
  }

  TEST_CASE("on a manual loop jobs run at once and are told of after the scripted time, one after the other") {
    Loop loop(Loop::Manual{});
    loop.script_lane_duration(10ms);
    Lane& lane = loop.core().lanes.of("device", 1s);
    std::vector<Duration> told;
    int ran = 0;
    const auto note = [&](Outcome outcome) {
      CHECK(outcome == Outcome::finished);
      told.push_back(loop.now().time_since_epoch());
    };
    CHECK(lane.submit(job([&] { ++ran; }, note)));
    CHECK(lane.submit(job([&] { ++ran; }, note)));
    CHECK(ran == 2);
    CHECK(told.empty());
    loop.run();
    CHECK(told == std::vector<Duration>{10ms, 20ms});
    loop.script_lane_duration(1h);
    bool given_up = false;
    CHECK(lane.submit(job({}, [&](Outcome outcome) { given_up = outcome == Outcome::given_up; })));
    loop.run();
    CHECK(given_up);
    CHECK(loop.now().time_since_epoch() == 1020ms);
    std::vector<Outcome> at_end;
    {
      Loop short_lived(Loop::Manual{});
      short_lived.script_lane_duration(10ms);
      CHECK(short_lived.core().lanes.of("x", 1s).submit(job({}, [&](Outcome outcome) { at_end.push_back(outcome); })));
    }
    CHECK(at_end.size() == 1);
  }
}
