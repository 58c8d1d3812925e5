#include "rtdata/loop/lane.hpp"

#include <pthread.h>
#include <uv.h>

#include <algorithm>
#include <array>
#include <csignal>
#include <deque>
#include <mutex>
#include <semaphore>
#include <thread>
#include <vector>

#include "loop/loop_core.hpp"
#include "loop/runtime_core.hpp"

namespace rtdata::detail {

/// One thread and the jobs on their way to it. Shared with the thread, which may be left behind.
struct Lane::Worker {
  std::array<std::shared_ptr<LaneJob>, capacity> ring;  // one producer (the loop), one consumer (the thread)
  std::atomic<std::size_t> head{0};
  std::atomic<std::size_t> tail{0};
  std::counting_semaphore<> wake{0};
  std::atomic<bool> quit{false};
  std::atomic<bool> ended{false};
  std::binary_semaphore ended_signal{0};
  std::mutex loop_mutex;
  uv_async_t* loop_wake = nullptr;  // null once the lane is gone

  void push(std::shared_ptr<LaneJob> job) {
    const std::size_t at = head.load(std::memory_order_relaxed);
    ring[at % capacity] = std::move(job);
    head.store(at + 1, std::memory_order_release);
    wake.release();
  }

  void run() {
    for (;;) {
      wake.acquire();
      if (quit.load(std::memory_order_acquire)) break;
      const std::size_t at = tail.load(std::memory_order_relaxed);
      if (at == head.load(std::memory_order_acquire)) continue;
      const std::shared_ptr<LaneJob> job = std::move(ring[at % capacity]);
      tail.store(at + 1, std::memory_order_release);
      int expected = LaneJob::queued;
      // Another worker may have taken it, when this one was given up while it waited.
      if (!job->state_.compare_exchange_strong(expected, LaneJob::running)) continue;
      job->began_.store(std::chrono::steady_clock::now().time_since_epoch().count(), std::memory_order_relaxed);
      job->run();
      job->state_.store(LaneJob::finished, std::memory_order_release);
      const std::lock_guard lock(loop_mutex);
      if (loop_wake != nullptr) uv_async_send(loop_wake);
    }
    ended.store(true, std::memory_order_release);
    ended_signal.release();
  }
};

/// Looks after the limit while jobs are outstanding.
struct Lane::Watchdog final : Deadline {
  explicit Watchdog(Lane& lane_) : lane(lane_) {}
  void fire(MonotonicTime) override { lane.check_limit(); }
  Lane& lane;
};

/// On a manual loop: completes the first outstanding job.
struct Lane::Delayed final : Deadline {
  explicit Delayed(Lane& lane_) : lane(lane_) {}
  void fire(MonotonicTime) override {
    lane.loop_.remove(*this);
    if (!completions.empty()) completions.pop_front();
    if (!completions.empty()) {
      due = completions.front();
      lane.loop_.insert(*this);
    }
    if (!lane.outstanding_.empty()) lane.finish(0, LaneJob::Outcome::finished);
  }
  Lane& lane;
  std::deque<MonotonicTime> completions;
};

Lane::Lane(LoopCore& loop, std::string name, Duration give_up_after)
    : loop_(loop),
      name_(std::move(name)),
      give_up_after_(give_up_after),
      watchdog_(std::make_unique<Watchdog>(*this)),
      delayed_(std::make_unique<Delayed>(*this)) {
  outstanding_.reserve(capacity);
}

Lane::~Lane() {
  loop_.remove(*watchdog_);
  loop_.remove(*delayed_);
  if (worker_ != nullptr) {
    worker_->quit.store(true, std::memory_order_release);
    worker_->wake.release();
    [[maybe_unused]] const bool in_time = worker_->ended_signal.try_acquire_for(give_up_after_);
    const std::lock_guard lock(worker_->loop_mutex);
    worker_->loop_wake = nullptr;
  }
  for (auto& job : outstanding_) {
    loop_.unhold();
    const bool is_finished = job->state_.load(std::memory_order_acquire) == LaneJob::finished;
    job->done(is_finished ? LaneJob::Outcome::finished : LaneJob::Outcome::cancelled);
  }
}

bool Lane::is_stuck() noexcept {
  // A job that was given up may have come back since, and its thread with it.
  std::erase_if(behind_, [](const auto& worker) { return worker->ended.load(std::memory_order_acquire); });
  return worker_ == nullptr && behind_.size() >= most_left_behind;
}

void Lane::start_worker() {
  worker_ = std::make_shared<Worker>();
  worker_->loop_wake = loop_.wake_handle();
  sigset_t all;
  sigset_t before;
  ::sigfillset(&all);
  ::pthread_sigmask(SIG_SETMASK, &all, &before);  // signals are the program's; a worker takes none
  try {
    // Detached, since it may have to be left behind; ended_signal stands for joining.
    std::thread([worker = worker_] { worker->run(); }).detach();
  } catch (...) {
    ::pthread_sigmask(SIG_SETMASK, &before, nullptr);
    worker_ = nullptr;
    throw;
  }
  ::pthread_sigmask(SIG_SETMASK, &before, nullptr);
}

bool Lane::submit(std::shared_ptr<LaneJob> job) {
  if (outstanding_.size() == capacity) return false;
  if (loop_.is_manual()) {
    job->run();
    outstanding_.push_back(std::move(job));
    loop_.hold();
    const MonotonicTime from = delayed_->completions.empty() ? loop_.now() : std::max(delayed_->completions.back(), loop_.now());
    delayed_->completions.push_back(from + loop_.lane_duration);
    if (!delayed_->is_listed()) {
      delayed_->due = delayed_->completions.front();
      loop_.insert(*delayed_);
    }
    return true;
  }
  if (worker_ == nullptr) {
    if (is_stuck()) return false;
    start_worker();
  }
  job->state_.store(LaneJob::queued, std::memory_order_relaxed);
  loop_.hold();
  outstanding_.push_back(job);
  worker_->push(std::move(job));
  if (!watchdog_->is_listed()) {
    watchdog_->due = loop_.now() + give_up_after_;
    loop_.insert(*watchdog_);
  }
  return true;
}

void Lane::finish(std::size_t index, LaneJob::Outcome outcome) {
  const std::shared_ptr<LaneJob> job = std::move(outstanding_[index]);
  outstanding_.erase(outstanding_.begin() + static_cast<std::ptrdiff_t>(index));
  if (outcome == LaneJob::Outcome::finished) job->state_.store(LaneJob::idle, std::memory_order_relaxed);
  loop_.unhold();
  job->done(outcome);
}

void Lane::collect() {
  while (!outstanding_.empty() && !loop_.is_manual() &&
         outstanding_.front()->state_.load(std::memory_order_acquire) == LaneJob::finished) {
    finish(0, LaneJob::Outcome::finished);
  }
}

void Lane::check_limit() {
  loop_.remove(*watchdog_);
  collect();
  if (outstanding_.empty()) return;
  const LaneJob& first = *outstanding_.front();
  MonotonicTime due = loop_.now() + give_up_after_;
  if (first.state_.load(std::memory_order_acquire) == LaneJob::running) {
    due = MonotonicTime{Duration{first.began_.load(std::memory_order_relaxed)}} + give_up_after_;
    if (due <= loop_.now()) {
      give_up();
      due = loop_.now() + give_up_after_;
    }
  }
  if (outstanding_.empty() || watchdog_->is_listed()) return;
  watchdog_->due = due;
  loop_.insert(*watchdog_);
}

void Lane::give_up() {
  if (worker_ == nullptr || outstanding_.empty()) return;
  worker_->quit.store(true, std::memory_order_release);
  worker_->wake.release();
  {
    const std::lock_guard lock(worker_->loop_mutex);
    worker_->loop_wake = nullptr;
  }
  behind_.push_back(std::move(worker_));
  worker_ = nullptr;
  if (!is_stuck()) {
    start_worker();
    for (std::size_t i = 1; i < outstanding_.size(); ++i) worker_->push(outstanding_[i]);
    finish(0, LaneJob::Outcome::given_up);
  } else {
    while (!outstanding_.empty()) finish(0, LaneJob::Outcome::given_up);
  }
}

}  // namespace rtdata::detail
