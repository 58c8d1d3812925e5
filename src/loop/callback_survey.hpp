// What the callbacks of a tier took, gathered while it runs.
#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "loop/latch.hpp"
#include "rtdata/loop/loop.hpp"

namespace rtdata::detail {

class LoopCore;
class Node;

/// Goes through a loop's objects on its thread, a few in a turn, so that nothing there waits for it. Asked for and
/// waited for on any thread; a loop that hangs never finishes it.
class CallbackSurvey {
 public:
  static constexpr std::size_t most_in_turn = 16;
  static std::shared_ptr<CallbackSurvey> begin(LoopCore& loop);

  bool is_done() const noexcept { return done_.is_set(); }
  bool wait(Duration at_most) const noexcept { return done_.wait(at_most); }
  /// Those that were called, in the order in which they were made. Once it is done.
  const std::vector<CallbackStatus>& callbacks() const noexcept { return callbacks_; }

 private:
  friend class LoopCore;
  Node* next_ = nullptr;  // moved on by the loop when that node goes
  std::vector<CallbackStatus> callbacks_;
  Latch done_;
};

}  // namespace rtdata::detail
