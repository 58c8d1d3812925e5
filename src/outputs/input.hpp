// The value that an output is to have, from the events of topics.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "process/expression_fields.hpp"
#include "rtdata/loop/topic.hpp"
#include "rtdata/outputs/output.hpp"
#include "rtdata/process/expression.hpp"
#include "rtdata/sensors/derived.hpp"

namespace rtdata::detail {

/// Its expression, with names and topics, as that of a derived value.
DerivedConfig derived_of(const OutputConfig& config);

/// Takes no memory for an event. Owner: the output; thread: its loop's.
class OutputInput {
 public:
  explicit OutputInput(const OutputConfig& config);
  /// `take(topic)` is called with the index of each event's topic, after `put`.
  std::vector<Subscription> subscribe(Loop& loop, const std::string& output,
                                      const std::function<void(std::size_t, const EventView&)>& take);
  void put(std::size_t topic, const EventView& event);
  /// As of an event of the first topic. None: it has none now; `why` says why, if it is not just waiting.
  std::optional<double> evaluate(Time time);
  /// Empty: it is waiting, or has a value.
  const std::string& why() const noexcept { return why_; }
  /// The output has this value, whatever was evaluated.
  void follow(double value) noexcept;

 private:
  struct Input {
    std::size_t index;  // among the expression's names
    std::string name;
    FieldName meaning;
    const Leaf* leaf;
  };
  struct Source {
    std::string topic;
    std::vector<Input> inputs = {};
    std::uint64_t description = 0;  // of which the leaves are; 0: none yet
    const Input* missing = nullptr;
    bool has_come = false;
    Time time{};
  };
  void fail(std::string_view why);

  Duration max_age_;
  Expression expression_;
  std::vector<Source> sources_;
  std::optional<Hysteresis> hysteresis_;
  std::optional<Pid> pid_;
  std::string why_;
};

}  // namespace rtdata::detail
