// The threads that run the jobs of lanes: one thread for a single lane, or a pool for many lanes.
//
// Most devices answer in microseconds, some hang. A lane whose last job took at most 1 ms is quick: quick lanes share
// one queue, served by one thread, or by up to four if one is too slow. Each job of another lane has its own thread; so
// does a job of a quick lane that takes longer. A thread that takes a job makes sure that another thread sleeps, which
// the loop can wake (`wake`).
//
// At most one job of each lane runs, in order, on any thread.
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

/// How a thread notifies a loop of ended jobs. Shared with threads, which may be abandoned.
struct LaneListener {
  PriorityMutex mutex;
  std::condition_variable_any job_ended;
  Wake* loop_wake = nullptr;  // protected by the mutex; null when the loop no longer listens
  std::atomic<bool> is_waited_for{false};
  /// Number of finished jobs, increased after a job and before the loop is notified. Includes jobs whose end the loop
  /// has noticed otherwise.
  std::atomic<std::size_t> finished{0};

  /// Waits until `is_so` returns true, which the end of a job may cause.
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

/// The jobs of one lane, or of the lanes of several loops to one bus. Shared with its jobs; the pool's mutex protects
/// all but `behind`.
struct LaneQueue {
  Chain<LaneJob, &LaneJob::next_> waiting;  // waiting jobs; they keep themselves alive
  bool is_listed = false;                   // one of them runs, or the queue waits for a thread
  bool is_quick = false;                    // so was its last job
  MonotonicTime began{};                    // the one that runs
  LaneQueue* next = nullptr;                // that waits for a thread
  std::atomic<std::ptrdiff_t> behind{0};    // hanging threads; below 0: one returned just when it was abandoned
};

/// Owner: shared by the owners of its lanes; its threads end with the last of them. Thread: any.
class LanePool {
 public:
  /// Lanes whose last job took longer are not quick.
  static constexpr Duration usual_quick = std::chrono::milliseconds{1};
  static constexpr std::size_t most_quick = 4;  ///< jobs of quick lanes at once

  /// `most_slow`: maximum number of running jobs of other lanes. 0: for one lane, with one thread.
  explicit LanePool(std::size_t most_slow, Duration quick = usual_quick);
  LanePool(const LanePool&) = delete;
  LanePool& operator=(const LanePool&) = delete;
  ~LanePool();

  /// Adds a job after all earlier ones of any loop. Does not wait or allocate. It runs after the next `wake`, or
  /// earlier.
  void push(std::shared_ptr<LaneJob> job, std::shared_ptr<LaneQueue> queue,
            std::shared_ptr<LaneListener> listener) noexcept;
  /// Makes sure that a thread processes pushed jobs. Does not wait.
  void wake() noexcept;
  /// Starts a watch: `help` then checks the progress of quick lanes. False: nothing to watch. Both are for one loop.
  bool begin_watch() noexcept;
  /// Wakes another thread if they make no progress.
  void help() noexcept;
  /// True if the maximum number of other lanes runs jobs.
  bool is_full() const noexcept;
  /// Makes sure that there is a thread. False: the system refuses to create one.
  bool start(const void* runtime, const std::optional<cpu_set_t>& processors) noexcept;
  bool has_thread() const noexcept;
  /// Abandons a thread that hangs in a job of this queue; the job was taken from it.
  void abandon_thread(LaneQueue& queue) noexcept;
  /// The number of hanging threads of all its lanes.
  std::size_t abandoned_threads() const noexcept;
  bool is_for_one_lane() const noexcept;
  /// The number of threads without hanging ones, for tests.
  std::size_t threads() const noexcept;

 private:
  struct Worker;
  struct State;
  std::shared_ptr<State> state_;
  std::uint64_t seen_begun_ = 0;  // jobs, when the watch began
};

}  // namespace rtdata::detail
