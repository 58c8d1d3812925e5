// The exchange of a runtime with other loops: their announcements, its own interests, and the state of tiers.
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

/// The sending side of a bridge announces each topic and origin before its first data.
struct Announcement {
  Bridge* bridge;
  Channel* channel;  ///< of a topic; null: its payload cannot cross loops
  Passage* passage;  ///< of one of its origins; null: the topic itself
  std::string name;
  PayloadType type;                       ///< of a topic
  std::vector<std::string> made_of = {};  ///< of an origin, once that is known
};

/// Thread: the loop's, except `announce` and `forget`.
class Exchange {
 public:
  explicit Exchange(RuntimeCore& runtime) : runtime_(runtime) {}  // a deque allocates when it is made

  // Any thread
  /// The loop takes announcements in order.
  void announce(Announcement announcement);
  void forget(const Bridge& of);

  void take_announcements();
  /// Keeps a report if the topic is cut off from another loop and has a subscriber here.
  void report_cut_off(TopicCore& topic);

  /// Main loop only: takes all data of each tier up to one instant, and nothing later. Returns the missing data of
  /// tiers that do not answer in time; empty: complete.
  std::string catch_up(Duration at_most);
  /// Main loop only: the missing data of tiers that a drain has given up and that have not returned since; empty:
  /// complete.
  std::string unknown() const;

  /// While it lives, other loops send events of these topics even without a subscriber here, so that a sink attached
  /// later has all events published after `catch_up`.
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
  /// While it lives, other loops send all events, and none is taken after its own `catch_up`: events that the closed
  /// sinks do not have go to the new sinks. The loop does not turn meanwhile.
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
  /// The time from which a sink made at `now` has the events of other loops.
  Time begins_at(Time now) const noexcept { return standstill_ ? standstill_->time : now; }
  bool is_wanted(std::string_view topic) const noexcept;

  std::uint64_t lost = 0;           ///< dropped events from other loops: this loop could not make their topic, because
                                    ///< its payload differs here, which was reported
  bool tiers_were_balanced = true;  ///< of the tiers that have ended
  bool tiers_had_loss = false;      ///< of the tiers that have ended

 private:
  RuntimeCore& runtime_;
  std::vector<const std::vector<std::string>*> wanted_;
  struct Instant {
    Time time;            // time before it, so that no later data is older
    std::string unknown;  // data that its `catch_up` could not get
  };
  std::optional<Instant> standstill_;
  PriorityMutex announced_mutex_;
  std::vector<Announcement> announced_;
  std::atomic<bool> has_announced_{false};
  std::deque<Announcement> taken_;  // not processed yet; an exception leaves the others in it
};

}  // namespace rtdata::detail
