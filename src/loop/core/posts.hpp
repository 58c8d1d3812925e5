// The functions passed to Loop::post: queued by any thread, run by the loop's thread.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "loop/core/priority_mutex.hpp"
#include "rtdata/loop/callback.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata::detail {

class LoopCore;

class Posts {
 public:
  explicit Posts(LoopCore& loop) noexcept : loop_(loop) {}

  // Any thread
  void add(Callback<void()> function);
  PostCounts counts() noexcept;

  // The loop's thread
  /// Runs the functions waiting at its start, but ends early after `end` or when a deadline is due. True: some are
  /// left; the loop is woken for another call.
  bool run(MonotonicTime end);
  bool has_some() noexcept;
  /// Runs all functions posted before the call, without regard to deadlines, until `end`. Returns how many are left.
  std::uint64_t run_all(MonotonicTime end);
  /// Takes no more, and destroys those that wait.
  void drop() noexcept;

 private:
  void take();
  /// Runs those taken. False: it ended early.
  bool run_taken(MonotonicTime begin, MonotonicTime end);

  LoopCore& loop_;
  PriorityMutex mutex_;
  std::vector<Callback<void()>> waiting_;  // guarded by the mutex, as the next
  bool takes_more_ = true;
  std::atomic<bool> is_any_waiting_{false};  // read without it
  std::uint64_t posted_ = 0;
  std::uint64_t most_waiting_ = 0;
  std::atomic<std::uint64_t> run_{0};
  std::vector<Callback<void()>> taken_;  // the loop's thread's
  std::size_t next_ = 0;                 // index of the next function among those taken
};

}  // namespace rtdata::detail
