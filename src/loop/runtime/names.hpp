// The names of sensors and feeds of a run, with their loops.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <unordered_map>

#include "loop/core/priority_mutex.hpp"
#include "loop/events/origin_core.hpp"

namespace rtdata::detail {

class RuntimeCore;

/// Each runtime has one; the main loop's has the names of all loops, under a lock that is only taken during set-up. A
/// name belongs to the loop that claimed it first, until the end of the run; if a tier ends, to a new tier of the same
/// name. Thread: the loop's.
class Names {
 public:
  explicit Names(RuntimeCore& runtime) noexcept : runtime_(runtime) {}

  /// Claims the origin for a sensor or feed of this loop, which continues after the last one of the name. SetupError
  /// (bad-name, busy): the name is taken, or was on another loop or topic, or of another kind.
  OriginCore& claim(std::string_view name, TopicCore& topic, OriginCore::Supply supply);
  void release(OriginCore& origin) noexcept;
  /// Releases the names of a tier that ends.
  void release_all() noexcept;

  struct Published {
    std::string topic = {};  ///< empty: not used in this run
    std::string tier = {};   ///< empty: on the main loop
  };
  Published published(std::string_view name) const;

 private:
  struct Claim {
    Published where = {};
    bool is_there = false;                         // a sensor or feed
    std::unique_ptr<OriginCore::State> left = {};  // by a tier that has ended
  };
  /// Notes that this loop has the name. Returns the state to continue from.
  OriginCore::State take(std::string_view name, const TopicCore& topic, OriginCore::Supply supply);

  RuntimeCore& runtime_;
  PriorityMutex mutex_;  // guards the main loop's claims
  struct Hash {
    using is_transparent = void;
    std::size_t operator()(std::string_view name) const noexcept { return std::hash<std::string_view>()(name); }
  };
  std::unordered_map<std::string, Claim, Hash, std::equal_to<>> claims_;
};

}  // namespace rtdata::detail
