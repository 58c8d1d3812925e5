#include "process/expression_sources.hpp"

#include <utility>

#include "data/saturating.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/events/topic_core.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata::detail {

ExpressionSources::ExpressionSources(const std::vector<std::string>& topics, const std::vector<std::string>& names) {
  for (const std::string& topic : topics) sources_.push_back({topic});
  for (std::size_t i = 0; i < names.size() && !topics.empty(); ++i) {
    FieldName meaning = field_named(topics, names[i]);
    const std::size_t of = meaning.topic;
    sources_[of].fields.push_back({i, names[i], std::move(meaning)});
  }
}

std::vector<Subscription> ExpressionSources::subscribe(
    Loop& loop, const std::string& whose, const std::function<void(std::size_t, const EventView&)>& take) const {
  std::vector<Subscription> made;
  for (std::size_t i = sources_.size(); i-- > 0;) {
    made.push_back(loop.subscribe(sources_[i].topic, [take, i](const EventView& event) { take(i, event); }));
    made.back().set_name(whose + " on " + sources_[i].topic);
  }
  return made;
}

void ExpressionSources::recall(Loop& loop,
                               const std::function<void(std::size_t source, const EventView& event)>& take) {
  for (std::size_t i = sources_.size(); i-- > 0;) {
    const TopicCore* const topic = loop.core().runtime.find_topic(sources_[i].topic);
    if (topic == nullptr || topic->type.description == nullptr) continue;
    sources_[i].is_held = topic->type.description->is_of_changes();
    if (const std::optional<EventView> last = topic->last_change()) take(i, *last);
  }
}

void ExpressionSources::bind(Source& source, const Description& description) {
  source.description = description.serial();
  source.missing = nullptr;
  source.is_held = description.is_of_changes();
  for (Field& field : source.fields) {
    field.leaf = leaf_named(description, field.meaning, field.name);
    field.is_state = field.leaf == nullptr && !field.meaning.path.empty();
    if (field.is_state) field.leaf = state_leaf(description);
    if (field.leaf == nullptr && source.missing == nullptr) source.missing = &field;
  }
}

const ExpressionSources::Source* ExpressionSources::lacking(Time now, Duration age) const noexcept {
  for (const Source& source : sources_) {
    if (source.missing != nullptr) return &source;
    if (source.fields.empty() || &source == &sources_.front()) continue;
    if (!source.has_come || (!source.is_held && span_between(source.time, now) > age)) return &source;
  }
  return nullptr;
}

std::string ExpressionSources::why(const Source& lacking, Duration age) {
  if (lacking.missing != nullptr)
    return "the topic \"" + lacking.topic + "\" has no number `" + lacking.missing->name + "`";
  return "the topic \"" + lacking.topic + "\" has had no event" +
         (lacking.has_come ? " for more than " + to_string(age) : std::string(" yet"));
}

void ExpressionSources::forget() noexcept {
  for (Source& source : sources_) source.has_come = false;
}

}  // namespace rtdata::detail
