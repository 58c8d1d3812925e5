// What a running instance tells of itself, as JSON.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/topic.hpp"

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
/// only while somebody asks: an instance that nobody watches pays nothing. Thread: the loop's.
class StatusSource {
 public:
  struct Info {
    std::string name;           ///< of the set-up
    std::string configuration;  ///< path of its file
    std::map<std::string, std::string> sink_paths = {};
  };
  StatusSource(Loop& loop, Info info);

  /// `{"request":"status"}` gives the status; anything else {"error": why}. One line, without its end.
  std::string answer(std::uint64_t client, std::string_view line);
  /// The client has gone.
  void forget(std::uint64_t client);

 private:
  /// What was seen of a sensor's events while somebody watches.
  struct Seen {
    std::vector<std::byte> payload;
    const Description* description = nullptr;  // the runtime's topic keeps it alive
    Time first_due{};
    Duration period{0};
    TimeCounts now, before;  // of this second, and of the one before it
  };
  /// How things stood when a client asked last; rates are from then on.
  struct Baseline {
    MonotonicTime at{};
    std::map<std::string, std::uint64_t> events;  // by sensor
    std::map<std::string, Duration> processor;    // by loop
  };
  std::string status(std::uint64_t client);
  void begin_watching();
  void take_schedules(const std::vector<SensorStatus>& sensors);

  Loop& loop_;
  Info info_;
  Time started_;
  MonotonicTime started_at_;
  std::map<std::uint64_t, Baseline> clients_;
  std::map<std::string, Seen, std::less<>> seen_;
  MonotonicTime turned_{};
  Subscription subscription_;
};

}  // namespace rtdata::app
