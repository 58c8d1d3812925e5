#include "sensors/core/source_node.hpp"

#include <algorithm>

namespace rtdata::detail {

PayloadType described_type(std::shared_ptr<const Description> description) {
  if (description == nullptr) {
    throw SetupError({Errc::bad_description, "cannot make feed", "", "it has no description of its payload",
                      "give it one, or make a Feed<T>"});
  }
  PayloadType type;
  type.size = description->size();
  type.alignment = description->alignment();
  type.type_name = description->name().c_str();
  type.description = std::move(description);
  return type;
}

namespace {

/// Null: there is nothing to do.
std::unique_ptr<Processor> make_processor(const std::shared_ptr<const Description>& source,
                                          const Processing& processing, const std::string& sensor) {
  if (processing.empty()) return nullptr;
  if (source == nullptr) {
    throw SetupError({Errc::bad_description, "cannot process", "sensor " + sensor, "its payload has no description",
                      "give its type a `describe`"});
  }
  return std::make_unique<Processor>(source, processing, sensor);
}

PayloadType published_type(PayloadType type, const Processor* processor) {
  if (processor == nullptr || processor->published() == type.description) return type;
  return described_type(processor->published());
}

}  // namespace

SourceNode::SourceNode(LoopCore& loop, std::string_view name, std::string_view topic, PayloadType type,
                       OriginCore::Supply supply, const Processing& processing, Duration warm_up,
                       const std::string& identity_by_word)
    : SensorEntry(loop),
      processor_(make_processor(type.description, processing, std::string(name))),
      warm_up_(warm_up),
      origin_(loop.runtime.names.claim(
          name, loop.runtime.topic(topic.empty() ? name : topic, published_type(std::move(type), processor_.get())),
          supply)) {
  try {
    note_processing(processing);
    loop.runtime.configurations.set_told("identity of sensor " + origin_.name, identity_by_word);
    loop.runtime.sensors.add(*this);
    if (!identity_by_word.empty())
      loop.runtime.log(LogLevel::warning, "sensor " + origin_.name, "takes a chip of identity " + identity_by_word);
  } catch (...) {
    loop.runtime.names.release(origin_);
    throw;
  }
  origin_.sensor = this;
}

SourceNode::~SourceNode() {
  if (is_open()) leave();  // a constructor of a derived class threw
}

void SourceNode::note_processing(const Processing& processing) {
  loop()->runtime.configurations.set_told("process of sensor " + origin_.name,
                                          processing.empty() ? std::string() : text_of(processing, origin_.topic.name));
}

void SourceNode::set_processing(const Processing& processing) {
  if (!is_open()) return;
  const auto& published = origin_.topic.type.description;
  const auto& source = processor_ != nullptr ? processor_->source() : published;
  auto next = make_processor(source, processing, origin_.name);
  const auto& wanted = next != nullptr ? next->published() : source;
  if (wanted != published && !wanted->same_meaning(*published)) {
    std::string why;
    for (const std::string& difference : published->differences(*wanted)) why += (why.empty() ? "" : "; ") + difference;
    throw SetupError({Errc::description_differs, "cannot change the processing", object_name(),
                      "its topic carries other values until the end of the run: " + why,
                      "give the sensor another topic, or start the program again"});
  }
  processor_ = std::move(next);
  note_processing(processing);
}

SourceNode::Fate SourceNode::process(void*& payload, Time time) noexcept {
  SensorCounts& counts = origin_.counts;
  const Fate fate = processor_->take(
      payload, time, counts.missed + counts.failed + counts.lost + counts.unreadable + origin_.ended_outages().number);
  if (fate == Fate::filtered) ++counts.filtered;
  if (fate == Fate::unusable) ++counts.unreadable;
  return fate;
}

void SourceNode::begin_warm_up() noexcept {
  if (warm_up_ <= Duration{0}) return;
  warm_until_ = later(loop()->now(), warm_up_);
  loop()->call_own("sensor", [&] {
    loop()->runtime.log(
        LogLevel::info, object_name(),
        "warms up for " + to_string(warm_up_) + ": its samples are discarded until then (counted as filtered)");
  });
}

bool SourceNode::is_warming_up(Time time) noexcept {
  const MonotonicTime now = loop()->now();
  // A device that stores its samples delivers them later. Its own clock may be wrong by any amount.
  const Time until = loop()->runtime.event_time(warm_until_);
  if (now < warm_until_ || (time < until && span_between(time, until) <= warm_up_)) return true;
  if (now - warm_until_ > warm_up_) warm_until_ = MonotonicTime::min();
  return false;
}

void SourceNode::leave() noexcept {
  origin_.sensor = nullptr;
  loop()->runtime.names.release(origin_);
  loop()->runtime.sensors.remove(*this);
  loop()->runtime.sensors.tidy();
}

void SourceNode::report(const Error& error) noexcept {
  try {
    if (is_open() && on_demand_ != nullptr && on_demand_->on_error) {
      const std::string object = object_name();
      Call call(*this);
      loop()->call_user(object, [&] { on_demand_->on_error({object, error, 1}); });
    } else {
      origin_.topic.runtime().report(nullptr, object_name(), error);  // also if user code has closed it meanwhile
    }
  } catch (...) {  // out of memory while reporting an error: it is counted nevertheless
  }
}

void SourceNode::set_health(Health health, const Error* reason) {
  if (!is_open()) return;
  if (reason != nullptr) {
    loop()->call_own("sensor", [&] { on_demand().reason = loop()->runtime.hide(reason->text()); });
    if (!is_open()) return;  // closed by the handler of the out-of-memory error
  }
  if (health == health_) return;
  Call call(*this);  // the handler may close this
  LoopCore& on = *loop();
  const std::string_view id = reason != nullptr ? reason->id() : "";
  health_ = health;
  if (health == Health::ok && on_demand_ != nullptr) on_demand_->reason.clear();
  RuntimeCore& runtime = on.runtime;
  runtime.health_changed("sensor", origin_.name, health, this->reason());
  on.call_own("sensor", [&] {
    if (health == Health::ok) {
      runtime.log(LogLevel::info, object_name(), "ok again");
    } else if (health == Health::faulted) {
      runtime.log(LogLevel::warning, object_name(), "faulted: " + std::string(this->reason()), id);
    }
  });
}

}  // namespace rtdata::detail
