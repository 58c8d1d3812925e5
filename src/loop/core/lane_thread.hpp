// The thread of a lane, with the jobs on their way to it: of the one loop whose lane it is, or of all loops that use a
// bus.
#pragma once

#include <sched.h>
#include <semaphore.h>

#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <memory>
#include <optional>
#include <vector>

#include "loop/support/priority_mutex.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::detail {

class LaneJob;
class Wake;

/// How the thread tells a lane that one of its jobs has ended. Shared with threads, which may be left behind.
struct LaneListener {
  PriorityMutex mutex;
  std::condition_variable_any job_ended;
  Wake* loop_wake = nullptr;  // guarded by the mutex; null once the lane does not listen any more

  void stop_listening() noexcept;
};

/// Owner: shared by the lanes that use it, and by the bus if it has one. Thread: those of the lanes' loops.
class LaneThread {
 public:
  /// Takes so many jobs at a time.
  explicit LaneThread(std::size_t room);
  LaneThread(const LaneThread&) = delete;
  LaneThread& operator=(const LaneThread&) = delete;
  /// No lane uses it any more: its thread ends.
  ~LaneThread();

  /// Behind all that were pushed before, whichever loop did so. Never waits, allocates nothing. False: there is
  /// no room now.
  bool push(std::shared_ptr<LaneJob> job, std::shared_ptr<LaneListener> listener) noexcept;
  /// Makes sure that there is a thread. False: too many were left behind, or the system gives none.
  bool start(const void* runtime, const std::optional<cpu_set_t>& processors, std::size_t most_left_behind) noexcept;
  bool has_thread() const noexcept;
  /// Of a thread that hangs in a job which was taken from it (LaneJob::give_up): the next start makes a fresh one.
  void leave_behind() noexcept;
  /// Threads that hang still.
  std::size_t left_behind() const noexcept;

  /// In virtual time, where the job runs on the loop that submits it: when the last one will be done.
  MonotonicTime free_from{};

 private:
  struct State;
  std::shared_ptr<State> state_;
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
