// The source topics of expressions, for derived values, outputs and conditions of machines.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "process/expression_fields.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::detail {

/// Does not allocate for events. Owner: the evaluating object; thread: its loop's.
class ExpressionSources {
 public:
  /// A name in the expressions that stands for a field of a topic.
  struct Field {
    std::size_t index;  ///< among the names
    std::string name;
    FieldName meaning;
    const Leaf* leaf = nullptr;  ///< null: the payload has no such number, or no event came yet
    bool is_state = false;       ///< true while a machine is in the state of this name; `leaf` has the state
  };
  struct Source {
    std::string topic = {};
    std::vector<Field> fields = {};
    std::uint64_t description = 0;   ///< serial of the leaves' description; 0: none yet
    const Field* missing = nullptr;  ///< the first field that its payload does not have
    bool has_come = false;
    bool is_held = false;  ///< the last event is valid until the next, see `Description::is_of_changes`
    Time time{};           ///< of the last event
  };

  /// `names`: of all expressions, in their order.
  ExpressionSources(const std::vector<std::string>& topics, const std::vector<std::string>& names);
  ExpressionSources(ExpressionSources&&) = default;
  ExpressionSources& operator=(ExpressionSources&&) = default;

  /// Calls `take(source)` for each event; at equal times the first topic comes after the others.
  std::vector<Subscription> subscribe(Loop& loop, const std::string& whose,
                                      const std::function<void(std::size_t source, const EventView& event)>& take) const;

  /// Calls `take(source, event)` with the last event of each topic that publishes only changes, the first topic last.
  /// For a start after that event, which then counts as new.
  void recall(Loop& loop, const std::function<void(std::size_t source, const EventView& event)>& take);

  /// Calls `set(index, value)` for each name of this source; the value is an optional. Returns true if the topic's
  /// description has changed.
  template <typename Set>
  bool put(std::size_t source, const EventView& event, Set&& set) {
    Source& from = sources_[source];
    const bool is_new = from.description != event.description().serial();
    if (is_new) bind(from, event.description());
    from.has_come = true;
    from.time = event.time();
    for (const Field& field : from.fields) set(field.index, value_of(field, event.payload().data()));
    return is_new;
  }
  /// The first used source that lacks a field or has no event within `age` (except the first topic and topics that
  /// publish only changes). Null: none.
  const Source* lacking(Time now, Duration age) const noexcept;
  static std::string why(const Source& lacking, Duration age);

  /// Resets to the state before the first event.
  void forget() noexcept;
  const std::vector<Source>& all() const noexcept { return sources_; }
  std::vector<std::string> topics() const {
    std::vector<std::string> names;
    for (const Source& source : sources_) names.push_back(source.topic);
    return names;
  }

 private:
  static void bind(Source& source, const Description& description);
  static std::optional<double> value_of(const Field& field, const std::byte* payload) noexcept {
    if (field.leaf == nullptr) return std::nullopt;
    if (!field.is_state) return number_in(*field.leaf, payload);
    return holds_text(*field.leaf, payload, field.meaning.path) ? 1 : 0;
  }

  std::vector<Source> sources_;
};

/// A value, or that there is none.
inline void set_or_unknown(Expression& expression, std::size_t index, std::optional<double> value) noexcept {
  if (value)
    expression.set(index, *value);
  else
    expression.set_unknown(index);
}

}  // namespace rtdata::detail
