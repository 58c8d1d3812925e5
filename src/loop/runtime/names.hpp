// The names of sensors and feeds of a run: which loop holds each, and the account that its last holder left.
#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <unordered_map>

#include "loop/events/origin_core.hpp"
#include "loop/support/priority_mutex.hpp"

namespace rtdata::detail {

class RuntimeCore;

/// Each runtime has one. As soon as there are tiers, that of the main loop keeps the names of all loops, under a lock; before,
/// the origins know which of them are claimed. Thread: the loop's.
class Names {
 public:
  explicit Names(RuntimeCore& runtime) noexcept : runtime_(runtime) {}

  /// Claims the origin for one sensor or feed of this loop. One that another loop has released goes on here. SetupError
  /// (bad-name, busy): the name is taken, on this loop or another, or was on another topic, or of another kind.
  OriginCore& claim(std::string_view name, TopicCore& topic, OriginCore::Supply supply);
  void release(OriginCore& origin) noexcept;
  /// Releases all of this loop, as when its tier ends.
  void release_all() noexcept;
  /// The main loop's gets a tier: from here on names are kept for all loops.
  void share();

 private:
  struct Claim {
    struct Left {
      std::string topic;
      OriginCore::State state;
    };
    const RuntimeCore* holder = nullptr;
    std::unique_ptr<Left> left;  // by the last holder
  };
  void release(std::string_view name, Claim& claim) noexcept;

  RuntimeCore& runtime_;
  bool is_shared_ = false;  // the main loop's, as the next
  PriorityMutex mutex_;     // taken at set-up only
  std::unordered_map<std::string, Claim> claims_;
};

}  // namespace rtdata::detail
