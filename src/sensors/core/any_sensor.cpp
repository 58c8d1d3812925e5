// The functions of every sensor's handle.
#include <utility>
#include <vector>

#include "loop/runtime/runtime_core.hpp"
#include "loop/tier/bridge.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "sensors/core/source_node.hpp"

namespace rtdata {
namespace {

template <class Returned, class Function>
[[gnu::noinline]] Returned there(detail::SourceNode& source, Returned otherwise, Function function) {
  return source.loop()->ask_there(
      [&source, otherwise = std::move(otherwise), function = std::move(function)]() mutable {
        return source.is_open() ? function(source) : std::move(otherwise);
      });
}

/// Calls the function with the node on its loop's thread, which may be another one for a tier. `otherwise`: the result
/// if it is closed. The function must own everything it uses.
template <class Returned, class Function>
Returned with(detail::Node* node, Returned otherwise, Function function) {
  if (node == nullptr || !node->is_open()) return otherwise;
  auto& source = static_cast<detail::SourceNode&>(*node);
  if (!source.loop()->runs_elsewhere()) [[likely]]
    return function(source);
  return there(source, std::move(otherwise), std::move(function));
}

/// The last status known to the main loop, for a sensor whose loop does not turn.
SensorStatus last_known(const detail::Node& node) {
  const auto& source = static_cast<const detail::SourceNode&>(node);
  detail::LoopCore& loop = *source.loop();
  SensorStatus known;
  known.health = Health::faulted;
  known.reason = "its loop does not turn, so its state is unknown";
  for (const auto* bridge : loop.runtime.main().inbound) {
    std::vector<SensorStatus> all;
    bridge->receiving.add_statuses(all);
    for (SensorStatus& one : all)
      if (one.name == source.origin().name && one.loop == loop.config.name) known = std::move(one);
  }
  return known;
}

/// For calls that cannot be refused: uses `from` the last status if the loop does not turn.
template <class Returned, class Function, class From>
Returned ask(detail::Node* node, Returned otherwise, const Function& function, const From& from) {
  try {
    return with(node, std::move(otherwise), function);
  } catch (const SetupError&) {
    return from(last_known(*node));
  }
}

/// For calls that are refused if the loop must not be used.
template <class Function>
bool change(detail::Node* node, const char* what, Function function) {
  return with(node, false, [what, function = std::move(function)](detail::SourceNode& source) mutable {
    source.loop()->check_thread(what, source.origin().name);
    return function(source);
  });
}

}  // namespace

bool AnySensor::start() {
  return change(node(), "cannot start sensor", [](detail::SourceNode& source) {
    const bool ran = source.is_running();
    source.start();
    return !ran;
  });
}
bool AnySensor::stop() {
  return change(node(), "cannot stop sensor", [](detail::SourceNode& source) {
    const bool ran = source.is_running();
    source.stop();
    return ran;
  });
}
bool AnySensor::is_running() const noexcept {
  return ask(
      node(), false, [](const auto& source) { return source.is_running(); },
      [](const SensorStatus& known) { return known.running; });
}
void AnySensor::set_rate(Rate rate) {
  change(node(), "cannot change sensor", [rate](detail::SourceNode& source) {
    source.set_rate(rate);
    return true;
  });
}
void AnySensor::set_processing(const Processing& processing) {
  change(node(), "cannot change sensor", [processing](detail::SourceNode& source) {
    source.set_processing(processing);
    return true;
  });
}
Rate AnySensor::rate() const noexcept {
  return ask(
      node(), Rate{}, [](const auto& source) { return source.rate(); },
      [](const SensorStatus& known) { return Rate::from_period(known.period); });
}
SensorCounts AnySensor::counts() const noexcept {
  return ask(
      node(), SensorCounts{}, [](const auto& source) { return source.counts(); },
      [](const SensorStatus& known) { return known.counts; });
}
Health AnySensor::health() const noexcept {
  return ask(
      node(), Health::ok, [](const auto& source) { return source.health(); },
      [](const SensorStatus& known) { return known.health; });
}
SensorStatus AnySensor::status() const {
  return ask(
      node(), SensorStatus{}, [](const auto& source) { return detail::status_of(source); },
      [](const SensorStatus& known) { return known; });
}
CallbackTimes AnySensor::times() const noexcept {
  return ask(
      node(), CallbackTimes{}, [](const auto& source) { return source.callback_times(); },
      [](const SensorStatus&) { return CallbackTimes{}; });
}
void AnySensor::on_error(Callback<void(const ErrorReport&)> handler) {
  change(node(), "cannot set on_error of sensor", [handler = std::move(handler)](detail::SourceNode& source) mutable {
    source.set_on_error(std::move(handler));
    return true;
  });
}

}  // namespace rtdata
