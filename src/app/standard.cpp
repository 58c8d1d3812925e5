#include "rtdata/app/standard.hpp"

#include "rtdata/sensors/analog.hpp"
#include "rtdata/sensors/host.hpp"
#include "rtdata/sensors/serial_line.hpp"

namespace rtdata {
namespace {

std::shared_ptr<const Description> host_description(HostQuantity what) {
  switch (what) {
    case HostQuantity::cpu: return description_of<HostCpu>();
    case HostQuantity::load: return description_of<HostLoad>();
    case HostQuantity::memory: return description_of<HostMemory>();
    case HostQuantity::disk: return description_of<HostDisk>();
    case HostQuantity::network: return description_of<HostNetwork>();
    case HostQuantity::scheduler: return description_of<HostScheduler>();
    case HostQuantity::process: return description_of<HostProcess>();
    case HostQuantity::temperature: return description_of<HostTemperature>();
    case HostQuantity::frequency: return description_of<HostFrequency>();
  }
  return nullptr;
}

}  // namespace

Registry standard_registry() {
  Registry registry;
  registry.add_sensor<AnalogConfig>(
      "analog", "a sensor behind an analog-to-digital converter of the kernel",
      [](const AnalogConfig& config) { return analog_description(config.unit); },
      [](Loop& loop, const SensorConfig& common, const AnalogConfig& config) { return AnalogSensor(loop, common, config); });
  registry.add_sensor<HostConfig>(
      "host", "what this computer knows of itself: load, memory, temperature and so on",
      [](const HostConfig& config) { return host_description(config.what); },
      [](Loop& loop, const SensorConfig& common, const HostConfig& config) { return HostSensor(loop, common, config); });
  registry.add_sensor<SerialConfig>(
      "serial", "a device that sends lines of CSV or JSON over a serial line",
      [](const SerialConfig& config) { return line_description(config.fields); },
      [](Loop& loop, const FeedConfig& common, const SerialConfig& config) { return SerialLineSensor(loop, common, config); });
  return registry;
}

}  // namespace rtdata
