// The value that an output is to have, from the events of topics.
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

/// Takes no memory for an event. Owner: the output; thread: its loop's.
class OutputInput {
 public:
  explicit OutputInput(const OutputConfig& config) : OutputInput(config, derived_of(config)) {}
  /// `take(topic)` is called with the index of each event's topic, after `put`.
  std::vector<Subscription> subscribe(Loop& loop, const std::string& output,
                                      const std::function<void(std::size_t, const EventView&)>& take) const;
  void put(std::size_t topic, const EventView& event, MonotonicTime now);
  /// What came before counts as if it came now.
  void begin(MonotonicTime now) { came_.assign(sources_.all().size(), now); }
  /// The last events of topics that bring one only when something changes, as if they came now.
  void recall(Loop& loop, const std::function<void(std::size_t, const EventView&)>& take) {
    sources_.recall(loop, take);
  }
  /// Its value changes with events of this topic: of the first, and of all where the first only says what changes.
  bool computes_with(std::size_t topic) const noexcept { return topic == 0 || sources_.all().front().is_held; }
  /// The loops of others, of topics that it uses and that bring an event only when something changes: these are as
  /// good as those loops turn.
  std::vector<LoopCore*> loops_of_held(Loop& loop) const;
  bool has_held() const noexcept;
  std::vector<std::string> topics() const { return sources_.topics(); }
  struct Silence {
    const std::string* topic;  ///< null: none of them may be silent
    MonotonicTime since;
  };
  /// The topic that has been silent for longest, of those that its value is made of and that may not be silent.
  Silence silence() const noexcept;
  /// None: it has none now; `why` says why, if it is not just waiting. `time`: of the event with which it changes.
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
