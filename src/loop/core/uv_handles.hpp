// The libuv handles of a loop: its timer, its wake-up, the end of each turn, and the notice that the time of day was
// set.
#pragma once

#include <uv.h>

#include "loop/core/wake.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::detail {

class LoopCore;

/// The handles call `run_due`, `woken`, `turn_ended` and `clock_was_set` of the loop, on its thread.
class UvHandles {
 public:
  /// Uses `host`; null: its own uv_loop_t. SetupError.
  UvHandles(LoopCore& core, uv_loop_t* host);
  UvHandles(const UvHandles&) = delete;
  UvHandles& operator=(const UvHandles&) = delete;
  ~UvHandles();

  uv_loop_t* loop() noexcept { return loop_; }
  /// For handles of others on it.
  uv_loop_t* lend() noexcept {
    is_lent_ = true;
    return loop_;
  }
  /// True if others may have handles on it.
  bool is_lent() const noexcept { return is_lent_ || is_attached(); }
  bool is_attached() const noexcept { return loop_ != &own_loop_; }
  Wake& wake() noexcept;

  /// Arms the timer for this time of CLOCK_MONOTONIC; 0: never.
  void arm(MonotonicTime due) noexcept;
  /// Calls `clock_was_set` from now on. Does nothing if the kernel does not notify or no descriptor is free.
  void watch_clock();
  /// libuv does not wait until `allow_sleep`.
  void forbid_sleep() noexcept;
  void allow_sleep() noexcept;
  /// libuv's run continues until `unref`.
  void ref() noexcept;
  void unref() noexcept;

 private:
  struct Memory;
  void make_memory(LoopCore& core);

  uv_loop_t own_loop_{};
  uv_loop_t* loop_;
  Memory* memory_ = nullptr;
  bool is_lent_ = false;
};

}  // namespace rtdata::detail
