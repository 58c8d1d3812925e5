// What a running instance tells of itself, as JSON.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/config/parts.hpp"
#include "rtdata/io/bus.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
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

/// Answers the requests of the control socket. What it must see of events for that (last values, lateness) it looks at
/// only while a client asks, but for what changes seldom: an instance without clients pays nothing. On the loop it
/// copies how things stand; the text is made of that elsewhere. Thread: the loop's.
class StatusSource {
 public:
  struct Info {
    std::string name;           ///< of the set-up
    std::string configuration;  ///< path of its file
    std::map<std::string, std::string> sink_paths = {};
    /// Of kinds that have no status of their own, such as buses.
    struct Part {
      std::string kind, name, type;
      std::vector<std::string> users;  ///< "sensor chamber"
      const Bus* bus = nullptr;        ///< if it is one; lives until the next `set`
    };
    std::vector<Part> parts = {};
    /// Of alarms and outputs, which bring an event only when something changes: the last one is kept from the start.
    std::vector<std::string> changes = {};
    const Parts* made = nullptr;  ///< where the machines are; null: there are none. Outlives this.
  };
  StatusSource(Loop& loop, Info info);
  /// Another configuration.
  void set(Info info);

  /// `{"request":"status"}` gives the status; anything else {"error": why}, also a command whose words are none. What
  /// is returned makes the text, one line without its end, on any thread, also when this object is gone.
  std::function<std::string()> answer(std::uint64_t client, std::string_view line);
  /// The client has gone.
  void forget(std::uint64_t client);

 private:
  /// The last events of a sensor, while there are clients.
  struct Seen {
    std::vector<std::byte> payload;
    Time first_due{};
    Duration period{0};
    TimeCounts now;                            // of this second
    std::shared_ptr<const TimeCounts> before;  // of the one before it
  };
  struct SeenSensor {
    std::vector<std::byte> payload;  // empty: none yet
    std::shared_ptr<const TimeCounts> lateness;
  };
  /// What a tier's callbacks took, which only its own thread knows.
  struct AskedTier {
    std::string name;
    std::string doing;                                       // the callback that it began last
    std::shared_ptr<const detail::CallbackSurvey> asked;     // perhaps never answered
    std::shared_ptr<const detail::CallbackSurvey> answered;  // the last that was; null: none
  };
  /// How things stood when a client asked.
  struct Snapshot {
    std::shared_ptr<const Info> info;
    std::vector<std::vector<PlaceCounts>> places;  // beside the parts of `info`
    Time started{};
    Duration running_for{0};
    MonotonicTime at{};
    std::vector<SensorStatus> sensors;
    std::vector<SeenSensor> seen;  // beside `sensors`
    std::vector<LoopStatus> loops;
    std::vector<SinkStatus> sinks;
    std::vector<std::optional<std::string>> closed_paths;  // beside the first of `sinks`
    std::vector<TopicStatus> topics;
    struct MachineState {
      std::string state;
      Duration in_state{0};
    };
    std::map<std::string, MachineState, std::less<>> machines;
    std::vector<CallbackStatus> callbacks;  // of this loop
    std::string callbacks_loop;
    std::vector<AskedTier> tiers;
  };
  /// What is answered to a request that asks for no status.
  static std::optional<std::string> refusal_of(std::string_view line);
  /// Rates are from `before` on, if there is one.
  static std::string text(const Snapshot& now, const Snapshot* before);
  std::shared_ptr<const Snapshot> take();
  void begin_watching();
  void ask_tiers(Snapshot& shot);
  void keep_changes();
  void take_schedules(const std::vector<SensorStatus>& sensors);

  Loop& loop_;
  std::shared_ptr<const Info> info_;
  Time started_;
  MonotonicTime started_at_;
  std::map<std::uint64_t, std::shared_ptr<const Snapshot>> clients_;  // the last one of each
  std::map<std::string, Seen, std::less<>> seen_;
  std::vector<AskedTier> tiers_;
  MonotonicTime turned_{};
  Subscription subscription_;
  std::map<std::string, std::vector<std::byte>, std::less<>> changes_;  // the last of each origin
  std::vector<Subscription> change_subscriptions_;
};

}  // namespace rtdata::app
