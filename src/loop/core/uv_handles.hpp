// The libuv handles of a loop: its timer, its wake-up, the end of each turn, and the notice that the time of day was
// set.
#pragma once

#include <uv.h>

#include "loop/core/wake.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::detail {

class LoopCore;

/// They call `run_due`, `woken`, `turn_ended` and `clock_was_set` of the loop, on its thread.
class UvHandles {
 public:
  /// On `host`; null: on a uv_loop_t of its own. SetupError.
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
  /// Others may have handles on it.
  bool is_lent() const noexcept { return is_lent_ || is_attached(); }
  bool is_attached() const noexcept { return loop_ != &own_loop_; }
  Wake& wake() noexcept;

  /// The timer expires at this instant of CLOCK_MONOTONIC; 0: never.
  void arm(MonotonicTime due) noexcept;
  /// From here on `clock_was_set` is called. Without it, where the kernel does not tell, or no descriptor is left.
  void watch_clock();
  /// Until `allow_sleep`, polls of libuv return at once.
  void forbid_sleep() noexcept;
  void allow_sleep() noexcept;
  /// libuv's run goes on until `unref`.
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
