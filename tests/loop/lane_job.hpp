/// Jobs for lanes, and devices that do not answer.
#pragma once

#include <doctest/doctest.h>
#include <unistd.h>

#include <atomic>
#include <functional>
#include <memory>
#include <thread>
#include <utility>

#include "rtdata/detail/loop/lane.hpp"

namespace lane_job {

using Outcome = rtdata::detail::LaneJob::Outcome;

struct Job final : rtdata::detail::LaneJob {
  std::function<void()> work;
  std::function<void(Outcome)> told;
  std::thread::id ran_on;
  void run() noexcept override {
    ran_on = std::this_thread::get_id();
    if (work) work();
  }
  void done(Outcome outcome) override {
    if (told) told(outcome);
  }
};

inline std::shared_ptr<Job> job(std::function<void()> work, std::function<void(Outcome)> told) {
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

}  // namespace lane_job
