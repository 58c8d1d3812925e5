// Limits how many changes of one object are reported singly (a token bucket): 16 in a row, and one more each minute.
// The caller joins the others.
#pragma once

#include <algorithm>
#include <chrono>

#include "data/saturating.hpp"

namespace rtdata::detail {

class Allowance {
 public:
  static constexpr unsigned most = 16;
  static constexpr Duration regained_after = std::chrono::minutes{1};

  /// `now`: the time since an epoch of the caller's choice, which must be the same in all calls.
  bool has_some(Duration now) noexcept {
    const Duration passed = span_between(MonotonicTime{since_}, MonotonicTime{now});
    if (left_ < most && passed >= regained_after) {
      const auto regained = passed / regained_after;
      left_ = regained >= most - left_ ? most : left_ + static_cast<unsigned>(regained);
      since_ += regained * regained_after;
    }
    return left_ > 0;
  }
  /// When the next change may be reported singly, if none is spent until then.
  Duration has_some_from() const noexcept {
    return left_ > 0 ? since_ : later(MonotonicTime{since_}, regained_after).time_since_epoch();
  }
  bool is_whole() const noexcept { return left_ == most; }
  void spend(Duration now) noexcept {
    if (left_ == most) since_ = now;
    if (left_ > 0) --left_;
  }

 private:
  unsigned left_ = most;
  Duration since_{0};  // when the last one was regained
};

}  // namespace rtdata::detail
