// The exchange of a runtime with those of other loops: what they announce, what it wants of them, what is known of
// tiers.
#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "loop/core/priority_mutex.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::detail {

class Bridge;
class Channel;
struct Passage;
class RuntimeCore;
class TopicCore;

/// The sending side of a bridge announces each topic and origin before it sends anything of it.
struct Announcement {
  Bridge* bridge;
  Channel* channel;  ///< of a topic; null: its payload cannot cross
  Passage* passage;  ///< of one of its origins; null: the topic itself
  std::string name;
  PayloadType type;                       ///< of a topic
  std::vector<std::string> made_of = {};  ///< of an origin, once that is known
};

/// Thread: the loop's, but for `announce` and `forget`.
class Exchange {
 public:
  explicit Exchange(RuntimeCore& runtime) : runtime_(runtime) {}  // a deque allocates when it is made

  // Any thread
  /// The loop takes announcements in this order.
  void announce(Announcement announcement);
  void forget(const Bridge& of);

  void take_announcements();
  /// If the topic is cut off from another loop, and there is a subscriber here, keeps a report of it.
  void report_cut_off(TopicCore& topic);

  /// The main loop's: takes all that each tier has done up to one instant, and nothing after it. Returns what it cannot
  /// know of tiers that do not answer in time; empty: nothing.
  std::string catch_up(Duration at_most);
  /// The main loop's: what is not known now of tiers that a drain has given up, and that have not come out since;
  /// empty: all is known.
  std::string unknown() const;

  /// While one lives, other loops send events of these topics, whether or not anything here takes them: all that they
  /// publish after `catch_up` is there for a sink that attaches later.
  class Interest {
   public:
    Interest(RuntimeCore& runtime, const std::vector<std::string>& patterns);
    Interest(const Interest&) = delete;
    Interest& operator=(const Interest&) = delete;
    ~Interest();

   private:
    RuntimeCore& runtime_;
    const std::vector<std::string>& patterns_;
  };
  /// While one lives, other loops send all that they publish, and nothing of it is taken after its own `catch_up`: what
  /// sinks that are closed meanwhile do not have, those that are made have. The loop does not turn while one lives.
  class Standstill {
   public:
    explicit Standstill(RuntimeCore& runtime);
    Standstill(const Standstill&) = delete;
    Standstill& operator=(const Standstill&) = delete;
    ~Standstill();

   private:
    RuntimeCore& runtime_;
    const Interest all_;
  };
  bool stands_still() const noexcept { return standstill_.has_value(); }
  /// Since when a sink that is made at `now` has what other loops publish.
  Time begins_at(Time now) const noexcept { return standstill_ ? standstill_->time : now; }
  bool is_wanted(std::string_view topic) const noexcept;

  std::uint64_t lost = 0;  ///< events from other loops that were dropped: this loop could not make their topic, since
                           ///< its payload differs here, which was reported
  bool tiers_were_balanced = true;  ///< of the tiers that have ended
  bool tiers_had_loss = false;      ///< of the tiers that have ended

 private:
  RuntimeCore& runtime_;
  std::vector<const std::vector<std::string>*> wanted_;
  struct Instant {
    Time time;            // before it, so that nothing that is taken later was earlier
    std::string unknown;  // what its `catch_up` could not know
  };
  std::optional<Instant> standstill_;
  PriorityMutex announced_mutex_;
  std::vector<Announcement> announced_;
  std::atomic<bool> has_announced_{false};
  std::deque<Announcement> taken_;  // not heard yet: what hearing one of them throws leaves the others
};

}  // namespace rtdata::detail
