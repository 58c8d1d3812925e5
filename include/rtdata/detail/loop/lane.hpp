/// Lane: a loop's way to worker threads for blocking work: one for each sink and each physical device.
///
/// Jobs run one after the other, in order. Each job has a time limit, which starts when it runs. A job beyond its limit
/// is given up: its thread is abandoned, the waiting jobs continue on another thread, and `done` is called with
/// `given_up`. With `most_abandoned` abandoned threads the lane takes no job until one of them has returned. Lanes
/// run transactions, drivers and storage, never a user's callbacks.
///
/// The lanes of a loop's devices share a pool of threads: at most four for all devices that answer quickly, and one for
/// each device that is slow or hangs (docs/loop-and-time.md, "Lanes"). Jobs that are submitted while deadlines fire are
/// passed to the threads together, after the last deadline.
///
/// A bus has one thread for all loops: each loop has its own lane to it (`LaneThread`), jobs run in the order of
/// submission, and `done` is called on the loop that submitted the job. A lane made by an object for itself has its own
/// thread.
///
/// On a manual loop, a job has no thread: it runs at once, or, with some seeds, just before `done`. `done` is called
/// after the virtual duration of the job: the scripted time, plus its `lane_sleep` calls, plus a delay from the seed. A
/// job with a longer duration than its limit is given up at the limit.
///
/// Owner: the loop's `Lanes`, which find it by key, or the object that made it. The loop collects the finished jobs of
/// both. Thread: the loop's; only `LaneJob::run` is called on the lane's thread.
#pragma once

#include <atomic>
#include <cstddef>
#include <memory>
#include <string>

#include "rtdata/data/time.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata::detail {

class LanePool;
class LaneThread;
class LoopCore;
struct LaneListener;
struct LaneQueue;

/// The time for code that runs on a lane: the machine's, or on a manual loop the virtual time of the job.
MonotonicTime lane_now() noexcept;
/// Blocks the lane for `duration`; on a manual loop that much virtual time passes for the job.
void lane_sleep(Duration duration) noexcept;

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
  friend class LanePool;
  friend struct LaneQueue;
  enum State : int { idle, queued, running, finished, taken_away };
  /// On the lane's thread. False: the job must not run any more.
  bool begin(MonotonicTime now) noexcept;
  /// On the lane's thread. False: it was given up.
  bool end() noexcept;
  /// Takes it from the thread, unless it has finished. Returns what it was before.
  State withdraw() noexcept;

  std::atomic<int> state_{idle};
  std::atomic<std::int64_t> began_{0};  // ns of the monotonic clock; before, when it was submitted
  Duration limit_{0};
  std::shared_ptr<LaneJob> next_outstanding_;  // of the lane
  // On its way to a thread:
  LaneJob* next_ = nullptr;
  std::shared_ptr<LaneJob> self_;
  std::shared_ptr<LaneQueue> queue_;
  std::shared_ptr<LaneListener> listener_;
};

class Lane {
 public:
  static constexpr std::size_t most_abandoned = 4;
  /// `thread`: of a bus, or of the loop's pool; null: it has one of its own.
  Lane(LoopCore& loop, std::string name, Duration give_up_after, std::shared_ptr<LaneThread> thread = nullptr);
  /// Waits for the running job for at most its limit; jobs that wait are cancelled.
  ~Lane();

  /// False when no thread is left to run it. The job must not be submitted already.
  bool submit(std::shared_ptr<LaneJob> job) { return submit(std::move(job), give_up_after_); }
  bool submit(std::shared_ptr<LaneJob> job, Duration give_up_after);
  /// The number of abandoned threads that have not returned.
  std::size_t abandoned_threads() const noexcept;
  /// True if the maximum number of threads is abandoned: no job runs until one of them returns.
  bool is_stuck() const noexcept;
  /// True if the system refuses to create a thread.
  bool lacks_thread() const noexcept;
  /// True if it uses this thread.
  bool uses(const LaneThread& thread) const noexcept { return thread_.get() == &thread; }
  /// True if no other lane shares its thread and it has no jobs.
  bool is_deserted() const noexcept { return thread_.use_count() == 1 && first_ == nullptr; }
  /// Gives up the first job that has not finished, however long it has run.
  void give_up();
  /// Calls `done` of finished jobs. The loop does so when a worker has woken it. `done` may destroy the lane.
  void collect();
  /// Blocks until the first job has finished, but no longer than this, and calls its `done`. For closing only. On a
  /// manual loop, virtual time passes instead.
  void wait(Duration at_most);
  /// Abandons the thread with its running job and starts no new one.
  void abandon_thread() noexcept;

 private:
  friend class Lanes;
  struct Watchdog;
  struct Delayed;
  /// False if there is no new thread: too many are abandoned, or the system refuses to create one.
  bool start_thread() noexcept;
  /// Passes submitted jobs to the thread; while deadlines fire, after the last one.
  void hand_over();
  void check_limit();
  void watch_until(MonotonicTime due);
  void look_at_health(LaneJob::Outcome outcome, Duration limit);
  /// The reason: `why`, the limit, `what`.
  void set_health(Health now, const char* why, Duration limit, const char* what);
  void add(std::shared_ptr<LaneJob> job) noexcept;
  std::shared_ptr<LaneJob> remove_first() noexcept;
  /// The first.
  void finish(LaneJob::Outcome outcome);
  /// On a manual loop.
  void submit_in_virtual_time(std::shared_ptr<LaneJob> job);
  /// On a manual loop. Returns the virtual time that it has spent.
  Duration run_here(LaneJob& job, MonotonicTime now) noexcept;

  LoopCore& loop_;
  std::string name_;
  Duration give_up_after_;
  Health health_ = Health::ok;
  const bool is_shared_;  // with other loops
  const bool is_pooled_;
  bool is_thread_abandoned_ = false;
  std::shared_ptr<LaneThread> thread_;
  bool is_listed_ = false;          // the loop collects its finished jobs
  std::shared_ptr<LaneJob> first_;  // outstanding, in order of submission
  LaneJob* last_ = nullptr;
  Duration shortest_;  // shortest limit of all submitted jobs
  std::unique_ptr<Watchdog> watchdog_;
  std::unique_ptr<Delayed> delayed_;
  std::shared_ptr<bool> is_alive_ = std::make_shared<bool>(true);  // for calls during which `done` may destroy the lane
};

}  // namespace rtdata::detail
