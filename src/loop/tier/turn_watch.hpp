// Checks that loops on other threads turn, for a loop that uses topics of theirs which publish only changes.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include "loop/core/loop_core.hpp"

namespace rtdata::detail {

/// Owner: the follower; thread: its loop's. The loops passed to it must exist at that time.
class TurnWatch {
 public:
  /// Asks each loop again that has answered. Returns the first that has not answered for `limit`; null: all turn.
  const LoopCore* look(const std::vector<LoopCore*>& loops, MonotonicTime now, Duration limit) {
    const LoopCore* hanging = nullptr;
    std::erase_if(asked_,
                  [&](const Asked& one) { return std::find(loops.begin(), loops.end(), one.loop) == loops.end(); });
    for (LoopCore* const loop : loops) {
      auto known = std::find_if(asked_.begin(), asked_.end(), [&](const Asked& one) { return one.loop == loop; });
      if (known == asked_.end()) {
        asked_.push_back({loop, std::make_shared<std::atomic<bool>>(true), now});
        known = asked_.end() - 1;
      }
      if (known->has_answered->load(std::memory_order_acquire)) {
        known->has_answered->store(false, std::memory_order_relaxed);
        known->at = now;
        loop->post([answer = known->has_answered] { answer->store(true, std::memory_order_release); });
      } else if (now - known->at >= limit && hanging == nullptr) {
        hanging = loop;
      }
    }
    return hanging;
  }

 private:
  struct Asked {
    LoopCore* loop;
    std::shared_ptr<std::atomic<bool>> has_answered;  // shared with that loop, which may be late
    MonotonicTime at;
  };
  std::vector<Asked> asked_;
};

}  // namespace rtdata::detail
