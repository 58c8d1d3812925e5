// A flag that one thread sets and others wait for.
#pragma once

#include <algorithm>
#include <condition_variable>
#include <mutex>

#include "loop/core/priority_mutex.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::detail {

class Latch {
 public:
  void set() noexcept {
    const std::lock_guard lock(mutex_);
    is_set_ = true;
    signal_.notify_all();  // under the lock: a waiting thread may destroy the latch
  }
  void clear() noexcept {
    const std::lock_guard lock(mutex_);
    is_set_ = false;
  }
  bool is_set() const noexcept {
    const std::lock_guard lock(mutex_);
    return is_set_;
  }
  /// Waits until it is set, at most `at_most`. Returns true if it is set.
  bool wait(Duration at_most) const noexcept {
    std::unique_lock lock(mutex_);
    constexpr Duration longest = std::chrono::hours{24 * 365};  // must not overflow when added to the present time
    return signal_.wait_for(lock, std::min(at_most, longest), [this] { return is_set_; });
  }

 private:
  mutable PriorityMutex mutex_;
  mutable std::condition_variable_any signal_;
  bool is_set_ = false;
};

}  // namespace rtdata::detail
