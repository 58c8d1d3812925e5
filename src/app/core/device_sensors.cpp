#include "app/core/gpio_place.hpp"
#include "app/core/standard_drivers.hpp"
#include "rtdata/sensors/analog.hpp"
#include "rtdata/sensors/counter.hpp"
#include "rtdata/sensors/edge.hpp"
#include "rtdata/sensors/encoder.hpp"
#include "rtdata/sensors/gps.hpp"
#include "rtdata/sensors/host.hpp"
#include "rtdata/sensors/iio.hpp"
#include "rtdata/sensors/levels.hpp"
#include "rtdata/sensors/pps.hpp"

namespace rtdata::app {

/// The buffer of an IIO device, for only one sensor, identified by the name in the file. Two names for the same device
/// are only detected at run time.
static PartPlan::Place buffer_of(const std::string& device, const std::string& root) {
  constexpr std::string_view prefix = "iio:device";
  std::string name = device;
  if (name.find_first_not_of("0123456789") == std::string::npos) name.insert(0, prefix);
  if (const std::string last = name.substr(name.rfind('/') + 1); name.starts_with('/') && last.starts_with(prefix))
    name = last;
  return {"buffer of the IIO", "device " + name + (root.empty() ? "" : " below " + root),
          "list the channels of both in one"};
}

void add_device_sensors(Registry& registry) {
  registry.add_sensor<AnalogConfig>(
      "analog", "a sensor behind an analog-to-digital converter of the kernel",
      [](const AnalogConfig& config) { return analog_description(config.unit); }, makes<AnalogSensor>,
      [](PartPlan&, const AnalogConfig&) {},
      {.notes = "An HX711 is such a converter, too: by the kernel's driver hx711.",
       .aliases = "adc potentiometer thermistor ntc photoresistor ldr hx711"});
#ifdef RTDATA_WITH_GPIO
  registry.add_sensor<CounterConfig>(
      "counter", "pulses on a GPIO line: their number, frequency, and what they stand for",
      [](const CounterConfig& config) { return counter_description(config); }, makes<CounterSensor>,
      [](PartPlan& plan, const CounterConfig& config) {
        plan.place = place_of(config.input.line.text, config.input.chip);
      });
  registry.add_sensor<EdgeConfig>(
      "edge", "the edges of a GPIO line, such as a button or a limit switch",
      [](const EdgeConfig&) { return Result(description_of<EdgeReading>()); }, makes<EdgeSensor>,
      [](PartPlan& plan, const EdgeConfig& config) {
        plan.place = place_of(config.input.line.text, config.input.chip);
      });
  registry.add_sensor<LevelsConfig>(
      "gpio", "the levels of GPIO lines, sampled",
      [](const LevelsConfig& config) { return levels_description(config); }, makes<LevelsSensor>,
      [](PartPlan& plan, const LevelsConfig& config) {
        for (const GpioLevel& level : config.lines) plan.more_places.push_back(place_of(level.line.text, level.chip));
      });
#endif
  registry.add_sensor<GpsConfig>(
      "gps", "a GPS receiver behind gpsd", [](const GpsConfig&) { return Result(description_of<GpsFix>()); },
      makes<GpsSensor>);
  registry.add_sensor<EncoderConfig>(
      "encoder", "a counter of the kernel: a quadrature encoder, or pulses that hardware counts",
      [](const EncoderConfig& config) { return encoder_description(config); }, makes<EncoderSensor>);
  registry.add_sensor<HostConfig>(
      "host", "what this computer knows of itself: load, memory, temperature and so on",
      [](const HostConfig& config) { return host_description(config.quantity); }, makes<HostSensor>);
  registry.add_sensor<IioConfig>(
      "iio", "any IIO device of the kernel, read channel by channel",
      [](const IioConfig& config) { return iio_description(config.channels); }, makes<IioSensor>,
      [](PartPlan&, const IioConfig&) {},
      {.notes = "A DHT11, DHT22 or AM2302 has a driver of the kernel, dht11, and an HC-SR04 has srf04: a device tree "
                "overlay\n"
                "names the line (on a Raspberry Pi `dtoverlay=dht11,gpiopin=4`), and then they are IIO devices, which\n"
                "`rtdata scan` finds.",
       .aliases = "dht11 dht22 am2302 hc-sr04 ultrasonic humidity"});
  registry.add_sensor<IioBufferConfig>(
      "iio_buffer", "any IIO device of the kernel, at the rate of its trigger, from its buffer",
      [](const IioBufferConfig& config) { return iio_description(config.channels); }, makes<IioBufferSensor>,
      [](PartPlan& plan, const IioBufferConfig& config) { plan.place = buffer_of(config.device, config.root); });
  registry.add_sensor<PpsConfig>(
      "pps", "pulses per second, as the kernel times them; a source of the time of day",
      [](const PpsConfig&) { return Result(description_of<PpsPulse>()); }, makes<PpsSensor>);
}

}  // namespace rtdata::app
