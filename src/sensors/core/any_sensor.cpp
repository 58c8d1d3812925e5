// The verbs of every sensor's handle.
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
  source.loop()->call_there([&] {
    if (source.is_open()) otherwise = function(source);
  });
  return otherwise;
}

/// Calls with the node on its loop's thread: a tier's may be another one than this. `otherwise`: when it is closed.
template <class Returned, class Function>
Returned with(detail::Node* node, Returned otherwise, const Function& function) {
  if (node == nullptr || !node->is_open()) return otherwise;
  auto& source = static_cast<detail::SourceNode&>(*node);
  if (!source.loop()->runs_elsewhere()) [[likely]]
    return function(source);
  return there(source, otherwise, function);
}

template <class Function>
void with(detail::Node* node, const Function& function) {
  with(node, 0, [&](detail::SourceNode& source) {
    function(source);
    return 0;
  });
}

/// Of a sensor whose loop does not turn: what the main loop knows of it last.
SensorStatus last_known(const detail::Node& node) {
  const auto& source = static_cast<const detail::SourceNode&>(node);
  detail::LoopCore& loop = *source.loop();
  SensorStatus known;
  for (const auto* bridge : loop.runtime.main().inbound) {
    std::vector<SensorStatus> all;
    bridge->receiving.add_statuses(all);
    for (SensorStatus& one : all)
      if (one.name == source.origin().name && one.loop == loop.config.name) known = std::move(one);
  }
  known.health = Health::faulted;
  known.reason = "its loop does not turn: this is what is known of it last";
  return known;
}

/// For what cannot be refused: `from` the status, when its loop does not turn.
template <class Returned, class Function, class From>
Returned ask(detail::Node* node, Returned otherwise, const Function& function, const From& from) {
  try {
    return with(node, std::move(otherwise), function);
  } catch (const SetupError&) {
    return from(last_known(*node));
  }
}

/// For what is refused where the loop may not be used.
template <class Function>
void change(detail::Node* node, const char* what, const Function& function) {
  with(node, [&](detail::SourceNode& source) {
    source.loop()->check_thread(what, source.origin().name);
    function(source);
  });
}

}  // namespace

void AnySensor::start() {
  change(node(), "cannot start sensor", [](auto& source) { source.start(); });
}
void AnySensor::stop() {
  change(node(), "cannot stop sensor", [](auto& source) { source.stop(); });
}
bool AnySensor::is_running() const noexcept {
  return ask(
      node(), false, [](const auto& source) { return source.is_running(); },
      [](const SensorStatus& known) { return known.running; });
}
void AnySensor::set_rate(Rate rate) {
  change(node(), "cannot change sensor", [&](auto& source) { source.set_rate(rate); });
}
void AnySensor::set_processing(const Processing& processing) {
  change(node(), "cannot change sensor", [&](auto& source) { source.set_processing(processing); });
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
  change(node(), "cannot set on_error of sensor", [&](auto& source) { source.set_on_error(std::move(handler)); });
}

}  // namespace rtdata
