#include "rtdata/detail/loop/lane.hpp"

#include <algorithm>
#include <chrono>
#include <utility>
#include <vector>

#include "loop/core/lane_thread.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/core/virtual_threads.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata::detail {
namespace {

// A device's job that runs when its lane ends is waited for no longer; what is stored, or set, as long as it may take.
constexpr Duration longest_farewell = std::chrono::seconds{2};
constexpr Duration longest_wait = std::chrono::hours{24 * 365};  // the standard library adds it to the present time

}  // namespace

bool LaneJob::begin(MonotonicTime now) noexcept {
  int expected = queued;
  began_.store(now.time_since_epoch().count(), std::memory_order_relaxed);
  return state_.compare_exchange_strong(expected, running, std::memory_order_acq_rel);
}

bool LaneJob::end() noexcept {
  int expected = running;
  return state_.compare_exchange_strong(expected, finished);  // before `is_waited_for` of its listener is read
}

LaneJob::State LaneJob::withdraw() noexcept {
  int was = state_.load(std::memory_order_acquire);
  while ((was == queued || was == running) &&
         !state_.compare_exchange_weak(was, taken_away, std::memory_order_acq_rel)) {
  }
  return static_cast<State>(was);
}

/// Checks the limit while jobs are outstanding.
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
    if (!has_run) lane.run_here(*lane.first_, lane.loop_.now());
    if (!completions.empty()) {
      due = completions.front().at;
      lane.loop_.deadlines.insert(*this);
    }
    lane.finish(outcome);
  }
  Lane& lane;
  std::vector<Completion> completions;  // of the outstanding jobs, in order
};

Lane::Lane(LoopCore& loop, std::string name, Duration give_up_after, std::shared_ptr<LaneThread> thread)
    : loop_(loop),
      name_(std::move(name)),
      give_up_after_(give_up_after),
      is_shared_(thread != nullptr && !thread->is_pooled()),
      is_pooled_(thread != nullptr && thread->is_pooled()),
      thread_(thread != nullptr ? std::move(thread) : std::make_shared<LaneThread>()),
      shortest_(give_up_after),
      watchdog_(std::make_unique<Watchdog>(*this)),
      delayed_(std::make_unique<Delayed>(*this)) {
  for (int i = 0; i < 2; ++i) loop_.deadlines.reserve_one();
  try {
    loop_.lanes.add();
  } catch (...) {
    for (int i = 0; i < 2; ++i) loop_.deadlines.release_one();
    throw;
  }
}

Lane::~Lane() {
  *is_alive_ = false;
  loop_.deadlines.remove(*watchdog_);
  loop_.deadlines.remove(*delayed_);
  for (int i = 0; i < 2; ++i) loop_.deadlines.release_one();
  if (!loop_.is_manual() && !is_thread_abandoned_) {
    for (LaneJob* job = first_.get(); job != nullptr; job = job->next_outstanding_.get()) {  // must not start
      int expected = LaneJob::queued;
      job->state_.compare_exchange_strong(expected, LaneJob::taken_away, std::memory_order_acq_rel);
    }
    for (LaneJob* job = first_.get(); job != nullptr; job = job->next_outstanding_.get()) {
      if (job->state_.load(std::memory_order_acquire) != LaneJob::running) continue;
      // Counted from its start, so that waits for several hanging devices overlap.
      const MonotonicTime end = later(MonotonicTime{Duration{job->began_.load(std::memory_order_relaxed)}},
                                      std::min(job->limit_, longest_wait));
      const Duration most = std::clamp(span_between(loop_.now(), end), Duration{0},
                                       is_shared_ || is_pooled_ ? longest_farewell : longest_wait);
      loop_.lanes.wait(most, [&] { return job->state_.load() != LaneJob::running; });
      if (job->withdraw() == LaneJob::running) thread_->abandon_thread();
    }
  }
  thread_ = nullptr;
  while (first_ != nullptr) {
    const std::shared_ptr<LaneJob> job = remove_first();
    loop_.unref();
    const bool is_finished = job->state_.load(std::memory_order_acquire) == LaneJob::finished;
    loop_.call_own("lane", [&] { job->done(is_finished ? LaneJob::Outcome::finished : LaneJob::Outcome::cancelled); });
  }
  loop_.lanes.remove(*this);
}

std::size_t Lane::abandoned_threads() const noexcept { return thread_->abandoned_threads(); }

bool Lane::is_stuck() const noexcept { return thread_->is_stuck(); }

bool Lane::lacks_thread() const noexcept { return !loop_.is_manual() && !thread_->has_thread() && !is_stuck(); }

bool Lane::start_thread() noexcept { return thread_->start(&loop_.runtime, loop_.lanes.processors); }

void Lane::add(std::shared_ptr<LaneJob> job) noexcept {
  LaneJob* const added = job.get();
  (first_ == nullptr ? first_ : last_->next_outstanding_) = std::move(job);
  last_ = added;
  loop_.ref();
  loop_.lanes.count(*this, 1);
}

std::shared_ptr<LaneJob> Lane::remove_first() noexcept {
  std::shared_ptr<LaneJob> job = std::move(first_);
  first_ = std::move(job->next_outstanding_);
  loop_.lanes.count(*this, -1);
  return job;
}

Duration Lane::run_here(LaneJob& job, MonotonicTime now) noexcept {
  const LoopCore::OffLimits on_a_lane(loop_);
  const LaneClock clock(now);
  job.run();
  return clock.spent();
}

void Lane::submit_in_virtual_time(std::shared_ptr<LaneJob> job) {
  auto& completions = delayed_->completions;
  if (completions.size() == completions.capacity()) completions.reserve(2 * completions.size() + 1);
  const bool runs_later = !is_shared_ && loop_.virtual_threads()->choose();  // jobs of several loops keep their order
  const MonotonicTime from = std::max(thread_->free_from, loop_.now());
  Duration takes = loop_.lanes.scripted_duration;
  if (!runs_later) takes = later(MonotonicTime{takes}, run_here(*job, from)).time_since_epoch();
  const Duration limit = job->limit_;
  add(std::move(job));
  auto outcome = LaneJob::Outcome::given_up;
  if (takes > limit) {
    takes = limit;
  } else {
    outcome = LaneJob::Outcome::finished;
    takes = std::min(takes + loop_.virtual_threads()->choose_delay(), limit);
  }
  thread_->free_from = later(from, takes);
  completions.push_back({thread_->free_from, outcome, !runs_later});
  if (delayed_->is_listed()) return;
  delayed_->due = completions.front().at;
  loop_.deadlines.insert(*delayed_);
}

bool Lane::submit(std::shared_ptr<LaneJob> job, Duration give_up_after) {
  job->limit_ = give_up_after;
  if (loop_.is_manual()) {
    submit_in_virtual_time(std::move(job));
    return true;
  }
  if (is_thread_abandoned_ || !start_thread()) return false;
  job->began_.store(loop_.now().time_since_epoch().count(), std::memory_order_relaxed);
  job->state_.store(LaneJob::queued, std::memory_order_relaxed);
  add(job);
  thread_->push(std::move(job), loop_.lanes.shared_listener());
  loop_.lanes.hand_over(thread_->pool());
  if (watchdog_->is_listed() && give_up_after >= shortest_) return true;  // the watchdog will check in time
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

void Lane::finish(LaneJob::Outcome outcome) {
  const std::shared_ptr<LaneJob> job = remove_first();
  if (outcome == LaneJob::Outcome::finished) job->state_.store(LaneJob::idle, std::memory_order_relaxed);
  loop_.unref();
  if (outcome != LaneJob::Outcome::finished || health_ != Health::ok) [[unlikely]]
    look_at_health(outcome, job->limit_);
  loop_.call_own("lane", [&] { job->done(outcome); });
}

void Lane::look_at_health(LaneJob::Outcome outcome, Duration limit) {
  Health now = health_;
  if (outcome == LaneJob::Outcome::given_up) now = is_stuck() ? Health::faulted : Health::degraded;
  if (outcome == LaneJob::Outcome::finished) now = abandoned_threads() > 0 ? Health::degraded : Health::ok;
  set_health(now, "a job took longer than its limit of ", limit, " and was given up");
}

void Lane::set_health(Health now, const char* why, Duration limit, const char* what) {
  if (std::exchange(health_, now) == now) return;
  loop_.call_own("lane", [&] {
    loop_.runtime.health_changed("lane", name_, now, now == Health::ok ? "" : why + to_string(limit) + what);
  });
}

void Lane::collect() {
  const auto is_alive = is_alive_;
  while (*is_alive && first_ != nullptr && !loop_.is_manual() &&
         first_->state_.load(std::memory_order_acquire) == LaneJob::finished) {
    finish(LaneJob::Outcome::finished);
  }
}

void Lane::wait(Duration at_most) {
  if (first_ == nullptr) return;
  if (loop_.is_manual()) {
    const Duration left = delayed_->completions.front().at - loop_.now();
    if (left.count() > 0) loop_.manual_clock()->pass(std::min(left, at_most));
    if (left <= at_most) delayed_->fire(loop_.now());
    return;
  }
  loop_.lanes.wake_threads();
  if (!is_thread_abandoned_ && thread_->has_thread()) {
    const std::shared_ptr<LaneJob> first = first_;
    loop_.lanes.wait(std::min(at_most, longest_wait), [&] { return first->state_.load() == LaneJob::finished; });
  }
  collect();
}

void Lane::abandon_thread() noexcept {
  if (std::exchange(is_thread_abandoned_, true)) return;
  for (LaneJob* job = first_.get(); job != nullptr; job = job->next_outstanding_.get())
    if (job->withdraw() == LaneJob::running) thread_->abandon_thread();
}

void Lane::check_limit() {
  const auto is_alive = is_alive_;
  loop_.deadlines.remove(*watchdog_);
  collect();
  if (!*is_alive || first_ == nullptr || is_thread_abandoned_) return;
  if (!start_thread()) {  // another loop's job hangs in the last allowed thread
    give_up();
    if (!*is_alive || first_ == nullptr) return;
  }
  thread_->pool()->wake();
  MonotonicTime due = later(loop_.now(), shortest_);
  const int state = first_->state_.load(std::memory_order_acquire);
  const Duration limit = first_->limit_;
  const MonotonicTime end = later(MonotonicTime{Duration{first_->began_.load(std::memory_order_relaxed)}}, limit);
  if (state == LaneJob::running && end > loop_.now()) {
    due = std::min(due, end);
  } else if (state == LaneJob::running) {
    give_up();
    if (!*is_alive) return;
  } else if (is_pooled_ && end <= loop_.now() && thread_->pool()->is_full()) {
    set_health(Health::degraded, "a job waits for longer than its limit of ", limit,
               ": all threads for slow devices are busy");
    if (!*is_alive) return;
  }
  if (first_ != nullptr) watch_until(due);
}

void Lane::give_up() {
  const auto is_alive = is_alive_;
  if (is_thread_abandoned_) return;
  collect();
  if (!*is_alive || first_ == nullptr) return;
  const auto was = first_->withdraw();
  if (was == LaneJob::finished) return collect();
  if (was == LaneJob::running) thread_->abandon_thread();
  if (start_thread()) {
    thread_->pool()->wake();
    return finish(LaneJob::Outcome::given_up);
  }
  while (*is_alive && first_ != nullptr) {
    if (first_->withdraw() == LaneJob::running) thread_->abandon_thread();
    finish(LaneJob::Outcome::given_up);
  }
}

}  // namespace rtdata::detail
