#include "loop/core/lane_thread.hpp"

#include <time.h>

#include <algorithm>
#include <mutex>
#include <thread>
#include <utility>

#include "loop/core/loop_core.hpp"
#include "loop/support/deadline.hpp"
#include "loop/support/signals_blocked.hpp"
#include "rtdata/loop/lane.hpp"

namespace rtdata::detail {
namespace {

LaneClock*& virtual_clock() noexcept {
  static thread_local LaneClock* clock = nullptr;
  return clock;
}

}  // namespace

void LaneListener::stop_listening() noexcept {
  const std::lock_guard lock(mutex);
  loop_wake = nullptr;
}

/// Shared with the threads, which may be left behind. Only one of them takes jobs: the others hang in one that was
/// taken from them, and end when they see that.
struct LaneThread::State {
  struct Place {
    std::atomic<bool> is_taken{false};
    std::shared_ptr<LaneJob> job;
    std::shared_ptr<LaneListener> listener;
  };
  std::vector<Place> ring;
  std::atomic<std::ptrdiff_t> room;
  std::atomic<std::size_t> head{0};
  std::size_t tail = 0;  // of the thread that takes jobs
  sem_t wake;            // not std::counting_semaphore, which may lose a wake-up in the libraries of our compilers
  std::atomic<bool> quit{false};
  std::atomic<bool> has_thread{false};
  std::atomic<std::ptrdiff_t> behind{0};  // below 0: one comes back just when it is left behind
  PriorityMutex mutex;                    // of what follows; never taken on the way of a job
  std::condition_variable_any ended;
  bool is_ended = true;
  std::thread::id thread;

  explicit State(std::size_t places) : ring(places), room(static_cast<std::ptrdiff_t>(places)) {
    ::sem_init(&wake, 0, 0);
  }
  ~State() { ::sem_destroy(&wake); }

  /// False: it was left behind.
  bool run_next(Place& place) {
    const std::shared_ptr<LaneJob> job = std::move(place.job);
    const std::shared_ptr<LaneListener> listener = std::move(place.listener);
    place.is_taken.store(false, std::memory_order_relaxed);
    ++tail;
    room.fetch_add(1, std::memory_order_release);
    if (!job->begin()) return true;  // given up, or cancelled, while it waited
    job->run();
    if (!job->end()) {
      behind.fetch_sub(1, std::memory_order_release);
      return false;
    }
    const std::lock_guard lock(listener->mutex);
    if (listener->loop_wake != nullptr) listener->loop_wake->send();
    listener->job_ended.notify_all();
    return true;
  }

  void run(const void* runtime) {
    LoopCore::lane_of() = runtime;
    while (!quit.load(std::memory_order_acquire)) {
      while (::sem_wait(&wake) != 0) {
      }
      // Of several that push at once, the first may be the last to be done: its own wake-up comes then.
      while (!quit.load(std::memory_order_acquire) &&
             ring[tail % ring.size()].is_taken.load(std::memory_order_acquire)) {
        if (!run_next(ring[tail % ring.size()])) return;
      }
    }
    const std::lock_guard lock(mutex);
    is_ended = true;
    ended.notify_all();
  }
};

LaneThread::LaneThread(std::size_t room) : state_(std::make_shared<State>(room)) {}

LaneThread::~LaneThread() {
  constexpr Duration patience = std::chrono::seconds{1};  // nothing holds it but the end of what it has just done
  state_->quit.store(true, std::memory_order_release);
  ::sem_post(&state_->wake);
  std::unique_lock lock(state_->mutex);
  if (!state_->has_thread.load(std::memory_order_relaxed) || state_->thread == std::this_thread::get_id()) return;
  state_->ended.wait_for(lock, patience, [this] { return state_->is_ended; });
}

bool LaneThread::push(std::shared_ptr<LaneJob> job, std::shared_ptr<LaneListener> listener) noexcept {
  State& state = *state_;
  if (state.room.fetch_sub(1, std::memory_order_acq_rel) <= 0) {
    state.room.fetch_add(1, std::memory_order_relaxed);
    return false;
  }
  // There is a free place for each thread that got here; acquire and release of `room` and `head` order its reuse.
  State::Place& place = state.ring[state.head.fetch_add(1, std::memory_order_acq_rel) % state.ring.size()];
  place.job = std::move(job);
  place.listener = std::move(listener);
  place.is_taken.store(true, std::memory_order_release);
  ::sem_post(&state.wake);
  return true;
}

bool LaneThread::start(const void* runtime, const std::optional<cpu_set_t>& processors,
                       std::size_t most_left_behind) noexcept {
  if (has_thread()) return true;
  const std::lock_guard lock(state_->mutex);
  if (has_thread()) return true;
  if (left_behind() >= most_left_behind) return false;
  const SignalsBlocked for_the_thread;
  try {
    // Detached, since it may have to be left behind; `is_ended` stands for joining.
    std::thread thread([state = state_, runtime, processors] {
      if (processors) ::sched_setaffinity(0, sizeof *processors, &*processors);
      state->run(runtime);
    });
    state_->thread = thread.get_id();
    thread.detach();
  } catch (...) {
    return false;
  }
  state_->is_ended = false;
  state_->has_thread.store(true, std::memory_order_release);
  ::sem_post(&state_->wake);  // what waits was waited for by another thread
  return true;
}

bool LaneThread::has_thread() const noexcept { return state_->has_thread.load(std::memory_order_acquire); }

void LaneThread::leave_behind() noexcept {
  const std::lock_guard lock(state_->mutex);
  state_->behind.fetch_add(1, std::memory_order_relaxed);
  state_->has_thread.store(false, std::memory_order_release);
}

std::size_t LaneThread::left_behind() const noexcept {
  return static_cast<std::size_t>(std::max<std::ptrdiff_t>(state_->behind.load(std::memory_order_acquire), 0));
}

LaneClock::LaneClock(MonotonicTime now) noexcept : began_(now), now_(now) { virtual_clock() = this; }
LaneClock::~LaneClock() { virtual_clock() = nullptr; }

MonotonicTime lane_now() noexcept {
  const LaneClock* const clock = virtual_clock();
  return clock != nullptr ? clock->now_ : std::chrono::steady_clock::now();
}

void lane_sleep(Duration duration) noexcept {
  if (duration.count() <= 0) return;
  if (LaneClock* const clock = virtual_clock()) {
    clock->now_ = later(clock->now_, duration);
    return;
  }
  constexpr std::int64_t second = 1'000'000'000;
  timespec left{static_cast<time_t>(duration.count() / second), static_cast<long>(duration.count() % second)};
  while (::nanosleep(&left, &left) != 0) {
  }
}

}  // namespace rtdata::detail
