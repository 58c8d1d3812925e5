#include "rtdata/app/standard.hpp"

#include "rtdata/sensors/analog.hpp"

namespace rtdata {

Registry standard_registry() {
  Registry registry;
  registry.add_sensor<AnalogConfig>(
      "analog", "a sensor behind an analog-to-digital converter of the kernel",
      [](const AnalogConfig& config) { return analog_description(config.unit); },
      [](Loop& loop, const SensorConfig& common, const AnalogConfig& config) { return AnalogSensor(loop, common, config); });
  return registry;
}

}  // namespace rtdata
