/// Lane: a worker thread of a loop for blocking work: one for each sink and each physical device.
///
/// Jobs run one after the other, in order. The lane gives up a job that outlives the limit: it leaves the job's thread
/// behind, runs the waiting jobs on a new thread, and calls the job's `done` with `given_up`. With `most_left_behind`
/// threads left behind the lane takes no job until one of them has returned. Lanes run transactions and storage, never
/// a user's callbacks.
///
/// On a manual loop, a job has no thread: it runs at once, or just before it is done if the seed says so. Its `done` is
/// called after the scripted virtual duration, and what the seed adds; given up after the limit, when that is shorter.
///
/// Owner: the loop's `Lanes`, which find it by key, or the object that made it. The loop collects the finished jobs of
/// both.
/// Thread: the loop's; `LaneJob::run` alone is called on the lane's.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "rtdata/data/time.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata::detail {

class LoopCore;

/// Work for a lane. The loop and the lane's thread share it, since a job that was given up may still finish later:
/// `run` may touch only what the job owns.
class LaneJob {
 public:
  virtual ~LaneJob() = default;
  /// On the lane's thread.
  virtual void run() noexcept = 0;

  enum class Outcome { finished, given_up, cancelled };
  /// On the loop's thread, once per submission that was accepted.
  virtual void done(Outcome outcome) = 0;

 private:
  friend class Lane;
  enum State : int { idle, queued, running, finished };
  std::atomic<int> state_{idle};
  std::atomic<std::int64_t> began_{0};  // ns of the monotonic line
};

class Lane {
 public:
  static constexpr std::size_t most_outstanding = 4096;  ///< jobs that run or wait: sensors that share a device
  static constexpr std::size_t most_left_behind = 4;
  Lane(LoopCore& loop, std::string name, Duration give_up_after);
  /// Waits for the running job for at most the limit; jobs that wait are cancelled.
  ~Lane();

  /// False when the queue is full, or no thread is left to run it. The job must not be submitted already.
  bool submit(std::shared_ptr<LaneJob> job);
  /// Raises the limit, where several with limits of their own use one lane.
  void allow(Duration give_up_after) noexcept { give_up_after_ = std::max(give_up_after_, give_up_after); }
  /// Threads that have been left behind and have not come back.
  std::size_t left_behind() const noexcept;
  /// As many threads as may be are left behind: nothing runs until one of them comes back.
  bool is_stuck() const noexcept { return worker_ == nullptr && left_behind() >= most_left_behind; }
  /// The system gives no thread.
  bool lacks_thread() const noexcept { return needs_thread_ && worker_ == nullptr && !is_stuck(); }
  /// Gives up the first job that has not finished, however long it has run.
  void give_up();
  /// Calls `done` of finished jobs. The loop does so when a worker has woken it. `done` may destroy the lane.
  void collect();
  /// Blocks until the first job has finished, but no longer than this, and calls its `done`. For closing only. On a
  /// manual loop, virtual time passes instead.
  void wait(Duration at_most);
  /// Leaves the thread behind with the job that it runs, and starts no new one.
  void leave_behind() noexcept;

 private:
  static constexpr std::size_t ring_size = 64;  // jobs that the thread has at hand; the others wait on the loop
  struct Worker;
  struct Watchdog;
  struct Delayed;
  /// False when there can be none: too many were left behind, or the system gives no more threads.
  bool start_worker() noexcept;
  /// So many may be outstanding without asking for memory.
  void make_room(std::size_t jobs);
  void hand_over();
  void check_limit();
  void look_at_health(LaneJob::Outcome outcome);
  void finish(std::size_t index, LaneJob::Outcome outcome);
  /// On a manual loop.
  void run_here(LaneJob& job) noexcept;

  LoopCore& loop_;
  std::string name_;
  Duration give_up_after_;
  Health health_ = Health::ok;
  std::shared_ptr<Worker> worker_;
  mutable std::vector<std::shared_ptr<Worker>> behind_;
  std::vector<std::shared_ptr<LaneJob>> outstanding_;  // in order of submission
  bool needs_thread_ = false;                          // else a manual loop runs the jobs
  std::size_t handed_over_ = 0;                        // of these, the first so many are with the thread
  std::unique_ptr<Watchdog> watchdog_;
  std::unique_ptr<Delayed> delayed_;
  std::shared_ptr<bool> is_alive_ = std::make_shared<bool>(true);  // for calls during which `done` may destroy the lane
};

}  // namespace rtdata::detail
