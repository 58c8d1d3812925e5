// The threads that run the jobs of lanes: one for a lane of its own, or a pool for many lanes.
//
// Most devices answer in microseconds, some hang. So that a thousand of the former need one thread, and the latter
// disturb nobody, one thread at a time leads: it alone takes jobs as they come, and runs those of lanes that are known
// to be quick. For any other job it lets a second thread lead before it begins. One that was known to be quick, and
// takes long, is noticed by the loop, which makes another thread lead (`wake`).
//
// Of each lane at most one job runs, in order, whoever runs it.
#pragma once

#include <sched.h>

#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>

#include "loop/support/priority_mutex.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::detail {

class LaneJob;
class Wake;

/// How a thread tells a loop that jobs have ended. Shared with threads, which may be left behind.
struct LaneListener {
  PriorityMutex mutex;
  std::condition_variable_any job_ended;
  Wake* loop_wake = nullptr;  // guarded by the mutex; null once the loop does not listen any more
  std::atomic<bool> is_waited_for{false};
  /// Jobs that have finished, counted after they have, and before the loop is told. Those whose end the loop has seen
  /// by other ways are in it too.
  std::atomic<std::size_t> finished{0};

  /// `is_so` may become true by the end of a job.
  template <class Predicate>
  void wait(Duration at_most, const Predicate& is_so) {
    std::unique_lock lock(mutex);
    is_waited_for.store(true);
    job_ended.wait_for(lock, at_most, is_so);
    is_waited_for.store(false);
  }
  void tell() noexcept;
  void stop_listening() noexcept;
};

/// Jobs in order, linked by themselves; it keeps them alive.
class LaneJobs {
 public:
  bool is_empty() const noexcept { return first_ == nullptr; }
  LaneJob* first() const noexcept { return first_; }
  void push(LaneJob& job) noexcept;
  LaneJob* pop() noexcept;
  /// Those of another list, in front of these.
  void put_in_front(LaneJobs& others) noexcept;

 private:
  LaneJob* first_ = nullptr;
  LaneJob* last_ = nullptr;
};

/// The jobs of one lane, or of the lanes of several loops to one bus. Shared with its jobs; all but `behind` is guarded
/// by the pool's mutex.
struct LaneQueue {
  static constexpr unsigned suspected = 4;  // up to here it counts as quick: at most one of its last jobs was slow
  static constexpr unsigned known_to_be_slow = suspected + 8;
  LaneJobs waiting;                   // behind the one that runs, or for a thread
  bool is_busy = false;               // one of them runs, or waits for a thread in `LanePool::State::slow`
  bool has_own_thread = false;        // what runs it does not lead
  std::uint64_t led_by = 0;           // the leadership under which one of them runs
  unsigned mistrust = suspected + 1;  // the number of quick jobs until its slow ones are forgotten
  LaneQueue* next_slow = nullptr;
  std::atomic<std::ptrdiff_t> behind{0};  // threads that hang; below 0: one comes back just when it is left behind
};

/// Owner: shared by those who have lanes on it; its threads end with the last of them. Thread: any.
class LanePool {
 public:
  /// Lanes of whose last jobs at most one took longer are known to be quick: not worth handing them to another thread.
  static constexpr Duration usual_quick = std::chrono::microseconds{100};
  /// One that takes longer than this does not lead any more, so that the others wait no longer.
  static constexpr Duration patience = std::chrono::milliseconds{1};

  /// So many threads at most, without those that hang and those that were quick until now.
  explicit LanePool(std::size_t most_threads, Duration quick = usual_quick);
  LanePool(const LanePool&) = delete;
  LanePool& operator=(const LanePool&) = delete;
  ~LanePool();

  /// Behind all that were pushed before, whichever loop did so. Waits for nobody and allocates nothing. It is run after
  /// the next `wake`, if not before.
  void push(std::shared_ptr<LaneJob> job, std::shared_ptr<LaneQueue> queue,
            std::shared_ptr<LaneListener> listener) noexcept;
  /// Makes sure that a thread looks at the jobs that wait. Waits for nobody. A pool for many lanes belongs to one loop,
  /// on whose thread this is called.
  void wake(MonotonicTime now) noexcept;
  /// Whether `wake` may have to be called again, `patience` later.
  bool is_to_be_watched() const noexcept;
  /// Makes sure that there is a thread. False: the system gives none.
  bool start(const void* runtime, const std::optional<cpu_set_t>& processors) noexcept;
  bool has_thread() const noexcept;
  /// Of a thread that hangs in a job of this queue, which was taken from it.
  void leave_behind(LaneQueue& queue) noexcept;
  /// Threads that hang, of all its lanes.
  std::size_t left_behind() const noexcept;
  bool is_for_one_lane() const noexcept;
  /// So many threads, for tests; without those that hang.
  std::size_t threads() const noexcept;

 private:
  struct Worker;
  struct State;
  std::shared_ptr<State> state_;
  // Who led when `wake` was called last, and how far it had come.
  std::uint64_t seen_leader_ = 0;
  std::uint64_t seen_jobs_ = 0;
  MonotonicTime seen_at_{};
};

}  // namespace rtdata::detail
