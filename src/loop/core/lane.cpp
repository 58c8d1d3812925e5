#include "rtdata/loop/lane.hpp"

#include <algorithm>
#include <chrono>
#include <mutex>
#include <vector>

#include "loop/core/lane_thread.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/core/virtual_threads.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata::detail {
namespace {

constexpr Duration longest_wait = std::chrono::hours{24 * 365};  // the library adds it to the time of now

}  // namespace

bool LaneJob::begin() noexcept {
  int expected = queued;
  began_.store(std::chrono::steady_clock::now().time_since_epoch().count(), std::memory_order_relaxed);
  return state_.compare_exchange_strong(expected, running, std::memory_order_acq_rel);
}

bool LaneJob::end() noexcept {
  int expected = running;
  return state_.compare_exchange_strong(expected, finished, std::memory_order_acq_rel);
}

LaneJob::State LaneJob::take_away() noexcept {
  int was = state_.load(std::memory_order_acquire);
  while ((was == queued || was == running) &&
         !state_.compare_exchange_weak(was, taken_away, std::memory_order_acq_rel)) {
  }
  return static_cast<State>(was);
}

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
    if (!has_run) lane.run_here(*lane.outstanding_.front(), lane.loop_.now());
    if (!completions.empty()) {
      due = completions.front().at;
      lane.loop_.deadlines.insert(*this);
    }
    lane.finish(0, outcome);
  }
  Lane& lane;
  std::vector<Completion> completions;  // of the outstanding jobs, in order
};

Lane::Lane(LoopCore& loop, std::string name, Duration give_up_after, std::shared_ptr<LaneThread> thread)
    : loop_(loop),
      name_(std::move(name)),
      give_up_after_(give_up_after),
      is_shared_(thread != nullptr),
      thread_(thread != nullptr ? std::move(thread) : std::make_shared<LaneThread>(2 * most_handed_over)),
      listener_(std::make_shared<LaneListener>()),
      shortest_(give_up_after),
      watchdog_(std::make_unique<Watchdog>(*this)),
      delayed_(std::make_unique<Delayed>(*this)) {
  if (!loop_.is_manual()) listener_->loop_wake = &loop_.uv.wake();
  make_room(most_handed_over);
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
  if (!loop_.is_manual() && !is_left_behind_) {
    for (const auto& job : outstanding_) {  // those that wait shall not begin
      int expected = LaneJob::queued;
      job->state_.compare_exchange_strong(expected, LaneJob::taken_away, std::memory_order_acq_rel);
    }
    for (const auto& job : outstanding_) {
      if (job->state_.load(std::memory_order_acquire) != LaneJob::running) continue;
      {
        std::unique_lock lock(listener_->mutex);
        listener_->job_ended.wait_for(lock, std::min(job->limit_, longest_wait),
                                      [&] { return job->state_.load(std::memory_order_acquire) != LaneJob::running; });
      }
      if (job->take_away() == LaneJob::running) thread_->leave_behind();
    }
  }
  listener_->stop_listening();
  thread_ = nullptr;
  const auto unfinished = std::move(outstanding_);
  outstanding_.clear();
  for (const auto& job : unfinished) {
    loop_.unref();
    const bool is_finished = job->state_.load(std::memory_order_acquire) == LaneJob::finished;
    loop_.call_own("lane", [&] { job->done(is_finished ? LaneJob::Outcome::finished : LaneJob::Outcome::cancelled); });
  }
}

std::size_t Lane::left_behind() const noexcept { return thread_->left_behind(); }

bool Lane::is_stuck() const noexcept { return !thread_->has_thread() && left_behind() >= most_left_behind; }

bool Lane::lacks_thread() const noexcept { return !loop_.is_manual() && !thread_->has_thread() && !is_stuck(); }

bool Lane::start_thread() noexcept { return thread_->start(&loop_.runtime, loop_.lanes.processors, most_left_behind); }

void Lane::make_room(std::size_t jobs) {
  outstanding_.reserve(jobs);
  if (loop_.is_manual()) delayed_->completions.reserve(jobs);
}

Duration Lane::run_here(LaneJob& job, MonotonicTime now) noexcept {
  const LoopCore::OffLimits on_a_lane(loop_);
  const LaneClock clock(now);
  job.run();
  return clock.spent();
}

void Lane::submit_in_virtual_time(std::shared_ptr<LaneJob> job) {
  const bool runs_later = !is_shared_ && loop_.virtual_threads()->choose();  // those of several loops keep their order
  const MonotonicTime from = std::max(thread_->free_from, loop_.now());
  Duration takes = loop_.lanes.scripted_duration;
  if (!runs_later) takes = later(MonotonicTime{takes}, run_here(*job, from)).time_since_epoch();
  const Duration limit = job->limit_;
  outstanding_.push_back(std::move(job));
  loop_.ref();
  auto outcome = LaneJob::Outcome::given_up;
  if (takes > limit) {
    takes = limit;
  } else {
    outcome = LaneJob::Outcome::finished;
    takes = std::min(takes + loop_.virtual_threads()->choose_delay(), limit);
  }
  thread_->free_from = later(from, takes);
  delayed_->completions.push_back({thread_->free_from, outcome, !runs_later});
  if (delayed_->is_listed()) return;
  delayed_->due = delayed_->completions.front().at;
  loop_.deadlines.insert(*delayed_);
}

bool Lane::submit(std::shared_ptr<LaneJob> job, Duration give_up_after) {
  if (outstanding_.size() == most_outstanding) return false;
  if (outstanding_.size() == outstanding_.capacity()) make_room(2 * outstanding_.size());
  job->limit_ = give_up_after;
  if (loop_.is_manual()) {
    submit_in_virtual_time(std::move(job));
    return true;
  }
  if (is_left_behind_ || !start_thread()) return false;
  job->state_.store(LaneJob::queued, std::memory_order_relaxed);
  loop_.ref();
  outstanding_.push_back(std::move(job));
  hand_over();
  shortest_ = std::min(shortest_, give_up_after);
  watch_until(later(loop_.now(), shortest_));
  return true;
}

void Lane::watch_until(MonotonicTime due) {
  if (watchdog_->is_listed()) {
    if (watchdog_->due <= due) return;
    loop_.deadlines.remove(*watchdog_);
  }
  watchdog_->due = due;
  loop_.deadlines.insert(*watchdog_);
}

void Lane::hand_over() {
  for (; handed_over_ < std::min(outstanding_.size(), most_handed_over); ++handed_over_)
    if (!thread_->push(outstanding_[handed_over_], listener_)) return;  // the watchdog tries again
}

void Lane::finish(std::size_t index, LaneJob::Outcome outcome) {
  const std::shared_ptr<LaneJob> job = std::move(outstanding_[index]);
  outstanding_.erase(outstanding_.begin() + static_cast<std::ptrdiff_t>(index));
  if (index < handed_over_) --handed_over_;
  if (!loop_.is_manual()) hand_over();
  if (outcome == LaneJob::Outcome::finished) job->state_.store(LaneJob::idle, std::memory_order_relaxed);
  loop_.unref();
  if (outcome != LaneJob::Outcome::finished || health_ != Health::ok) [[unlikely]]
    look_at_health(outcome, job->limit_);
  loop_.call_own("lane", [&] { job->done(outcome); });
}

void Lane::look_at_health(LaneJob::Outcome outcome, Duration limit) {
  Health now = health_;
  if (outcome == LaneJob::Outcome::given_up) now = is_stuck() ? Health::faulted : Health::degraded;
  if (outcome == LaneJob::Outcome::finished) now = left_behind() > 0 ? Health::degraded : Health::ok;
  if (now == health_) return;
  health_ = now;
  loop_.call_own("lane", [&] {
    std::string reason;
    if (now != Health::ok) reason = "a job outlived its limit of " + to_string(limit) + " and was given up";
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
  if (!is_left_behind_ && thread_->has_thread()) {
    const std::shared_ptr<LaneJob> first = outstanding_.front();
    std::unique_lock lock(listener_->mutex);
    listener_->job_ended.wait_for(lock, std::min(at_most, longest_wait),
                                  [&] { return first->state_.load(std::memory_order_acquire) == LaneJob::finished; });
  }
  collect();
}

void Lane::leave_behind() noexcept {
  if (std::exchange(is_left_behind_, true)) return;
  for (const auto& job : outstanding_)
    if (job->take_away() == LaneJob::running) thread_->leave_behind();
  listener_->stop_listening();
}

void Lane::check_limit() {
  const auto is_alive = is_alive_;
  loop_.deadlines.remove(*watchdog_);
  collect();
  if (!*is_alive || outstanding_.empty() || is_left_behind_) return;
  if (!start_thread()) {  // another loop's job hangs in the last thread that there may be
    give_up();
    if (!*is_alive || outstanding_.empty()) return;
  }
  hand_over();
  const LaneJob& first = *outstanding_.front();
  MonotonicTime due = later(loop_.now(), shortest_);
  if (first.state_.load(std::memory_order_acquire) == LaneJob::running) {
    const MonotonicTime end = later(MonotonicTime{Duration{first.began_.load(std::memory_order_relaxed)}},
                                    first.limit_);
    if (end <= loop_.now()) {
      give_up();
      if (!*is_alive) return;
    } else {
      due = std::min(due, end);
    }
  }
  if (!outstanding_.empty()) watch_until(due);
}

void Lane::give_up() {
  const auto is_alive = is_alive_;
  if (is_left_behind_) return;
  collect();
  if (!*is_alive || outstanding_.empty()) return;
  const auto was = outstanding_.front()->take_away();
  if (was == LaneJob::finished) return collect();
  if (was == LaneJob::running) thread_->leave_behind();
  if (start_thread()) return finish(0, LaneJob::Outcome::given_up);
  for (std::size_t left = outstanding_.size(); left > 0 && *is_alive; --left) {
    outstanding_.front()->take_away();
    finish(0, LaneJob::Outcome::given_up);
  }
}

}  // namespace rtdata::detail
