#include "outputs/input.hpp"

#include <utility>

namespace rtdata::detail {

DerivedConfig derived_of(const OutputConfig& config) {
  DerivedConfig derived;
  derived.on = config.on;
  derived.with = config.with;
  derived.age = config.max_age;
  derived.expression = config.expression.empty() ? "'" + Expression::normal_name(config.on) + "'" : config.expression;
  return derived;
}

OutputInput::OutputInput(const OutputConfig& config) : max_age_(config.max_age) {
  const DerivedConfig derived = derived_of(config);
  const std::vector<std::string> names = Expression::names_in(derived.expression).or_throw();
  expression_ = Expression(derived.expression, names);
  std::vector<std::string> topics{config.on};
  topics.insert(topics.end(), config.with.begin(), config.with.end());
  for (std::size_t i = 0; i < topics.size(); ++i) {
    Source& source = sources_.emplace_back(Source{topics[i]});
    for (std::size_t n = 0; n < names.size(); ++n)
      if (FieldName meaning = field_named(topics, names[n]); meaning.topic == i)
        source.inputs.push_back({n, names[n], std::move(meaning), nullptr});
  }
  if (config.hysteresis) hysteresis_.emplace(*config.hysteresis);
  if (config.pid) pid_.emplace(*config.pid);
}

std::vector<Subscription> OutputInput::subscribe(Loop& loop, const std::string& output,
                                                 const std::function<void(std::size_t, const EventView&)>& take) {
  std::vector<Subscription> made;
  for (std::size_t i = sources_.size(); i-- > 0;) {
    made.push_back(loop.subscribe(sources_[i].topic, [take, i](const EventView& event) { take(i, event); }));
    made.back().set_name(output + " on " + sources_[i].topic);
  }
  return made;
}

void OutputInput::put(std::size_t topic, const EventView& event) {
  Source& source = sources_[topic];
  if (source.description != event.description().serial()) {
    source.description = event.description().serial();
    source.missing = nullptr;
    for (Input& input : source.inputs) {
      input.leaf = leaf_named(event.description(), input.meaning, input.name);
      if (input.leaf == nullptr && source.missing == nullptr) source.missing = &input;
    }
  }
  source.has_come = true;
  source.time = event.time();
  if (source.missing != nullptr) return;
  for (const Input& input : source.inputs) {
    const std::optional<double> value = number_in(*input.leaf, event.payload().data());
    if (value)
      expression_.set(input.index, *value);
    else
      expression_.set_unknown(input.index);
  }
}

std::optional<double> OutputInput::evaluate(Time time) {
  why_.clear();
  for (const Source& source : sources_) {
    if (source.missing != nullptr) {
      fail("the topic \"" + source.topic + "\" has no number `" + source.missing->name + "`");
      return {};
    }
    if (source.inputs.empty() || &source == &sources_.front()) continue;
    if (source.has_come && time - source.time <= max_age_) continue;
    fail("the topic \"" + source.topic + "\" has brought nothing" +
         (source.has_come ? " for more than " + to_string(max_age_) : std::string(" yet")));
    return {};
  }
  const ExpressionResult result = expression_.evaluate(time);
  if (result.has_failed()) fail(expression_.why());
  if (!result.has_value()) return {};
  if (hysteresis_) return hysteresis_->update(result.value) ? 1 : 0;
  if (pid_) return pid_->update(result.value, time);
  return result.value;
}

void OutputInput::fail(std::string_view why) { why_ = why; }

void OutputInput::follow(double value) noexcept {
  if (pid_) pid_->follow(value);
}

}  // namespace rtdata::detail
