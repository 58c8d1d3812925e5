// Collects the callback times of a tier while it runs.
#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "loop/core/latch.hpp"
#include "rtdata/loop/loop.hpp"

namespace rtdata::detail {

class Node;
class Nodes;

/// The loop visits its objects on its own thread, a few in each turn, so that it is not held. Any thread may request a
/// survey (`Nodes::begin_survey`) and wait for it; a hanging loop never finishes it.
class CallbackSurvey {
 public:
  static constexpr std::size_t most_in_turn = 16;

  bool is_done() const noexcept { return done_.is_set(); }
  bool wait(Duration at_most) const noexcept { return done_.wait(at_most); }
  /// The callbacks that were called, in the order in which they were made. Only after the survey.
  const std::vector<CallbackStatus>& callbacks() const noexcept { return callbacks_; }

 private:
  friend class Nodes;
  Node* next_ = nullptr;  // the loop advances it when that node is destroyed
  std::vector<CallbackStatus> callbacks_;
  Latch done_;
};

}  // namespace rtdata::detail
