#include "app/core/standard_drivers.hpp"
#include "rtdata/sensors/command.hpp"
#include "rtdata/sensors/serial_line.hpp"
#include "rtdata/sensors/tcp_lines.hpp"
#include "rtdata/sensors/w1.hpp"

namespace rtdata::app {

void add_line_sensors(Registry& registry) {
  registry.add_sensor<W1Config>(
      "w1", "temperature of a DS18B20 or the like on 1-Wire",
      [](const W1Config&) { return Result(description_of<W1Temperature>()); }, makes<W1Sensor>);
  registry.add_sensor<SerialConfig>(
      "serial", "a device that sends lines of CSV, JSON or NMEA over a serial line",
      [](const SerialConfig& config) { return description_of_lines(config.lines); }, makes<SerialLineSensor>,
      [](PartPlan& plan, const SerialConfig& config) {
        plan.place = {"", config.device, ""};
      },
      {.aliases = "arduino uart rs232 usb teensy esp32"});
  registry.add_sensor<CommandConfig>(
      "command", "a program of your own whose lines are events",
      [](const CommandConfig& config) { return description_of_lines(config.lines); }, makes<CommandSensor>,
      [](PartPlan&, const CommandConfig&) {}, {.aliases = "script python program exec shell stdout"});
}

}  // namespace rtdata::app
