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

SourceNode::SourceNode(LoopCore& loop, std::string_view name, std::string_view topic, PayloadType type,
                       OriginCore::Supply supply)
    : SensorEntry(loop),
      origin_(
          loop.runtime.names.claim(name, loop.runtime.topic(topic.empty() ? name : topic, std::move(type)), supply)) {
  try {
    loop.runtime.sensors.add(*this);
  } catch (...) {
    loop.runtime.names.release(origin_);
    throw;
  }
  origin_.sensor = this;
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
      origin_.topic.runtime().report(nullptr, object_name(), error);  // also of one that user code has closed meanwhile
    }
  } catch (...) {  // out of memory while telling of an error: it is counted all the same
  }
}

void SourceNode::set_health(Health health, const Error* reason) {
  if (!is_open()) return;
  if (reason != nullptr) {
    loop()->call_own("sensor", [&] { on_demand().reason = loop()->runtime.hide(reason->text()); });
    if (!is_open()) return;  // closed by who was told that there is no memory
  }
  if (health == health_) return;
  Call call(*this);  // who is told may close this
  LoopCore& on = *loop();
  health_ = health;
  if (health == Health::ok && on_demand_ != nullptr) on_demand_->reason.clear();
  RuntimeCore& runtime = on.runtime;
  runtime.health_changed("sensor", origin_.name, health, this->reason());
  on.call_own("sensor", [&] {
    if (health == Health::ok) {
      runtime.log(LogLevel::info, object_name(), "ok again");
    } else if (health == Health::faulted) {
      runtime.log(LogLevel::warning, object_name(), "faulted: " + std::string(this->reason()));
    }
  });
}

}  // namespace rtdata::detail
