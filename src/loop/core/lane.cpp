#include "rtdata/loop/lane.hpp"

#include <semaphore.h>

#include <algorithm>
#include <array>
#include <condition_variable>
#include <csignal>
#include <mutex>
#include <thread>
#include <vector>

#include "loop/core/loop_core.hpp"
#include "loop/core/virtual_threads.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/support/priority_mutex.hpp"
#include "loop/support/signals_blocked.hpp"

namespace rtdata::detail {
namespace {

constexpr Duration longest_wait = std::chrono::hours{24 * 365};  // the library adds it to the time of now

}  // namespace

/// One thread and the jobs on their way to it. Shared with the thread, which may be left behind.
struct Lane::Worker {
  std::array<std::shared_ptr<LaneJob>, ring_size> ring;  // one producer (the loop), one consumer (the thread)
  std::atomic<std::size_t> head{0};
  std::atomic<std::size_t> tail{0};
  sem_t wake;  // not std::counting_semaphore, which may lose a wake-up in the libraries of our compilers
  std::atomic<bool> quit{false};
  std::atomic<bool> ended{false};
  PriorityMutex mutex;
  std::condition_variable_any ended_signal;
  std::condition_variable_any job_finished;
  Wake* loop_wake = nullptr;  // guarded by the mutex; null once the lane does not listen any more

  const void* const runtime;  // whose lane it is; may be gone

  explicit Worker(const void* runtime_) : runtime(runtime_) { ::sem_init(&wake, 0, 0); }
  ~Worker() { ::sem_destroy(&wake); }

  void push(std::shared_ptr<LaneJob> job) {
    const std::size_t at = head.load(std::memory_order_relaxed);
    ring[at % ring_size] = std::move(job);
    head.store(at + 1, std::memory_order_release);
    ::sem_post(&wake);
  }

  void end() noexcept {
    quit.store(true, std::memory_order_release);
    ::sem_post(&wake);
  }
  void stop_listening() noexcept {
    const std::lock_guard lock(mutex);
    loop_wake = nullptr;
  }

  void run() {
    LoopCore::lane_of() = runtime;
    for (;;) {
      while (::sem_wait(&wake) != 0) {
      }
      if (quit.load(std::memory_order_acquire)) break;
      const std::size_t at = tail.load(std::memory_order_relaxed);
      if (at == head.load(std::memory_order_acquire)) continue;
      const std::shared_ptr<LaneJob> job = std::move(ring[at % ring_size]);
      tail.store(at + 1, std::memory_order_release);
      int expected = LaneJob::queued;
      // Another worker may have taken it, when this one was given up while it waited.
      if (!job->state_.compare_exchange_strong(expected, LaneJob::running)) continue;
      job->began_.store(std::chrono::steady_clock::now().time_since_epoch().count(), std::memory_order_relaxed);
      job->run();
      job->state_.store(LaneJob::finished, std::memory_order_release);
      const std::lock_guard lock(mutex);
      if (loop_wake != nullptr) loop_wake->send();
      job_finished.notify_all();
    }
    const std::lock_guard lock(mutex);
    ended.store(true, std::memory_order_release);
    ended_signal.notify_all();
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
  struct Completion {
    MonotonicTime at;
    LaneJob::Outcome outcome;
    bool has_run;
  };
  explicit Delayed(Lane& lane_) : lane(lane_) {}
  void fire(MonotonicTime) override {
    lane.loop_.deadlines.remove(*this);
    const auto [at, outcome, has_run] = completions.front();
    completions.erase(completions.begin());
    if (!has_run) lane.run_here(*lane.outstanding_.front());
    if (!completions.empty()) {
      due = completions.front().at;
      lane.loop_.deadlines.insert(*this);
    }
    lane.finish(0, outcome);
  }
  Lane& lane;
  std::vector<Completion> completions;  // of the outstanding jobs, in order
};

Lane::Lane(LoopCore& loop, std::string name, Duration give_up_after)
    : loop_(loop),
      name_(std::move(name)),
      give_up_after_(give_up_after),
      watchdog_(std::make_unique<Watchdog>(*this)),
      delayed_(std::make_unique<Delayed>(*this)) {
  needs_thread_ = !loop_.is_manual();
  make_room(ring_size);
  behind_.reserve(most_left_behind);
  for (int i = 0; i < 2; ++i) loop_.deadlines.reserve_one();
  try {
    loop_.lanes.add(*this);
  } catch (...) {
    for (int i = 0; i < 2; ++i) loop_.deadlines.release_one();
    throw;
  }
}

Lane::~Lane() {
  *is_alive_ = false;
  loop_.lanes.remove(*this);
  loop_.deadlines.remove(*watchdog_);
  loop_.deadlines.remove(*delayed_);
  for (int i = 0; i < 2; ++i) loop_.deadlines.release_one();
  if (worker_ != nullptr) {
    worker_->end();
    std::unique_lock lock(worker_->mutex);
    worker_->ended_signal.wait_for(lock, std::min(give_up_after_, longest_wait),
                                   [this] { return worker_->ended.load(std::memory_order_relaxed); });
    worker_->loop_wake = nullptr;
  }
  const auto unfinished = std::move(outstanding_);
  outstanding_.clear();
  for (const auto& job : unfinished) {
    loop_.unref();
    const bool is_finished = job->state_.load(std::memory_order_acquire) == LaneJob::finished;
    loop_.call_own("lane", [&] { job->done(is_finished ? LaneJob::Outcome::finished : LaneJob::Outcome::cancelled); });
  }
}

std::size_t Lane::left_behind() const noexcept {
  std::erase_if(behind_, [](const auto& worker) { return worker->ended.load(std::memory_order_acquire); });
  return behind_.size();
}

bool Lane::start_worker() noexcept {
  if (left_behind() >= most_left_behind) return false;
  const SignalsBlocked for_the_worker;
  try {
    worker_ = std::make_shared<Worker>(&loop_.runtime);
    worker_->loop_wake = &loop_.uv.wake();
    // Detached, since it may have to be left behind; `ended` stands for joining.
    std::thread([worker = worker_, cpus = loop_.lanes.processors] {
      if (cpus) ::sched_setaffinity(0, sizeof *cpus, &*cpus);
      worker->run();
    }).detach();
  } catch (...) {
    worker_ = nullptr;
  }
  return worker_ != nullptr;
}

void Lane::make_room(std::size_t jobs) {
  outstanding_.reserve(jobs);
  if (loop_.is_manual()) delayed_->completions.reserve(jobs);
}

void Lane::run_here(LaneJob& job) noexcept {
  const LoopCore::OffLimits on_a_lane(loop_);
  job.run();
}

bool Lane::submit(std::shared_ptr<LaneJob> job) {
  if (outstanding_.size() == most_outstanding) return false;
  if (outstanding_.size() == outstanding_.capacity()) make_room(2 * outstanding_.size());
  if (loop_.is_manual()) {
    const bool runs_later = loop_.virtual_threads()->choose();
    if (!runs_later) run_here(*job);
    outstanding_.push_back(std::move(job));
    loop_.ref();
    const MonotonicTime from = delayed_->completions.empty() ? loop_.now()
                                                             : std::max(delayed_->completions.back().at, loop_.now());
    if (loop_.lanes.scripted_duration > give_up_after_) {
      delayed_->completions.push_back({later(from, give_up_after_), LaneJob::Outcome::given_up, !runs_later});
    } else {
      const Duration takes = std::min(loop_.lanes.scripted_duration + loop_.virtual_threads()->choose_delay(),
                                      give_up_after_);
      delayed_->completions.push_back({later(from, takes), LaneJob::Outcome::finished, !runs_later});
    }
    if (!delayed_->is_listed()) {
      delayed_->due = delayed_->completions.front().at;
      loop_.deadlines.insert(*delayed_);
    }
    return true;
  }
  if (worker_ == nullptr && !start_worker()) return false;
  job->state_.store(LaneJob::queued, std::memory_order_relaxed);
  loop_.ref();
  outstanding_.push_back(std::move(job));
  hand_over();
  if (!watchdog_->is_listed()) {
    watchdog_->due = later(loop_.now(), give_up_after_);
    loop_.deadlines.insert(*watchdog_);
  }
  return true;
}

void Lane::hand_over() {
  for (; worker_ != nullptr && handed_over_ < std::min(outstanding_.size(), ring_size); ++handed_over_)
    worker_->push(outstanding_[handed_over_]);
}

void Lane::finish(std::size_t index, LaneJob::Outcome outcome) {
  const std::shared_ptr<LaneJob> job = std::move(outstanding_[index]);
  outstanding_.erase(outstanding_.begin() + static_cast<std::ptrdiff_t>(index));
  if (index < handed_over_) --handed_over_;
  hand_over();
  if (outcome == LaneJob::Outcome::finished) job->state_.store(LaneJob::idle, std::memory_order_relaxed);
  loop_.unref();
  if (outcome != LaneJob::Outcome::finished || health_ != Health::ok) [[unlikely]]
    look_at_health(outcome);
  loop_.call_own("lane", [&] { job->done(outcome); });
}

void Lane::look_at_health(LaneJob::Outcome outcome) {
  Health now = health_;
  if (outcome == LaneJob::Outcome::given_up) now = is_stuck() ? Health::faulted : Health::degraded;
  if (outcome == LaneJob::Outcome::finished) now = left_behind() > 0 ? Health::degraded : Health::ok;
  if (now == health_) return;
  health_ = now;
  loop_.call_own("lane", [&] {
    std::string reason;
    if (now != Health::ok) reason = "a job outlived its limit of " + to_string(give_up_after_) + " and was given up";
    loop_.runtime.health_changed("lane", name_, now, reason);
  });
}

void Lane::collect() {
  const auto is_alive = is_alive_;
  while (*is_alive && !outstanding_.empty() && !loop_.is_manual() &&
         outstanding_.front()->state_.load(std::memory_order_acquire) == LaneJob::finished) {
    finish(0, LaneJob::Outcome::finished);
  }
}

void Lane::wait(Duration at_most) {
  if (outstanding_.empty()) return;
  if (loop_.is_manual()) {
    const Duration left = delayed_->completions.front().at - loop_.now();
    if (left.count() > 0) loop_.manual_clock()->pass(std::min(left, at_most));
    if (left <= at_most) delayed_->fire(loop_.now());
    return;
  }
  if (worker_ != nullptr) {
    const std::shared_ptr<LaneJob> first = outstanding_.front();
    std::unique_lock lock(worker_->mutex);
    worker_->job_finished.wait_for(lock, std::min(at_most, longest_wait),
                                   [&] { return first->state_.load(std::memory_order_acquire) == LaneJob::finished; });
  }
  collect();
}

void Lane::leave_behind() noexcept {
  if (worker_ == nullptr) return;
  worker_->end();
  worker_->stop_listening();
  worker_ = nullptr;
}

void Lane::check_limit() {
  const auto is_alive = is_alive_;
  loop_.deadlines.remove(*watchdog_);
  collect();
  if (!*is_alive || outstanding_.empty()) return;
  const LaneJob& first = *outstanding_.front();
  MonotonicTime due = later(loop_.now(), give_up_after_);
  if (first.state_.load(std::memory_order_acquire) == LaneJob::running) {
    due = later(MonotonicTime{Duration{first.began_.load(std::memory_order_relaxed)}}, give_up_after_);
    if (due <= loop_.now()) {
      give_up();
      if (!*is_alive) return;
      due = later(loop_.now(), give_up_after_);
    }
  }
  if (outstanding_.empty() || watchdog_->is_listed()) return;
  watchdog_->due = due;
  loop_.deadlines.insert(*watchdog_);
}

void Lane::give_up() {
  const auto is_alive = is_alive_;
  if (worker_ == nullptr) return;
  collect();
  if (!*is_alive || worker_ == nullptr || outstanding_.empty()) return;
  worker_->end();
  worker_->stop_listening();
  behind_.push_back(std::exchange(worker_, nullptr));
  handed_over_ = 1;  // that which is given up; the fresh thread gets the others
  if (start_worker()) {
    hand_over();
    finish(0, LaneJob::Outcome::given_up);
  } else {
    for (std::size_t left = outstanding_.size(); left > 0 && *is_alive; --left) finish(0, LaneJob::Outcome::given_up);
  }
}

}  // namespace rtdata::detail
