// Takes the status of a running instance and answers status requests.
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

/// A histogram of times with a resolution of 1/8, and the exact maximum.
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

/// The growth rate of a count over the last 5 s, measured between two increases, so that one event a second always
/// gives 1 Hz.
class Pace {
 public:
  void add(std::uint64_t count, MonotonicTime at);
  /// The count increased to `count` at this time: begins here, without what was added before.
  void begin(std::uint64_t count, MonotonicTime at) { marks_.assign(1, {count, at}); }
  /// Empty: not known yet. `period`: how long the count may stay unchanged.
  std::optional<double> per_second(MonotonicTime now, Duration period = Duration{0}) const noexcept;

 private:
  struct Mark {
    std::uint64_t count;
    MonotonicTime at;
  };
  std::deque<Mark> marks_;
};

/// It subscribes to events (last values, lateness) only while a client watches, except for topics that seldom change,
/// so an unwatched instance has no cost. Thread: the loop's.
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
    /// Topics of alarms and outputs, which publish only changes: their last event is kept from the start.
    std::vector<std::string> changes = {};
    const Parts* made = nullptr;  ///< the parts with the machines; null: none. Must outlive this.
  };
  StatusSource(Loop& loop, Info info);
  /// Takes the data of a new configuration.
  void set(Info info);

  /// Takes the status, and watches for this client from now on until `forget`.
  Status take(std::uint64_t client);
  void forget(std::uint64_t client);
  /// Answers `{"request":"status"}` with the status, and anything else with {"error": why}. The returned function makes
  /// the text, one line without its end, on any thread, even after this object is destroyed.
  std::function<std::string()> answer(std::uint64_t client, std::string_view line);

 private:
  /// Data of a sensor while a client watches.
  struct Seen {
    std::vector<std::byte> payload;
    MonotonicTime came_at{}, first_came_at{};            // the last event, and the first that was seen
    std::uint64_t events = 0;                            // that were seen
    std::uint64_t readings_before = 0;                   // when it began to look
    std::uint64_t readings_taken = 0, events_taken = 0;  // when the status was taken last
    bool has_begun = false;                              // its pace is that between events
    Pace pace;
    Time first_due{};
    Duration period{0};
    TimeCounts now;                    // of this second
    std::optional<TimeCounts> before;  // of the one before it
  };
  /// The callback times of a tier, which only its own thread knows.
  struct AskedTier {
    std::string name;
    std::shared_ptr<const detail::CallbackSurvey> asked;     // may remain unanswered
    std::shared_ptr<const detail::CallbackSurvey> answered;  // the last answered request; null: none
  };
  void watch();
  void keep_changes();
  void add_seen(Status& status);
  /// When the last reading was, as far as it is known; `taken`: when the status was taken last.
  MonotonicTime last_reading(Seen& seen, std::uint64_t readings, MonotonicTime taken) const;
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
  std::map<std::string, std::vector<std::byte>, std::less<>> changes_;  // the last event of each origin
  std::vector<Subscription> change_subscriptions_;
};

}  // namespace rtdata::app
