// The topics of which expressions take their values: of derived values, outputs and the conditions of machines.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "process/expression_fields.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::detail {

/// Takes no memory for an event. Owner: who evaluates; thread: its loop's.
class ExpressionSources {
 public:
  /// A name of the expressions, which stands for a field of a topic.
  struct Field {
    std::size_t index;  ///< among the names
    std::string name;
    FieldName meaning;
    const Leaf* leaf = nullptr;  ///< null: what the topic carries has no such number, or nothing has come
    bool is_state = false;       ///< a machine is in the state of this name; `leaf` is where it says so
  };
  struct Source {
    std::string topic = {};
    std::vector<Field> fields = {};
    std::uint64_t description = 0;   ///< of which the leaves are; 0: none yet
    const Field* missing = nullptr;  ///< the first field that what it carries does not have
    bool has_come = false;
    bool is_held = false;  ///< what came last holds until the next, however old: see `Description::is_of_changes`
    Time time{};           ///< of the last event
  };

  /// `names`: of all expressions, as they were made with.
  ExpressionSources(const std::vector<std::string>& topics, const std::vector<std::string>& names);
  ExpressionSources(ExpressionSources&&) = default;
  ExpressionSources& operator=(ExpressionSources&&) = default;

  /// `take(source)` is called for each event, of the first topic after those of others of that time.
  std::vector<Subscription> subscribe(Loop& loop, const std::string& whose,
                                      const std::function<void(std::size_t source, const EventView& event)>& take) const;

  /// Calls `take(source, event)` with the last event of each topic that is held, the first topic's last. For who begins
  /// later than that event, which is then as if it came now.
  void recall(Loop& loop, const std::function<void(std::size_t source, const EventView& event)>& take);

  /// Calls `set(index, value)` for each name that is of this source; the value is an optional.
  /// Returns whether what the topic carries is of another description than before.
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
  /// The first source, of those with names, that does not have them, or (but for the first, and those that are held)
  /// has brought nothing within `age`. None: null.
  const Source* lacking(Time now, Duration age) const noexcept;
  static std::string why(const Source& lacking, Duration age);

  /// As before the first event.
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
