// Runs the jobs of a lane: its own thread, the thread of a bus, or the loop's pool.
#pragma once

#include <sched.h>

#include <cstddef>
#include <memory>
#include <optional>

#include "loop/core/lane_pool.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::detail {

/// Owner: shared by the lanes that use it, and by the bus if there is one. Thread: those of the lanes' loops.
class LaneThread {
 public:
  /// Null: its own thread, which may serve several loops. Otherwise a thread of the pool, for the lane of one loop.
  explicit LaneThread(std::shared_ptr<LanePool> pool = nullptr);

  const std::shared_ptr<LanePool>& pool() const noexcept { return pool_; }
  bool is_pooled() const noexcept { return !pool_->is_for_one_lane(); }
  void push(std::shared_ptr<LaneJob> job, std::shared_ptr<LaneListener> listener) noexcept {
    pool_->push(std::move(job), queue_, std::move(listener));
  }
  /// Makes sure that there is a thread. False: too many are abandoned, or the system refuses to create one.
  bool start(const void* runtime, const std::optional<cpu_set_t>& processors) noexcept {
    return !is_stuck() && pool_->start(runtime, processors);
  }
  bool has_thread() const noexcept { return pool_->has_thread(); }
  /// True if the maximum number of threads is abandoned.
  bool is_stuck() const noexcept;
  /// Abandons a thread that hangs in a job which was taken from it (LaneJob::withdraw): the next start makes a new
  /// one.
  void abandon_thread() noexcept { pool_->abandon_thread(*queue_); }
  /// The number of threads that still hang in jobs of this lane.
  std::size_t abandoned_threads() const noexcept;

  /// In virtual time, where jobs run on the submitting loop: when the last job will be done.
  MonotonicTime free_from{};

 private:
  const std::shared_ptr<LanePool> pool_;
  const std::shared_ptr<LaneQueue> queue_ = std::make_shared<LaneQueue>();
};

/// The time on a lane: real time, or on a manual loop the virtual time of the job.
class LaneClock {
 public:
  /// In virtual time: until it is destroyed, this thread acts as a lane at time `now`.
  explicit LaneClock(MonotonicTime now) noexcept;
  LaneClock(const LaneClock&) = delete;
  LaneClock& operator=(const LaneClock&) = delete;
  ~LaneClock();
  Duration spent() const noexcept { return now_ - began_; }

 private:
  friend MonotonicTime lane_now() noexcept;
  friend void lane_sleep(Duration duration) noexcept;
  const MonotonicTime began_;
  MonotonicTime now_;
};

}  // namespace rtdata::detail
