#include "app/core/standard_drivers.hpp"
#include "rtdata/sensors/derived.hpp"
#include "rtdata/sensors/limit.hpp"
#include "rtdata/sensors/trigger.hpp"
#include "rtdata/sensors/vertical.hpp"

namespace rtdata::app {

template <class Config, auto check>
static constexpr auto check_topics = [](PartPlan& plan, const Config& config) {
  plan.check_topics = [config](const PartPlan& part, const PartPlan::PayloadOf& payload_of, Problems& problems) {
    check(config, payload_of, part.item, problems);
  };
};

void add_topic_sensors(Registry& registry) {
  registry.add_sensor<DerivedConfig>(
      "derived", "values computed by expressions from those of other topics",
      [](const DerivedConfig& config) { return derived_description(config); }, makes<DerivedSensor>,
      check_topics<DerivedConfig, check_derived_names>);
  registry.add_sensor<TriggerConfig>(
      "trigger", "the events of another topic while a condition holds, and from some time before that on",
      [](const TriggerConfig&) { return Result(std::shared_ptr<const Description>()); }, makes<TriggerSensor>,
      [](PartPlan& plan, const TriggerConfig& config) {
        plan.passes_on = config.on;
        check_topics<TriggerConfig, check_trigger_names>(plan, config);
      });
  registry.add_sensor<LimitConfig>(
      "limit", "alarms of a number of another topic: limits with hysteresis, delay, and a latch",
      [](const LimitConfig&) { return Result(description_of<Alarm>()); }, makes<LimitSensor>,
      [](PartPlan& plan, const LimitConfig& config) {
        check_topics<LimitConfig, check_limit_field>(plan, config);
        for (const char* key :
             {"low_low", "low", "high", "high_high", "hysteresis", "delay", "latched", "silence", "join"})
          plan.live[key] = [config](const PartObject& part) { part.as<LimitSensor>()->change(config); };
      });
  registry.add_sensor<VerticalConfig>(
      "vertical", "height, vertical speed and acceleration, of a barometer and an accelerometer of other topics",
      [](const VerticalConfig&) { return Result(description_of<VerticalMotion>()); }, makes<VerticalSensor>,
      check_topics<VerticalConfig, check_vertical_fields>);
}

}  // namespace rtdata::app
