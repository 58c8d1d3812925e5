// What runs the jobs of a lane: a thread of its own, that of a bus, or one of the loop's pool.
#pragma once

#include <sched.h>

#include <cstddef>
#include <memory>
#include <optional>

#include "loop/core/lane_pool.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::detail {

/// Owner: shared by the lanes that use it, and by the bus if it has one. Thread: those of the lanes' loops.
class LaneThread {
 public:
  /// Null: a thread of its own, which may serve several loops. Else one of these, for the lane of one loop.
  explicit LaneThread(std::shared_ptr<LanePool> pool = nullptr);

  const std::shared_ptr<LanePool>& pool() const noexcept { return pool_; }
  bool is_pooled() const noexcept { return !pool_->is_for_one_lane(); }
  void push(std::shared_ptr<LaneJob> job, std::shared_ptr<LaneListener> listener) noexcept {
    pool_->push(std::move(job), queue_, std::move(listener));
  }
  /// Makes sure that there is a thread. False: too many were left behind, or the system gives none.
  bool start(const void* runtime, const std::optional<cpu_set_t>& processors) noexcept {
    return !is_stuck() && pool_->start(runtime, processors);
  }
  bool has_thread() const noexcept { return pool_->has_thread(); }
  /// As many threads as may be are left behind.
  bool is_stuck() const noexcept;
  /// Of a thread that hangs in a job which was taken from it (LaneJob::take_away): the next start makes a fresh one.
  void leave_behind() noexcept { pool_->leave_behind(*queue_); }
  /// Threads that hang still in jobs of this lane.
  std::size_t left_behind() const noexcept;

  /// In virtual time, where the job runs on the loop that submits it: when the last one will be done.
  MonotonicTime free_from{};

 private:
  const std::shared_ptr<LanePool> pool_;
  const std::shared_ptr<LaneQueue> queue_ = std::make_shared<LaneQueue>();
};

/// The time on a lane: the machine's, or on a manual loop that which has passed for the job.
class LaneClock {
 public:
  /// In virtual time: from here until it is destroyed, this thread is a lane on which it is `now`.
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
