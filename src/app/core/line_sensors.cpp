#include "app/core/standard_drivers.hpp"
#include "rtdata/sensors/command.hpp"
#ifdef RTDATA_WITH_HTTP
#include "rtdata/sensors/http.hpp"
#endif
#ifdef RTDATA_WITH_MQTT
#include "rtdata/sensors/mqtt.hpp"
#endif
#include "rtdata/sensors/serial_line.hpp"
#include "rtdata/sensors/tcp_lines.hpp"
#include "rtdata/sensors/udp_lines.hpp"
#include "rtdata/sensors/w1.hpp"

namespace rtdata::app {
namespace {

constexpr const char* recipes =
    "docs/recipes has a configuration to copy for each of many products, with what they send and what comes of it.";

/// Sensors with the same settings may share a device.
std::string shared_settings(const SerialSettings& of) {
  const auto level = [](const std::optional<bool>& line) { return line ? *line ? "1" : "0" : "-"; };
  return "serial " + std::to_string(of.baud_rate) + " " + std::to_string(of.character_size) + " " +
         std::to_string(static_cast<int>(of.parity)) + " " + std::to_string(of.stop_bits) + level(of.dtr) +
         level(of.rts) + (of.hangup ? "h" : "-") + (of.rs485 ? std::to_string(static_cast<int>(*of.rs485)) : "-");
}

}  // namespace

void add_line_sensors(Registry& registry) {
  registry.add_sensor<W1Config>(
      "w1", "temperature of a DS18B20 or the like on 1-Wire",
      [](const W1Config&) { return Result(description_of<W1Temperature>()); }, makes<W1Sensor>);
  registry.add_sensor<SerialConfig>(
      "serial", "a device that sends lines of CSV, JSON or NMEA over a serial line",
      [](const SerialConfig& config) { return description_of_lines(config.lines); }, makes<SerialLineSensor>,
      [](PartPlan& plan, const SerialConfig& config) {
        plan.place = {"", config.device, ""};
        plan.place.sharing = shared_settings(config.serial);
      },
      {.notes = recipes,
       .aliases = "arduino uart rs232 usb teensy esp32 scale balance pms5003 pms7003 sds011 ze08 dust dsmr p1 teleinfo "
                  "linky ve.direct victron nmea wind windsonic wxt520 balloon geiger a02yyuw maxbotix lidar tf-luna "
                  "tfmini jeelink ublox ld06 ld19 sml obis slip cobs packetserial"});
  registry.add_sensor<CommandConfig>(
      "command", "a program of your own whose lines are events",
      [](const CommandConfig& config) { return description_of_lines(config.lines); }, makes<CommandSensor>,
      [](PartPlan&, const CommandConfig&) {},
      {.notes = recipes,
       .aliases = "script python program exec shell stdout rtl_433 rtl-433 ping nvidia-smi can candump canbus sigrok "
                  "sigrok-cli"});
  registry.add_sensor<TcpLinesConfig>(
      "tcp", "a device that sends lines over a TCP connection, such as an ESP32 or ser2net; either side may connect",
      [](const TcpLinesConfig& config) { return description_of_lines(config.lines); }, makes<TcpLines>,
      [](PartPlan& plan, const TcpLinesConfig& config) {
        if (config.listen.empty()) return;
        const std::string port = std::to_string(config.port) + " of " + config.listen;
        plan.place = {"TCP port", port, "set the `from` of each, or give each a port of its own"};
        if (config.from.empty()) return;
        plan.place.sharing = "from";
        plan.more_places.push_back({"TCP port", port + " from " + config.from, "one sensor takes all of a device"});
      },
      {.aliases = "socket network wifi esp32 ser2net telnet nmea server"});
  registry.add_sensor<UdpLinesConfig>(
      "udp", "devices that send lines or frames by UDP to this machine",
      [](const UdpLinesConfig& config) { return description_of_lines(config.lines); }, makes<UdpLines>,
      [](PartPlan& plan, const UdpLinesConfig& config) {
        if (!config.is_group())
          plan.place = {"UDP port", std::to_string(config.port) + " of " + config.address,
                        "give each a port of its own"};
      },
      {.aliases = "datagram multicast broadcast telemetry listen esp8266"});
#ifdef RTDATA_WITH_HTTP
  registry.add_sensor<HttpSensorConfig>(
      "http", "the answers of a URL, such as of a smart plug, a gateway or a weather service",
      [](const HttpSensorConfig& config) { return line_description(config.fields); }, makes<HttpSensor>,
      [](PartPlan&, const HttpSensorConfig&) {},
      {.notes = recipes, .aliases = "shelly tasmota ecowitt open-meteo airrohr rest api url web prometheus"});
#endif
#ifdef RTDATA_WITH_MQTT
  registry.add_sensor<MqttSensorConfig>(
      "mqtt", "the messages of a broker of MQTT, such as a phone's or an ESP32's",
      [](const MqttSensorConfig& config) { return mqtt_description(config); }, makes<MqttSensor>,
      [](PartPlan& plan, const MqttSensorConfig& config) { plan.stored_by = config.stored_by; },
      {.notes = recipes, .aliases = "ruuvi ruuvitag zigbee2mqtt esphome lorawan ttn"});
#endif
}

}  // namespace rtdata::app
