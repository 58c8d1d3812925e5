#include "outputs/input.hpp"

#include <algorithm>
#include <cmath>

#include "loop/core/loop_core.hpp"
#include "loop/events/topic_core.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata::detail {

DerivedConfig derived_of(const OutputConfig& config) {
  DerivedConfig derived;
  derived.on = config.on;
  derived.with = config.with;
  derived.age = config.max_age;
  derived.expression = config.expression.empty() ? "'" + Expression::normal_name(config.on) + "'" : config.expression;
  return derived;
}

OutputInput::OutputInput(const OutputConfig& config, const DerivedConfig& derived)
    : max_age_(config.max_age),
      expression_(derived.expression, Expression::names_in(derived.expression).or_throw()),
      sources_(topics_of(derived.on, derived.with), expression_.names()) {
  if (config.hysteresis) hysteresis_.emplace(*config.hysteresis);
  if (config.pid) pid_.emplace(*config.pid);
}

std::vector<Subscription> OutputInput::subscribe(Loop& loop, const std::string& output,
                                                 const std::function<void(std::size_t, const EventView&)>& take) const {
  return sources_.subscribe(loop, output, take);
}

void OutputInput::put(std::size_t topic, const EventView& event, MonotonicTime now) {
  came_[topic] = now;
  sources_.put(topic, event,
               [this](std::size_t name, std::optional<double> value) { set_or_unknown(expression_, name, value); });
}

std::optional<double> OutputInput::evaluate(Time time, MonotonicTime now) {
  why_.clear();
  if (const ExpressionSources::Source* const lacking = sources_.lacking(time, max_age_)) {
    why_ = ExpressionSources::why(*lacking, max_age_);
    return {};
  }
  if (const Silence silence = this->silence(); silence.topic != nullptr && now - silence.since >= max_age_) {
    why_ = "the topic \"" + *silence.topic + "\" has had no event for " + to_string(max_age_);
    return {};
  }
  const ExpressionResult result = expression_.evaluate(time);
  if (result.has_failed()) why_ = expression_.why();
  if (!result.has_value()) return {};
  if (!std::isfinite(result.value)) {
    why_ = "it is not a finite number";
    return {};
  }
  if (hysteresis_) return hysteresis_->update(result.value) ? 1 : 0;
  if (pid_) return pid_->update(result.value, time);
  return result.value;
}

bool OutputInput::has_held() const noexcept {
  return std::any_of(sources_.all().begin(), sources_.all().end(), [](const auto& one) { return one.is_held; });
}

std::vector<LoopCore*> OutputInput::loops_of_held(Loop& loop) const {
  std::vector<LoopCore*> loops;
  for (std::size_t i = 0; i < sources_.all().size(); ++i) {
    const ExpressionSources::Source& one = sources_.all()[i];
    const TopicCore* const topic = !one.is_held || (i > 0 && one.fields.empty())
                                       ? nullptr
                                       : loop.core().runtime.find_topic(one.topic);
    if (topic == nullptr) continue;
    for (const OriginCore* origin : topic->origins())
      if (origin->comes_from != nullptr && std::find(loops.begin(), loops.end(), origin->comes_from) == loops.end())
        loops.push_back(origin->comes_from);
  }
  return loops;
}

OutputInput::Silence OutputInput::silence() const noexcept {
  Silence longest{nullptr, MonotonicTime::max()};
  for (std::size_t i = 0; i < sources_.all().size(); ++i) {
    const ExpressionSources::Source& one = sources_.all()[i];
    if (one.is_held || (i > 0 && one.fields.empty()) || came_[i] >= longest.since) continue;
    longest = {&one.topic, came_[i]};
  }
  return longest;
}

void OutputInput::follow(double value) noexcept {
  if (pid_) pid_->follow(value);
}

}  // namespace rtdata::detail
