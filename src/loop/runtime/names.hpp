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

/// Each runtime has one; that of the main loop keeps the names of all loops, under a lock that is taken at set-up only.
/// A name goes from loop to loop in three steps: its sensor stops; its loop announces all that is left to be said of it
/// (`BridgeSender::give_up`), then frees the name; another loop that claims it has heard that, and announces itself,
/// which the other loops hear after it. Thread: the loop's.
class Names {
 public:
  explicit Names(RuntimeCore& runtime) noexcept : runtime_(runtime) {}

  /// Claims the origin for one sensor or feed of this loop, which goes on where the last one of the name has ended.
  /// SetupError (bad-name, busy): the name is taken, on this loop or another, or was on another topic, or of another
  /// kind.
  OriginCore& claim(std::string_view name, TopicCore& topic, OriginCore::Supply supply);
  void release(OriginCore& origin) noexcept;
  /// Releases all of this loop, as when its tier ends.
  void release_all() noexcept;

 private:
  struct Claim {
    const RuntimeCore* holder = nullptr;
    std::string topic = {};
    std::unique_ptr<OriginCore::State> left = {};  // by the last holder
  };
  /// Notes that this loop holds the name. Returns what the last holder has left.
  OriginCore::State take(std::string_view name, const TopicCore& topic, OriginCore::Supply supply);
  /// The name of which no origin could be made.
  void give_back(std::string_view name) noexcept;

  RuntimeCore& runtime_;
  PriorityMutex mutex_;  // guards the main loop's claims
  std::unordered_map<std::string, Claim> claims_;
};

}  // namespace rtdata::detail
