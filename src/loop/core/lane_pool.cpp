#include "loop/core/lane_pool.hpp"

#include <semaphore.h>

#include <algorithm>
#include <array>
#include <bit>
#include <mutex>
#include <thread>
#include <utility>

#include "loop/core/loop_core.hpp"
#include "loop/support/signals_blocked.hpp"
#include "rtdata/loop/lane.hpp"

namespace rtdata::detail {
namespace {

constexpr int most_idle = 4;  // more end when they have nothing to do, but for one that leads
constexpr Duration most_patience = 10 * LanePool::patience;  // with a thread that the processor is not given to
constexpr Duration longest_untold = std::chrono::microseconds{500};

MonotonicTime kernel_now() noexcept { return std::chrono::steady_clock::now(); }

/// Clears the lowest bit that is set, and returns which that was. -1: none is.
int take_lowest(std::atomic<unsigned>& bits) noexcept {
  unsigned was = bits.load();
  while (was != 0 && !bits.compare_exchange_weak(was, was & (was - 1))) {
  }
  return was != 0 ? std::countr_zero(was) : -1;
}

std::size_t count_of(const std::atomic<std::ptrdiff_t>& count) noexcept {
  return static_cast<std::size_t>(std::max<std::ptrdiff_t>(count.load(std::memory_order_acquire), 0));
}

}  // namespace

void LaneListener::tell() noexcept {
  const std::lock_guard lock(mutex);
  if (loop_wake != nullptr) loop_wake->send();
  if (is_waited_for.load(std::memory_order_relaxed)) job_ended.notify_all();  // set under the mutex
}

void LaneListener::stop_listening() noexcept {
  const std::lock_guard lock(mutex);
  loop_wake = nullptr;
}

void LaneJobs::push(LaneJob& job) noexcept {
  job.next_ = nullptr;
  (first_ == nullptr ? first_ : last_->next_) = &job;
  last_ = &job;
}

LaneJob* LaneJobs::pop() noexcept {
  LaneJob* const job = first_;
  if (job != nullptr) first_ = job->next_;
  return job;
}

void LaneJobs::put_in_front(LaneJobs& others) noexcept {
  if (others.is_empty()) return;
  others.last_->next_ = first_;
  if (first_ == nullptr) last_ = others.last_;
  first_ = std::exchange(others.first_, nullptr);
}

/// One thread. A leadership has a number; 0: it does not lead.
struct LanePool::Worker {
  std::uint64_t leads = 0;
  MonotonicTime now{};
  Duration took{0};                        // the job that it has run
  std::shared_ptr<LaneQueue> queue;        // of that job
  std::shared_ptr<LaneListener> listener;  // of that job
  std::shared_ptr<LaneListener> untold;    // of jobs that have ended
  MonotonicTime untold_since{};

  void tell() noexcept {
    if (untold == nullptr) return;
    untold->tell();
    untold = nullptr;
  }
  void ended(bool is_to_be_told_now) noexcept {
    if (untold != listener) {
      tell();
      untold_since = now;
    }
    untold = std::move(listener);
    if (is_to_be_told_now || now - untold_since > longest_untold || untold->is_waited_for.load()) tell();
  }
};

/// Shared with the threads, which may be left behind.
///
/// Whoever finds that nobody leads while jobs are unserved chooses who leads next (`choose_leader`). Whoever ceases to
/// lead looks afterwards whether jobs are unserved, and whoever sends one looks afterwards whether somebody leads: so
/// one of the two sees it (all of this is sequentially consistent).
struct LanePool::State : std::enable_shared_from_this<LanePool::State> {
  const std::ptrdiff_t most;
  const Duration quick;
  std::atomic<LaneJob*> sent{nullptr};        // the newest first
  std::atomic<std::ptrdiff_t> unserved{0};    // in `sent` and `ready`; below 0 while one is counted after it is taken
  std::atomic<std::uint64_t> leader{0};       // the leadership now; 0: nobody leads
  std::atomic<std::uint64_t> leaderships{0};  // the number of them so far
  std::atomic<std::uint64_t> led_jobs{0};     // the number of jobs that leaders have begun
  std::atomic<std::uint64_t> in_led_job{0};   // the leadership that runs a job; 0: none
  std::atomic<unsigned> sleeping{0};          // a bit for each place where a thread sleeps that nobody has woken yet
  std::atomic<std::ptrdiff_t> threads{0};     // without those that hang
  std::atomic<std::ptrdiff_t> behind{0};      // that hang
  std::atomic<bool> quit{false};
  // Where threads sleep. The first is taken and woken first: the same thread goes on, whose memory is still in the
  // processor's caches. Not std::counting_semaphore, which may lose a wake-up in the libraries of our compilers.
  std::array<sem_t, most_idle + 1> places;

  PriorityMutex mutex;              // of what follows; no loop takes it on the way of a job
  LaneJobs ready;                   // that were sent, in order
  LaneQueue* first_slow = nullptr;  // lanes whose jobs wait since there are enough threads; each has one waiting
  LaneQueue* last_slow = nullptr;
  std::ptrdiff_t own_threads = 0;  // that run a job and do not lead, but for those that were quick until now
  std::condition_variable_any ended;
  const void* runtime = nullptr;
  std::optional<cpu_set_t> processors;

  State(std::size_t most_threads, Duration quick_) : most(static_cast<std::ptrdiff_t>(most_threads)), quick(quick_) {
    for (sem_t& place : places) ::sem_init(&place, 0, 0);
  }
  ~State() {
    drop_jobs();
    for (sem_t& place : places) ::sem_destroy(&place);
  }
  static const State*& of_this_thread() noexcept {
    static thread_local const State* own = nullptr;
    return own;
  }

  // ---- any thread

  void choose_leader() noexcept {
    do {
      std::uint64_t nobody = 0, chosen = ++leaderships;
      if (!leader.compare_exchange_strong(nobody, chosen) || wake_one()) return;
      leader.compare_exchange_strong(chosen, 0);
    } while (sleeping != 0);  // one went to sleep meanwhile, since somebody had been chosen
  }
  /// Somebody has been chosen. False: there is no thread, and the system gives none.
  bool wake_one() noexcept {
    if (const int place = take_lowest(sleeping); place >= 0) {
      ::sem_post(&places[static_cast<std::size_t>(place)]);
      return true;
    }
    const SignalsBlocked for_the_thread;
    ++threads;
    try {
      // Detached, since it may have to be left behind; counting them stands for joining.
      std::thread([self = shared_from_this()] {
        if (self->processors) ::sched_setaffinity(0, sizeof(cpu_set_t), &*self->processors);
        self->run();
      }).detach();
      return true;
    } catch (...) {
      --threads;
      return false;
    }
  }
  void drop_jobs() noexcept {
    LaneJobs all;
    {
      const std::lock_guard lock(mutex);
      take_sent();
      all.put_in_front(ready);
      for (; first_slow != nullptr; first_slow = first_slow->next_slow) all.put_in_front(first_slow->waiting);
    }
    while (LaneJob* job = all.pop()) {
      const auto last = std::move(job->self_);
      job->queue_ = nullptr;
    }
  }

  // ---- the pool's threads, under the mutex

  void take_sent() noexcept {
    if (sent.load(std::memory_order_relaxed) == nullptr) return;
    LaneJob* newest = sent.exchange(nullptr, std::memory_order_acquire);
    LaneJob* oldest = nullptr;
    while (newest != nullptr) newest = std::exchange(newest->next_, std::exchange(oldest, newest));
    while (oldest != nullptr) ready.push(*std::exchange(oldest, oldest->next_));
  }
  LaneJob* first_ready() noexcept {
    if (ready.is_empty()) take_sent();
    return ready.first();
  }
  LaneJob* take_ready() noexcept {
    --unserved;
    return ready.pop();
  }
  void add_slow(LaneQueue& queue) noexcept {
    queue.is_busy = true;
    queue.next_slow = nullptr;
    (first_slow == nullptr ? first_slow : last_slow->next_slow) = &queue;
    last_slow = &queue;
  }
  LaneQueue& take_slow() noexcept {
    LaneQueue& queue = *first_slow;
    first_slow = queue.next_slow;
    return queue;
  }
  bool may_have_own_thread() const noexcept { return own_threads < most - 1; }

  /// The next job is chosen.
  std::shared_ptr<LaneJob> begin(Worker& worker, LaneJob& job) noexcept {
    worker.queue = std::move(job.queue_);
    worker.listener = std::move(job.listener_);
    worker.queue->is_busy = true;
    worker.queue->led_by = worker.leads;
    worker.queue->has_own_thread = worker.leads == 0;
    if (worker.leads == 0) ++own_threads;
    return std::move(job.self_);
  }
  void end(Worker& worker) noexcept {
    const std::shared_ptr<LaneQueue> queue = std::move(worker.queue);
    if (std::exchange(queue->has_own_thread, false)) --own_threads;
    queue->is_busy = false;
    if (worker.took > quick) {  // once: the processor may have been given to others meanwhile
      queue->mistrust = queue->mistrust == 0 ? LaneQueue::suspected : LaneQueue::known_to_be_slow;
    } else if (worker.took.count() > 0 && queue->mistrust > 0) {
      --queue->mistrust;
    }
    if (!queue->waiting.is_empty()) add_slow(*queue);  // behind those that wait longer
  }
  /// Another one leads from here on, if there is anything to do.
  void cease_to_lead(Worker& worker) noexcept {
    while (first_ready() != nullptr && ready.first()->queue_->is_busy) {
      LaneJob& job = *take_ready();
      job.queue_->waiting.push(job);
    }
    leader.compare_exchange_strong(worker.leads, 0);
    worker.leads = 0;
    if (unserved > 0) choose_leader();
  }
  std::shared_ptr<LaneJob> next(Worker& worker) noexcept {
    const std::lock_guard lock(mutex);
    if (worker.queue != nullptr) end(worker);
    if (leader != worker.leads) worker.leads = 0;
    while (worker.leads != 0 && first_ready() != nullptr) {
      LaneJob& job = *take_ready();
      LaneQueue& queue = *job.queue_;
      if (queue.is_busy) {
        queue.waiting.push(job);
      } else if (most == 1 || queue.mistrust <= LaneQueue::suspected) {
        return begin(worker, job);
      } else if (may_have_own_thread()) {
        queue.is_busy = true;
        cease_to_lead(worker);
        return begin(worker, job);
      } else {
        queue.waiting.push(job);
        add_slow(queue);
      }
    }
    if (first_slow == nullptr || !may_have_own_thread()) return nullptr;
    LaneQueue& queue = take_slow();
    if (worker.leads != 0) cease_to_lead(worker);
    return begin(worker, *queue.waiting.pop());
  }
  /// What waits behind a job that was given up is served by whoever leads.
  void serve_again(LaneQueue& queue) noexcept {
    LaneJobs waiting;
    while (LaneJob* job = queue.waiting.pop()) {
      waiting.push(*job);
      ++unserved;
    }
    ready.put_in_front(waiting);
    queue.is_busy = false;
  }

  // ---- one of the pool's threads

  /// False: it was left behind.
  bool run_job(Worker& worker, LaneJob& job) noexcept {
    worker.took = Duration{0};
    if (!job.begin(worker.now)) return true;  // given up, or cancelled, while it waited
    const bool leads = worker.leads != 0;
    if (!leads) worker.tell();  // this job may take long, and the loop looks only after the leader
    if (leads) {
      led_jobs.fetch_add(1, std::memory_order_relaxed);
      in_led_job.store(worker.leads, std::memory_order_relaxed);
    }
    const std::shared_ptr<LaneQueue>& queue = worker.queue;
    job.run();
    if (!job.end()) {
      --behind;
      --queue->behind;
      return false;
    }
    worker.listener->finished.fetch_add(1, std::memory_order_release);
    if (leads) in_led_job.store(0, std::memory_order_relaxed);
    const MonotonicTime now = kernel_now();
    worker.took = now - std::exchange(worker.now, now);
    worker.ended(!leads || most == 1);
    return true;
  }
  /// Sleeps until it is to lead. False: there are enough that do so.
  bool rest(Worker& worker) noexcept {
    unsigned others = sleeping.load(), place = 0;
    do {
      const int count = std::popcount(others);
      if (worker.leads == 0 && count >= most_idle) return false;
      if (count > most_idle) {  // one that led before has taken the leader's place
        leader.compare_exchange_strong(worker.leads, 0);
        if (unserved > 0) choose_leader();
        return false;
      }
      place = static_cast<unsigned>(std::countr_one(others));
    } while (!sleeping.compare_exchange_weak(others, others | 1u << place));
    if (worker.leads != 0) leader.compare_exchange_strong(worker.leads, 0);
    if (std::uint64_t nobody = 0; unserved > 0) {
      const std::uint64_t chosen = ++leaderships;
      if (leader.compare_exchange_strong(nobody, chosen) && (sleeping.fetch_and(~(1u << place)) & 1u << place) != 0) {
        worker.leads = chosen;
        return true;
      }  // else somebody has chosen this thread already, or another one at this place
    }
    while (::sem_wait(&places[place]) != 0) {
    }
    worker.leads = leader;
    worker.now = kernel_now();
    return true;
  }
  void run() noexcept {
    LoopCore::lane_of() = runtime;
    of_this_thread() = this;
    Worker worker;
    worker.leads = leader;
    worker.now = kernel_now();
    while (!quit.load(std::memory_order_acquire)) {
      if (const std::shared_ptr<LaneJob> job = next(worker)) {
        if (!run_job(worker, *job)) return worker.tell();
        continue;
      }
      worker.tell();
      if (!rest(worker)) break;
    }
    worker.tell();
    const std::lock_guard lock(mutex);
    --threads;
    ended.notify_all();
  }
};

LanePool::LanePool(std::size_t most_threads, Duration quick) : state_(std::make_shared<State>(most_threads, quick)) {}

LanePool::~LanePool() {
  constexpr Duration patience_at_end = std::chrono::seconds{1};  // nothing holds them but the end of what they just do
  State& state = *state_;
  state.quit.store(true, std::memory_order_release);
  for (std::size_t left = threads(); left > 0; --left)  // wherever they sleep
    for (sem_t& place : state.places) ::sem_post(&place);
  if (State::of_this_thread() != &state) {
    std::unique_lock lock(state.mutex);
    state.ended.wait_for(lock, patience_at_end, [&] { return state.threads <= 0; });
  }
  state.drop_jobs();
}

void LanePool::push(std::shared_ptr<LaneJob> job, std::shared_ptr<LaneQueue> queue,
                    std::shared_ptr<LaneListener> listener) noexcept {
  LaneJob& pushed = *job;
  pushed.queue_ = std::move(queue);
  pushed.listener_ = std::move(listener);
  pushed.self_ = std::move(job);
  pushed.next_ = state_->sent.load(std::memory_order_relaxed);
  while (!state_->sent.compare_exchange_weak(pushed.next_, &pushed, std::memory_order_release,
                                             std::memory_order_relaxed)) {
  }
  ++state_->unserved;
}

void LanePool::wake(MonotonicTime now) noexcept {
  State& state = *state_;
  std::uint64_t leads = state.leader;
  if (leads == 0) {
    if (state.unserved > 0) state.choose_leader();
    return;
  }
  if (state.most == 1 || state.unserved <= 0) return;
  const std::uint64_t jobs = state.led_jobs.load(std::memory_order_relaxed);
  if (leads != seen_leader_ || jobs != seen_jobs_) {
    seen_leader_ = leads;
    seen_jobs_ = jobs;
    seen_at_ = now;
    return;
  }
  const bool is_in_job = state.in_led_job.load(std::memory_order_relaxed) == leads;  // else it has not come so far yet
  if (now - seen_at_ < (is_in_job ? patience : most_patience)) return;
  if (state.leader.compare_exchange_strong(leads, 0)) state.choose_leader();
}

bool LanePool::is_to_be_watched() const noexcept {
  return state_->most > 1 && (state_->leader != 0 || state_->unserved > 0);
}

bool LanePool::start(const void* runtime, const std::optional<cpu_set_t>& processors) noexcept {
  State& state = *state_;
  if (has_thread()) return true;
  const std::lock_guard lock(state.mutex);
  if (has_thread()) return true;
  if (state.runtime == nullptr) {  // only once: threads read it
    state.runtime = runtime;
    state.processors = processors;
  }
  state.choose_leader();
  return has_thread();
}

bool LanePool::has_thread() const noexcept { return threads() > 0; }
std::size_t LanePool::threads() const noexcept { return count_of(state_->threads); }
std::size_t LanePool::left_behind() const noexcept { return count_of(state_->behind); }
bool LanePool::is_for_one_lane() const noexcept { return state_->most == 1; }

void LanePool::leave_behind(LaneQueue& queue) noexcept {
  State& state = *state_;
  const std::lock_guard lock(state.mutex);
  ++queue.behind;
  ++state.behind;
  --state.threads;
  if (std::exchange(queue.has_own_thread, false)) --state.own_threads;
  if (std::uint64_t led_by = std::exchange(queue.led_by, 0); led_by != 0) {
    state.leader.compare_exchange_strong(led_by, 0);
  }
  state.serve_again(queue);
  if (state.first_slow != nullptr && state.may_have_own_thread()) state.serve_again(state.take_slow());
  if (state.most > 1 && state.unserved > 0) state.choose_leader();
}

}  // namespace rtdata::detail
