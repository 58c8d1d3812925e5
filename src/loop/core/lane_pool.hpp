// The threads that run the jobs of lanes: one for a lane of its own, or a pool for many lanes.
//
// Most devices answer in microseconds, some hang. A lane whose last job took no longer than 1 ms is quick: quick lanes
// share one queue, of which one thread takes the jobs as they come, and four when they do not get on. Each job of
// another lane has a thread for itself; so has one of a quick lane as soon as it takes longer. Whoever takes a job
// makes sure that one more thread sleeps, which the loop sends (`wake`).
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

#include "loop/core/priority_mutex.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/detail/loop/lane.hpp"

namespace rtdata::detail {

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

/// In order, linked by themselves.
template <class Linked, Linked* Linked::*next>
class Chain {
 public:
  bool is_empty() const noexcept { return first_ == nullptr; }
  void push(Linked& one) noexcept {
    one.*next = nullptr;
    (first_ == nullptr ? first_ : last_->*next) = &one;
    last_ = &one;
  }
  Linked* pop() noexcept {
    Linked* const one = first_;
    if (one != nullptr) first_ = one->*next;
    return one;
  }

 private:
  Linked* first_ = nullptr;
  Linked* last_ = nullptr;
};

/// The jobs of one lane, or of the lanes of several loops to one bus. Shared with its jobs; all but `behind` is guarded
/// by the pool's mutex.
struct LaneQueue {
  Chain<LaneJob, &LaneJob::next_> waiting;  // behind the one that runs, or for a thread; kept alive by themselves
  bool is_listed = false;                   // one of them runs, or the queue waits for a thread
  bool is_quick = false;                    // so was its last job
  MonotonicTime began{};                    // the one that runs
  LaneQueue* next = nullptr;                // that waits for a thread
  std::atomic<std::ptrdiff_t> behind{0};    // threads that hang; below 0: one comes back just when it is left behind
};

/// Owner: shared by those who have lanes on it; its threads end with the last of them. Thread: any.
class LanePool {
 public:
  /// Lanes whose last job took longer are not quick.
  static constexpr Duration usual_quick = std::chrono::milliseconds{1};
  static constexpr std::size_t most_quick = 4;  ///< jobs of quick lanes at once

  /// So many jobs of other lanes at once. 0: it is for one lane, with one thread.
  explicit LanePool(std::size_t most_slow, Duration quick = usual_quick);
  LanePool(const LanePool&) = delete;
  LanePool& operator=(const LanePool&) = delete;
  ~LanePool();

  /// Behind all that were pushed before, whichever loop did so. Waits for nobody and allocates nothing. It is run after
  /// the next `wake`, if not before.
  void push(std::shared_ptr<LaneJob> job, std::shared_ptr<LaneQueue> queue,
            std::shared_ptr<LaneListener> listener) noexcept;
  /// Makes sure that a thread looks at the jobs that were pushed. Waits for nobody.
  void wake() noexcept;
  /// `help` looks whether quick lanes get on from here on. False: there is nothing to look after. Both are for one
  /// loop.
  bool begin_watch() noexcept;
  /// Another thread looks if they do not.
  void help() noexcept;
  /// So many other lanes have a job that runs as may have.
  bool is_full() const noexcept;
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
  std::uint64_t seen_begun_ = 0;  // jobs, when the watch began
};

}  // namespace rtdata::detail
