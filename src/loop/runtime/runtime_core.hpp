// The core of a Runtime: the topics, origins and other objects of one loop.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <unordered_map>
#include <unordered_set>
#include <utility>
#include <vector>

#include "loop/core/placed_list.hpp"
#include "loop/events/listener.hpp"
#include "loop/events/origin_core.hpp"
#include "loop/events/sensor_entry.hpp"
#include "loop/events/topic_core.hpp"
#include "loop/runtime/clock_log.hpp"
#include "loop/runtime/configurations.hpp"
#include "loop/runtime/exchange.hpp"
#include "loop/runtime/names.hpp"
#include "loop/runtime/reports.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata {

struct RunReport;

namespace detail {

class TierCore;

/// Origins are found by their names.
struct ByName {
  using is_transparent = void;
  static std::string_view name(std::string_view name) noexcept { return name; }
  static std::string_view name(const OriginCore& origin) noexcept { return origin.name; }
  std::size_t operator()(const auto& one) const noexcept { return std::hash<std::string_view>{}(name(one)); }
  bool operator()(const auto& a, const auto& b) const noexcept { return name(a) == name(b); }
};

/// The name of a payload in errors: of its description or its C++ type.
std::string payload_name(const PayloadType& type);
/// The error for a payload that is not trivially copyable.
Error cannot_cross(const TopicCore& topic);

/// A closed sink with its final status.
struct ClosedSink : SinkStatus {
  std::string recording = {};  ///< the file of its recording (`through`); empty: none
  /// Its own file (empty: none), set if a new configuration replaced it; otherwise the sink of its name has the path.
  std::optional<std::string> path = {};
  bool is_recording = false;
  std::shared_ptr<const RunReport> recorded = {};  ///< its recording's report of the run; null: not closed
};

class RuntimeCore {
 public:
  RuntimeCore(Runtime& face, Runtime::Config config);
  RuntimeCore(const RuntimeCore&) = delete;
  RuntimeCore& operator=(const RuntimeCore&) = delete;
  ~RuntimeCore();

  Runtime& face;
  const Runtime::Config config;
  ClockLog clock_log;
  Reports reports;
  Configurations configurations{*this, config.configuration};
  Names names{*this};
  Exchange exchange{*this};

  /// The uuid of this run, made at the first call.
  const std::string& run_uuid();
  /// The uuid of the run in a recording: the same in the first, and another in each later one.
  std::string uuid_for_recording();
  /// True if it belongs to a run in a recording of this program.
  bool has_recorded(const std::string& uuid) const;
  Clock& clock() noexcept { return clock_log.clock(); }
  bool has_injected_clock() const noexcept { return config.clock != nullptr; }
  Time event_now() noexcept { return event_time(clock().monotonic()); }
  Time event_time(MonotonicTime at) const noexcept { return clock_log.time_of(at); }
  // See Reports.
  void log(LogLevel level, std::string_view object, std::string_view text, std::string_view error_id = {}) noexcept {
    reports.log(level, object, text, error_id);
  }
  void report(LoopCore* loop, std::string_view object, const Error& error) { reports.report(loop, object, error); }
  void keep_report(LoopCore* loop, std::string object, Error error) {
    reports.keep(loop, std::move(object), std::move(error));
  }
  void report_kept() { reports.report_kept(); }
  void health_changed(std::string_view kind, std::string_view name, Health health, std::string_view reason) noexcept {
    reports.health_changed(kind, name, health, reason);
  }
  std::string hide(std::string text) const { return reports.hide(std::move(text)); }

  // Topics, and origins on them
  /// SetupError: bad-name, description-differs.
  TopicCore& topic(std::string_view name, PayloadType type) {
    TopicCore& found = find_or_make_topic(name, std::move(type));
    report_kept();
    return found;
  }
  /// The same; the caller calls `report_kept` later.
  TopicCore& find_or_make_topic(std::string_view name, PayloadType type);
  TopicCore* find_topic(std::string_view name) noexcept;
  const std::vector<std::unique_ptr<TopicCore>>& topics() const noexcept { return topics_; }
  OriginCore* find_origin(std::string_view name) noexcept;
  OriginCore& find_or_make_origin(std::string_view name, TopicCore& topic);
  /// The origin of the program's own events on a topic.
  OriginCore& program_origin(TopicCore& topic);
  const auto& origins() const noexcept { return origins_; }
  std::vector<SubscriptionNode*> patterns;  ///< subscriptions that new topics are offered to

  // Sensors and sinks
  PlacedList<SensorEntry, &SensorEntry::place> sensors;
  std::vector<Listener*> listeners;
  std::vector<Recorder*> recorders;  ///< those of the listeners that are sinks
  void attach(Recorder& recorder) {
    recorders.reserve(recorders.size() + 1);
    closed_sinks.reserve(closed_sinks.size() + recorders.size() + 1);  // so that closing it does not allocate
    listeners.push_back(&recorder);
    recorders.push_back(&recorder);
  }
  void detach(Recorder& recorder) noexcept {
    std::erase(listeners, &recorder);
    std::erase(recorders, &recorder);
  }
  std::vector<ClosedSink> closed_sinks;  ///< with their final status
  std::string unknown_end;               ///< tier data missing from the final accounts written by the last drain

  // Its loop
  LoopCore* own_loop = nullptr;  ///< while it has one
  unsigned calling = 0;          ///< calls of user code on the stack, see LoopCore::Calling
  void attach(LoopCore& loop);
  /// The loop ends: its topics cancel queued events, and the log gets the kept reports.
  void forget(LoopCore& loop) noexcept;

  // Tiers. Each has its own runtime core; a thread only uses that of its loop. Bridges bring a tier's events to the
  // others.
  RuntimeCore* hub = nullptr;     ///< of the main loop; null: this is it
  std::vector<TierCore*> tiers;   ///< the main loop's
  std::vector<Bridge*> outbound;  ///< from this loop
  std::vector<Bridge*> inbound;   ///< to this loop
  /// That of the main loop.
  RuntimeCore& main() noexcept { return hub != nullptr ? *hub : *this; }
  /// Main loop only: starts tiers that were never started. SetupError.
  void start_tiers();
  /// Like `start_tiers`, but reports an error instead of throwing it, and tries only once.
  void start_tiers_in_turn() noexcept;
  /// The tier that still uses the loop, as text for messages; empty: none.
  std::string user_of_loop() const;
  /// Takes data that other loops sent before the call. May report, as the next function.
  void receive() {
    receive_all();
    report_kept();
  }
  /// The same; the caller calls `report_kept` later.
  void receive_all();
  /// Sends everything published so far to the other loops.
  void send_now() noexcept;
  /// The end of a turn of the loop: sends accounts to the other loops.
  void turn_done();

 private:
  std::string run_uuid_;
  std::vector<std::string> recorded_;  // in recordings
  std::vector<std::unique_ptr<TopicCore>> topics_;
  std::unordered_map<std::string_view, TopicCore*> topic_by_name_;
  std::unordered_set<OriginCore, ByName, ByName> origins_;
};

}  // namespace detail
}  // namespace rtdata
