// Takes the status of a running instance, and answers who asks for it.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "app/control/status.hpp"
#include "rtdata/config/parts.hpp"
#include "rtdata/io/bus.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::detail {
class CallbackSurvey;
}

namespace rtdata::app {

/// Counts of times, each within 1/8 of itself, and the largest as it was.
class TimeCounts {
 public:
  void add(Duration time) noexcept;
  std::uint64_t total() const noexcept { return total_; }
  Duration largest() const noexcept { return largest_; }
  Duration percentile(double fraction) const noexcept;
  void add(const TimeCounts& other) noexcept;

 private:
  std::vector<std::uint32_t> counts_ = std::vector<std::uint32_t>(496);
  std::uint64_t total_ = 0;
  Duration largest_{0};
};

/// How fast a count grows, over the last 5 s: from one instant at which it was higher to another, so that what comes
/// once a second has a rate of 1 Hz whenever it is looked at.
class Pace {
 public:
  void add(std::uint64_t count, MonotonicTime at);
  /// None: not known yet.
  std::optional<double> per_second(MonotonicTime now) const noexcept;

 private:
  struct Mark {
    std::uint64_t count;
    MonotonicTime at;
  };
  std::deque<Mark> marks_;
};

/// What it must see of events (last values, lateness) it looks at only while somebody watches, but for what changes
/// seldom: an instance at which nobody looks pays nothing. Thread: the loop's.
class StatusSource {
 public:
  struct Info {
    std::string name;           ///< of the set-up
    std::string configuration;  ///< path of its file
    std::map<std::string, std::string> sink_paths = {};
    struct Part : Status::Part {
      const Bus* bus = nullptr;  ///< if it is one; lives until the next `set`
    };
    std::vector<Part> parts = {};
    /// Of alarms and outputs, which bring an event only when something changes: the last one is kept from the start.
    std::vector<std::string> changes = {};
    const Parts* made = nullptr;  ///< where the machines are; null: there are none. Outlives this.
  };
  StatusSource(Loop& loop, Info info);
  /// Another configuration.
  void set(Info info);

  /// From here on it watches, for this client, until that is forgotten.
  Status take(std::uint64_t client);
  void forget(std::uint64_t client);
  /// `{"request":"status"}` gives the status; anything else {"error": why}, also a command whose words are none. What
  /// is returned makes the text, one line without its end, on any thread, also when this object is gone.
  std::function<std::string()> answer(std::uint64_t client, std::string_view line);

 private:
  /// Of a sensor, while somebody watches.
  struct Seen {
    std::vector<std::byte> payload;
    MonotonicTime came_at{};
    Pace pace;
    Time first_due{};
    Duration period{0};
    TimeCounts now;                    // of this second
    std::optional<TimeCounts> before;  // of the one before it
  };
  /// What a tier's callbacks took, which only its own thread knows.
  struct AskedTier {
    std::string name;
    std::shared_ptr<const detail::CallbackSurvey> asked;     // perhaps never answered
    std::shared_ptr<const detail::CallbackSurvey> answered;  // the last that was; null: none
  };
  void watch();
  void keep_changes();
  void add_seen(Status& status);
  void add_machines(Status& status) const;
  void add_callbacks(Status& status);

  Loop& loop_;
  Info info_;
  Time started_;
  MonotonicTime started_at_;
  std::set<std::uint64_t> clients_;
  std::map<std::string, Seen, std::less<>> seen_;
  std::map<std::string, Pace, std::less<>> loads_;  // processor time of loops, in ns
  std::vector<AskedTier> tiers_;
  MonotonicTime turned_{}, taken_{};
  Subscription subscription_;
  std::map<std::string, std::vector<std::byte>, std::less<>> changes_;  // the last of each origin
  std::vector<Subscription> change_subscriptions_;
};

}  // namespace rtdata::app
