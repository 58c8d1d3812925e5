#include "loop/core/lane_pool.hpp"

#include <semaphore.h>

#include <algorithm>
#include <array>
#include <bit>
#include <mutex>
#include <thread>
#include <utility>

#include "loop/core/loop_core.hpp"
#include "loop/core/signals_blocked.hpp"
#include "rtdata/detail/loop/lane.hpp"

namespace rtdata::detail {
namespace {

constexpr unsigned most_idle = 4;  // further idle threads end
constexpr Duration patience = std::chrono::milliseconds{1};
constexpr std::uint64_t least_in_patience = 10;  // number of jobs begun within it if quick lanes make progress
constexpr Duration longest_unreported = std::chrono::microseconds{500};

MonotonicTime kernel_now() noexcept { return std::chrono::steady_clock::now(); }

/// Clears the highest set bit and returns its index; -1: none.
int take_highest(std::atomic<unsigned>& bits) noexcept {
  unsigned was = bits.load();
  while (was != 0 && !bits.compare_exchange_weak(was, was & ~std::bit_floor(was))) {
  }
  return static_cast<int>(std::bit_width(was)) - 1;
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

struct LanePool::Worker {
  MonotonicTime now{};
  Duration took{0};                          // the job that it has run
  std::shared_ptr<LaneQueue> queue;          // of that job
  std::shared_ptr<LaneListener> listener;    // of that job
  bool reports_at_once = false;              // of that job
  bool has_come = true;                      // it was woken and has not looked yet
  bool calls = false;                        // wake another thread before running that job
  std::shared_ptr<LaneListener> unreported;  // of jobs that have ended
  MonotonicTime unreported_since{};

  void tell() noexcept {
    if (unreported == nullptr) return;
    unreported->tell();
    unreported = nullptr;
  }
  void ended() noexcept {
    if (unreported != listener) {
      tell();
      unreported_since = now;
    }
    unreported = std::move(listener);
    if (reports_at_once || took > patience || now - unreported_since > longest_unreported ||
        unreported->is_waited_for.load())
      tell();
  }
};

/// Shared with the threads, which may be abandoned.
///
/// The sender of a job then checks that a thread comes or runs quick jobs, and otherwise wakes one. A thread that goes
/// to sleep then checks for new jobs. So one of the two sees the job (all accesses are sequentially consistent).
struct LanePool::State : std::enable_shared_from_this<LanePool::State> {
  const int most_slow;
  const Duration quick;
  std::atomic<LaneJob*> sent{nullptr};  // the newest first
  std::atomic<bool> comes{false};       // a woken thread has not looked yet
  std::atomic<bool> gets_on{true};      // what is quick
  std::atomic<int> quick_lanes{0};      // waiting or running; changed under the mutex, like the next members
  std::atomic<int> quick_running{0};
  std::atomic<int> slow_running{0};        // without lanes that were quick until now
  std::atomic<std::uint64_t> begun{0};     // jobs
  std::atomic<unsigned> sleeping{0};       // a bit for each place with a sleeping thread not yet woken
  std::atomic<std::ptrdiff_t> threads{0};  // without those that hang
  std::atomic<std::ptrdiff_t> behind{0};   // abandoned threads, which hang
  std::atomic<bool> quit{false};
  // Where threads sleep. A thread takes the first free place, and the last one is woken first, so mostly the same
  // thread continues, with warm caches. Not std::counting_semaphore, which may lose a wake-up in the libraries of our
  // compilers.
  std::array<sem_t, most_idle> places;

  PriorityMutex mutex;  // protects the following members; no loop takes it when it submits a job
  Chain<LaneQueue, &LaneQueue::next> quick_waiting, slow_waiting;
  std::array<LaneQueue*, most_quick> quick_ones{};  // of which a job runs
  std::condition_variable_any ended;
  const void* runtime = nullptr;
  std::optional<cpu_set_t> processors;

  State(std::size_t most_slow_, Duration quick_) : most_slow(static_cast<int>(most_slow_)), quick(quick_) {
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
  bool is_for_one_lane() const noexcept { return most_slow == 0; }
  bool is_to_be_watched() const noexcept { return sent != nullptr || quick_lanes > 0; }

  // ---- any thread

  /// False: no thread sleeps, and no new one can or may be made.
  bool wake_one(bool may_make) noexcept {
    do {
      if (comes) return true;
      if (const int place = take_highest(sleeping); place >= 0) {
        comes = true;
        ::sem_post(&places[static_cast<std::size_t>(place)]);
        return true;
      }
      if (!may_make) return false;
      comes = true;
      if (make_thread()) return true;
      comes = false;
    } while (sleeping != 0);  // one went to sleep meanwhile
    return false;
  }
  bool make_thread() noexcept {
    const SignalsBlocked for_the_thread;
    ++threads;
    try {
      // Detached, because it may be abandoned; the counts replace joining.
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
    decltype(LaneQueue::waiting) all;
    {
      const std::lock_guard lock(mutex);
      take_sent();
      for (auto* waiting : {&quick_waiting, &slow_waiting})
        while (LaneQueue* const queue = waiting->pop())
          while (LaneJob* const job = queue->waiting.pop()) all.push(*job);
    }
    while (LaneJob* const job = all.pop()) {
      const std::shared_ptr<LaneJob> last = std::move(job->self_);
      job->queue_ = nullptr;
    }
  }

  // ---- under the mutex

  void list(LaneQueue& queue) noexcept {
    queue.is_listed = !queue.waiting.is_empty();
    if (!queue.is_listed) return;
    const bool is_quick = queue.is_quick || is_for_one_lane();
    if (is_quick) ++quick_lanes;
    (is_quick ? quick_waiting : slow_waiting).push(queue);
  }
  void take_sent() noexcept {
    if (sent == nullptr) return;
    ++quick_lanes;  // some of them may be quick
    LaneJob* newest = sent.exchange(nullptr);
    LaneJob* oldest = nullptr;
    while (newest != nullptr) newest = std::exchange(newest->next_, std::exchange(oldest, newest));
    while (oldest != nullptr) {
      LaneJob& job = *std::exchange(oldest, oldest->next_);
      LaneQueue& queue = *job.queue_;
      queue.waiting.push(job);
      if (!queue.is_listed) list(queue);
    }
    --quick_lanes;
  }
  bool may_take_slow() const noexcept { return !slow_waiting.is_empty() && slow_running < most_slow; }
  bool may_take_quick() const noexcept {
    const bool is_one_enough = is_for_one_lane() || gets_on;
    return !quick_waiting.is_empty() && quick_running < (is_one_enough ? 1 : static_cast<int>(most_quick));
  }
  LaneQueue* take(bool takes_slow) noexcept {
    if (takes_slow && may_take_slow()) {
      ++slow_running;
      return slow_waiting.pop();
    }
    if (!may_take_quick()) return nullptr;
    ++quick_running;
    return *std::find(quick_ones.begin(), quick_ones.end(), nullptr) = quick_waiting.pop();
  }
  /// Its job has ended, or runs on an abandoned thread.
  void release(LaneQueue& queue, bool is_quick) noexcept {
    const auto found = std::find(quick_ones.begin(), quick_ones.end(), &queue);
    if (found != quick_ones.end()) {
      *found = nullptr;
      --quick_running;
      --quick_lanes;
    } else if (!queue.is_quick) {
      --slow_running;
    }  // else it was set apart
    queue.is_quick = is_quick;
    list(queue);  // behind those that wait longer
  }
  /// Moves formerly quick lanes with long jobs out of the quick queue.
  void set_slow_ones_apart(MonotonicTime now) noexcept {
    for (LaneQueue*& one : quick_ones) {
      if (one == nullptr || now - one->began <= patience) continue;
      one = nullptr;
      --quick_running;
      --quick_lanes;
    }
  }
  std::shared_ptr<LaneJob> next(Worker& worker) noexcept {
    const std::lock_guard lock(mutex);
    const std::shared_ptr<LaneQueue> last = std::move(worker.queue);
    if (last != nullptr) release(*last, worker.took.count() > 0 ? worker.took <= quick : last->is_quick);
    take_sent();
    if (!gets_on) {
      set_slow_ones_apart(worker.now);
      gets_on = quick_waiting.is_empty();
    }
    LaneQueue* queue = take(last == nullptr || !comes);  // leaves the next job to a coming thread
    if (std::exchange(worker.has_come, false)) {
      comes = false;  // only now, so that a loop always sees a coming thread or a running quick job
      take_sent();
      if (queue == nullptr) queue = take(true);
    }
    if (queue == nullptr) return nullptr;
    worker.calls = !is_for_one_lane() && (may_take_slow() || may_take_quick() || sleeping == 0);
    worker.reports_at_once = !queue->is_quick || is_for_one_lane();
    queue->began = worker.now;
    LaneJob& job = *queue->waiting.pop();
    worker.queue = std::move(job.queue_);
    worker.listener = std::move(job.listener_);
    return std::move(job.self_);
  }

  // ---- one of the pool's threads

  /// False: the thread was abandoned.
  bool run_job(Worker& worker, LaneJob& job) noexcept {
    worker.took = Duration{0};
    if (!job.begin(worker.now)) return true;  // given up, or cancelled, while it waited
    if (worker.calls) wake_one(true);
    if (worker.reports_at_once) worker.tell();
    begun.fetch_add(1, std::memory_order_relaxed);
    job.run();
    if (!job.end()) {
      --behind;
      --worker.queue->behind;
      return false;
    }
    worker.listener->finished.fetch_add(1, std::memory_order_release);
    const MonotonicTime now = kernel_now();
    worker.took = now - std::exchange(worker.now, now);
    worker.ended();
    return true;
  }
  /// Sleeps until woken. False: enough threads sleep already.
  bool rest(Worker& worker) noexcept {
    unsigned others = sleeping.load(), place = 0;
    do {
      place = static_cast<unsigned>(std::countr_one(others));
      if (place == most_idle) return false;
    } while (!sleeping.compare_exchange_weak(others, others | 1u << place));
    if (sent != nullptr && (sleeping.fetch_and(~(1u << place)) & 1u << place) != 0) return true;
    while (::sem_wait(&places[place]) != 0) {
    }
    return worker.has_come = true;
  }
  void run() noexcept {
    LoopCore::lane_of() = runtime;
    of_this_thread() = this;
    Worker worker;
    do {
      worker.now = kernel_now();
      while (!quit.load(std::memory_order_acquire)) {
        const std::shared_ptr<LaneJob> job = next(worker);
        if (job == nullptr) break;
        if (!run_job(worker, *job)) return worker.tell();
      }
      worker.tell();
    } while (!quit.load(std::memory_order_acquire) && rest(worker));
    const std::lock_guard lock(mutex);
    if (worker.queue != nullptr) release(*worker.queue, true);  // the pool drops the jobs that wait after the last one
    --threads;
    ended.notify_all();
  }
};

LanePool::LanePool(std::size_t most_slow, Duration quick) : state_(std::make_shared<State>(most_slow, quick)) {}

LanePool::~LanePool() {
  constexpr Duration patience_at_end = std::chrono::seconds{1};  // they only have to finish their present step
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
  while (!state_->sent.compare_exchange_weak(pushed.next_, &pushed)) {
  }
}

void LanePool::wake() noexcept {
  if (state_->sent != nullptr && state_->quick_running == 0) state_->wake_one(false);  // else its thread looks
}

bool LanePool::begin_watch() noexcept {
  seen_begun_ = state_->begun.load(std::memory_order_relaxed);
  return state_->is_to_be_watched();
}

void LanePool::help() noexcept {
  const std::uint64_t begun = state_->begun.load(std::memory_order_relaxed) - seen_begun_;
  if (begun >= least_in_patience || !state_->is_to_be_watched()) return;
  state_->gets_on = false;
  state_->wake_one(true);
}

bool LanePool::is_full() const noexcept { return state_->slow_running >= state_->most_slow; }

bool LanePool::start(const void* runtime, const std::optional<cpu_set_t>& processors) noexcept {
  State& state = *state_;
  if (has_thread()) return true;
  const std::lock_guard lock(state.mutex);
  if (has_thread()) return true;
  if (state.runtime == nullptr) {  // only once: threads read it
    state.runtime = runtime;
    state.processors = processors;
  }
  return state.make_thread();
}

bool LanePool::has_thread() const noexcept { return threads() > 0; }
std::size_t LanePool::threads() const noexcept { return count_of(state_->threads); }
std::size_t LanePool::abandoned_threads() const noexcept { return count_of(state_->behind); }
bool LanePool::is_for_one_lane() const noexcept { return state_->is_for_one_lane(); }

void LanePool::abandon_thread(LaneQueue& queue) noexcept {
  State& state = *state_;
  {
    const std::lock_guard lock(state.mutex);
    ++queue.behind;
    ++state.behind;
    --state.threads;
    state.release(queue, false);
  }
  if (!is_for_one_lane()) state.wake_one(true);
}

}  // namespace rtdata::detail
