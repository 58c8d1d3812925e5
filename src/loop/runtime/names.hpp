// The names of sensors and feeds of a run: which loop each belongs to.
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

/// Each runtime has one; that of the main loop keeps the names of all loops, under a lock that is taken at set-up only.
/// A name belongs to the loop that claimed it first, until the end of the run; to a tier that has ended: to one of the
/// same name that is made again. Thread: the loop's.
class Names {
 public:
  explicit Names(RuntimeCore& runtime) noexcept : runtime_(runtime) {}

  /// Claims the origin for one sensor or feed of this loop, which goes on where the last one of the name has ended.
  /// SetupError (bad-name, busy): the name is taken, or was on another loop, on another topic, or of another kind.
  OriginCore& claim(std::string_view name, TopicCore& topic, OriginCore::Supply supply);
  void release(OriginCore& origin) noexcept;
  /// Of a tier that ends.
  void release_all() noexcept;

  struct Published {
    std::string topic = {};  ///< empty: nothing of this name was in this run
    std::string tier = {};   ///< empty: on the main loop
  };
  Published published(std::string_view name) const;

 private:
  struct Claim {
    Published where = {};
    bool is_there = false;                         // a sensor or feed
    std::unique_ptr<OriginCore::State> left = {};  // by a tier that has ended
  };
  /// Notes that this loop has the name. Returns where it goes on.
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
