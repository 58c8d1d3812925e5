// Computes the value of an output from the events of topics.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "process/expression_sources.hpp"
#include "rtdata/outputs/output.hpp"
#include "rtdata/process/expression.hpp"
#include "rtdata/sensors/derived.hpp"

namespace rtdata::detail {

class LoopCore;

/// Its expression, with names and topics, as that of a derived value.
DerivedConfig derived_of(const OutputConfig& config);

/// Allocates no memory for an event. Owner: the output; thread: its loop's.
class OutputInput {
 public:
  explicit OutputInput(const OutputConfig& config) : OutputInput(config, derived_of(config)) {}
  /// `take(topic)` is called with the index of each event's topic, after `put`.
  std::vector<Subscription> subscribe(Loop& loop, const std::string& output,
                                      const std::function<void(std::size_t, const EventView&)>& take) const;
  void put(std::size_t topic, const EventView& event, MonotonicTime now);
  /// Treats earlier events as if they came now.
  void begin(MonotonicTime now) { came_.assign(sources_.all().size(), now); }
  /// Takes the last events of topics that publish only changes, as if they came now.
  void recall(Loop& loop, const std::function<void(std::size_t, const EventView&)>& take) {
    sources_.recall(loop, take);
  }
  /// True if events of this topic change the value: the first topic, and all topics if the first publishes only
  /// changes.
  bool computes_with(std::size_t topic) const noexcept { return topic == 0 || sources_.all().front().is_held; }
  /// Other loops with topics that it uses and that publish only changes: such a value is valid only while that loop
  /// turns.
  std::vector<LoopCore*> loops_of_held(Loop& loop) const;
  bool has_held() const noexcept;
  std::vector<std::string> topics() const { return sources_.topics(); }
  struct Silence {
    const std::string* topic;  ///< null: none of them may be silent
    MonotonicTime since;
  };
  /// The topic with the longest silence, of those that must not be silent.
  Silence silence() const noexcept;
  /// The value; empty: none now, with the reason in `why` unless it is only waiting. `time`: of the event that changes
  /// it.
  std::optional<double> evaluate(Time time, MonotonicTime now);
  /// Empty: it is waiting, or has a value.
  const std::string& why() const noexcept { return why_; }
  /// The output has this value, whatever was evaluated.
  void follow(double value) noexcept;
  /// Null: it has none.
  Pid* pid() noexcept { return pid_ ? &*pid_ : nullptr; }

 private:
  OutputInput(const OutputConfig& config, const DerivedConfig& derived);

  Duration max_age_;
  Expression expression_;
  ExpressionSources sources_;
  std::vector<MonotonicTime> came_;  // when each source brought its last event
  std::optional<Hysteresis> hysteresis_;
  std::optional<Pid> pid_;
  std::string why_;
};

}  // namespace rtdata::detail
