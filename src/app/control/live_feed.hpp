// Copies of the events published now, for the thread of the readers.
#pragma once

#include <atomic>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "app/control/event_ring.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::app {

/// True if all topics that match the pattern `inner` also match `outer`.
bool covers(std::string_view outer, std::string_view inner) noexcept;

/// The side of the main loop. While nobody reads it subscribes to nothing. An event costs this loop a copy, however
/// many read it; one without room is skipped, and counted with the next of its origin, or when the
/// readers ask.
///
/// Owner: the program; the ring is shared with the readers, who may be late. Thread: the loop's.
class LiveFeed {
 public:
  struct Ring : EventRing {
    std::atomic<bool> has_lost{false};  ///< an event had no room, and this is not reported yet
    /// The descriptions of all its events: a topic may be gone, and the program may end, before the readers come to its
    /// events. The loop's side only.
    std::unordered_map<const Description*, std::shared_ptr<const Description>> descriptions = {};
  };

  explicit LiveFeed(Loop& loop) : loop_(loop) {}

  /// From now on it also copies these topics, until `end`.
  void bring(const std::string& pattern);
  void end();
  /// Puts a mark after the events up to now. False: there is no room.
  bool mark(std::uint64_t number);
  /// Reports events without room, as far as there is room now.
  void tell_lost();
  const std::shared_ptr<Ring>& ring() const noexcept { return ring_; }

 private:
  void take(const EventView& event);
  void keep(const Description& description);

  Loop& loop_;
  std::shared_ptr<Ring> ring_ = std::make_shared<Ring>();
  std::map<std::string, Subscription> subscriptions_;  // by pattern
  const Description* last_ = nullptr;                  // that was looked for among those of the ring
  struct Lost {
    std::string topic, origin;
    Time time{};
    std::uint64_t sequence = 0;  // of the last one
  };
  std::map<std::string, Lost, std::less<>> lost_;  // by topic and origin
};

}  // namespace rtdata::app
