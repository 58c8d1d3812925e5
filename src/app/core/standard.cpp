#include "rtdata/app/standard.hpp"

#include <algorithm>

#include "app/core/machines.hpp"
#include "app/core/standard_drivers.hpp"
#include "io/http_url.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/io/serial.hpp"
#include "rtdata/io/spi.hpp"
#include "rtdata/outputs/gpio.hpp"
#include "rtdata/outputs/http.hpp"
#include "rtdata/outputs/mqtt.hpp"
#include "rtdata/outputs/pwm.hpp"
#include "rtdata/outputs/serial.hpp"
#include "rtdata/sensors/analog.hpp"
#include "rtdata/sensors/counter.hpp"
#include "rtdata/sensors/derived.hpp"
#include "rtdata/sensors/edge.hpp"
#include "rtdata/sensors/encoder.hpp"
#include "rtdata/sensors/gps.hpp"
#include "rtdata/sensors/host.hpp"
#include "rtdata/sensors/iio.hpp"
#include "rtdata/sensors/levels.hpp"
#include "rtdata/sensors/limit.hpp"
#include "rtdata/sensors/pps.hpp"
#include "rtdata/sensors/serial_line.hpp"
#include "rtdata/sensors/trigger.hpp"
#include "rtdata/sensors/w1.hpp"
#include "rtdata/sinks/console.hpp"
#include "rtdata/sinks/file.hpp"
#ifdef RTDATA_WITH_HTTP
#include "rtdata/sinks/http.hpp"
#endif
#include "rtdata/sinks/tcp.hpp"
#include "rtdata/sinks/udp.hpp"
#ifdef RTDATA_WITH_MODBUS
#include "rtdata/sensors/modbus.hpp"
#endif
#ifdef RTDATA_WITH_MQTT
#include "rtdata/sensors/mqtt.hpp"
#include "rtdata/sinks/mqtt.hpp"
#endif
#ifdef RTDATA_WITH_POSTGRESQL
#include "rtdata/sinks/postgresql.hpp"
#endif
#ifdef RTDATA_WITH_SQLITE
#include "rtdata/sinks/replay.hpp"
#include "rtdata/sinks/sqlite.hpp"
#endif

namespace rtdata {

#ifdef RTDATA_WITH_SQLITE
static constexpr auto parameters(type_tag<SqliteConfig>) {
  return parameter_list(
      parameter("path", &SqliteConfig::path, "the file; one that exists is added to", required, TextIs::output_file),
      parameter(
          "profile", &SqliteConfig::profile,
          "what a power cut may cost: normal: 30 s, safe: what was not committed, fast: the file; card: for SD cards, "
          "10 s at risk",
          choices(value("normal", SqliteProfile::normal), value("safe", SqliteProfile::safe),
                  value("fast", SqliteProfile::fast), value("card", SqliteProfile::card))),
      parameter("max_bytes", &SqliteConfig::max_bytes,
                "the oldest rows are deleted when the recording takes more; 0: no limit, else 4 MiB at least",
                unit("By")),
      parameter("max_age", &SqliteConfig::max_age, "rows older than this are deleted; 0 s: no limit",
                range(std::chrono::seconds{0}, std::chrono::hours{24 * 36500})),
      parameter("permissions", &SqliteConfig::permissions,
                "who may read and write a file that is made, in octal digits, less the umask", TextIs::permissions),
      include_member(&SqliteConfig::sink));
}

static void check_config(const SqliteConfig& config, const ConfigItem& item, Problems& problems) {
  if (const auto is_recordable = check_recordable(config.path); !is_recordable) {
    const ConfigItem* path = item.find("path");
    const Error& error = is_recordable.error();
    problems.add((path != nullptr ? *path : item).problem("cannot-record", error.why + "; " + error.advice));
  }
  if (config.max_bytes == 0 || config.max_bytes >= SqliteConfig::least_max_bytes) return;
  const ConfigItem* value = item.find("max_bytes");
  problems.add((value != nullptr ? *value : item)
                   .problem("out-of-range", "max_bytes is " + std::to_string(config.max_bytes) +
                                                ": give at least 4194304 (4 MiB), or 0 for no limit"));
}
#endif

namespace {

/// The shipped formats, and those of this sink alone, and no others.
void check_format(const std::string& name, std::initializer_list<const char*> own, const ConfigItem& item,
                  Problems& problems) {
  std::vector<std::string> formats = CodecRegistry::standard().names();
  formats.insert(formats.end(), own.begin(), own.end());
  if (std::find(formats.begin(), formats.end(), name) != formats.end()) return;
  const ConfigItem* format = item.find("format");
  std::string message = "there is no format \"" + name + "\"";
  std::string nearest = nearest_name(name, formats);
  if (nearest.empty()) {
    message += "; there are";
    for (const std::string& known : formats) message += " " + known;
  }
  problems.add((format != nullptr ? *format : item).problem("unknown-choice", std::move(message), std::move(nearest)));
}

struct ShippedFileConfig : FileConfig {
  friend constexpr auto parameters(type_tag<ShippedFileConfig>) { return parameter_list(include<FileConfig>); }
  friend void check_config(const ShippedFileConfig& config, const ConfigItem& item, Problems& problems) {
    check_config(static_cast<const FileConfig&>(config), item, problems);
    check_format(config.format, {"jsonl"}, item, problems);
  }
};
struct ShippedTcpConfig : TcpConfig {
  friend constexpr auto parameters(type_tag<ShippedTcpConfig>) { return parameter_list(include<TcpConfig>); }
  friend void check_config(const ShippedTcpConfig& config, const ConfigItem& item, Problems& problems) {
    check_config(static_cast<const TcpConfig&>(config), item, problems);
    check_format(config.format, {"jsonl"}, item, problems);
  }
};
#ifdef RTDATA_WITH_MQTT
struct ShippedMqttConfig : MqttConfig {
  friend constexpr auto parameters(type_tag<ShippedMqttConfig>) { return parameter_list(include<MqttConfig>); }
  friend void check_config(const ShippedMqttConfig& config, const ConfigItem& item, Problems& problems) {
    check_config(static_cast<const MqttConfig&>(config), item, problems);
    check_format(config.format, {"jsonl"}, item, problems);
  }
};
#endif
struct ShippedUdpConfig : UdpConfig {
  friend constexpr auto parameters(type_tag<ShippedUdpConfig>) { return parameter_list(include<UdpConfig>); }
  friend void check_config(const ShippedUdpConfig& config, const ConfigItem& item, Problems& problems) {
    check_config(static_cast<const UdpConfig&>(config), item, problems);
    check_format(config.format, {"fields", "jsonl"}, item, problems);
  }
};

#ifdef RTDATA_WITH_HTTP
struct ShippedHttpConfig : HttpConfig {
  friend constexpr auto parameters(type_tag<ShippedHttpConfig>) { return parameter_list(include<HttpConfig>); }
  friend void check_config(const ShippedHttpConfig& config, const ConfigItem& item, Problems& problems) {
    check_config(static_cast<const HttpConfig&>(config), item, problems);
    check_format(config.format, {"jsonl"}, item, problems);
  }
};
#endif

}  // namespace

#ifdef RTDATA_WITH_GPIO
/// The line as it is written, which no two sensors of a configuration may have.
static PartPlan::Place place_of(std::string line, const std::string& chip) {
  if (!chip.empty()) line.insert(0, chip + ":");
  if (line.starts_with("/dev/")) line.erase(0, 5);
  return {"GPIO", "line " + line, ""};
}
#endif

/// The buffer of an IIO device, which one sensor can have. By its name in the file: whether two names are of one device
/// is seen when it runs.
static PartPlan::Place buffer_of(const std::string& device, const std::string& root) {
  constexpr std::string_view prefix = "iio:device";
  std::string name = device;
  if (name.find_first_not_of("0123456789") == std::string::npos) name.insert(0, prefix);
  if (const std::string last = name.substr(name.rfind('/') + 1); name.starts_with('/') && last.starts_with(prefix))
    name = last;
  return {"buffer of the IIO", "device " + name + (root.empty() ? "" : " below " + root),
          "list the channels of both in one"};
}

Registry standard_registry() {
  Registry registry;
  registry.add_bus<I2cConfig>(
      std::string(I2cBus::type), "an I2C adapter of the kernel",
      [](Runtime&, const std::string& name, const I2cConfig& config) { return I2cBus(name, config); });
  registry.add_bus<SpiConfig>(
      std::string(SpiBus::type), "an SPI controller of the kernel",
      [](Runtime&, const std::string& name, const SpiConfig& config) { return SpiBus(name, config); });
  registry.add_bus<SerialPortConfig>(
      std::string(SerialPort::type), "a serial line of the kernel, to devices that answer requests",
      [](Runtime&, const std::string& name, const SerialPortConfig& config) { return SerialPort(name, config); });
#ifdef RTDATA_WITH_MODBUS
  registry.add_bus<ModbusConfig>(
      std::string(ModbusBus::type), "devices that speak Modbus, on a serial line (RTU) or behind a server (TCP)",
      [](Runtime&, const std::string& name, const ModbusConfig& config) { return ModbusBus(name, config); });
#endif
  app::add_register_drivers(registry);
  app::add_i2c_drivers(registry);
  app::add_spi_drivers(registry);
  app::add_serial_drivers(registry);
#ifdef RTDATA_WITH_MODBUS
  registry.add_driver<Modbus>();
#endif
  registry.add_sensor<AnalogConfig>(
      "analog", "a sensor behind an analog-to-digital converter of the kernel",
      [](const AnalogConfig& config) { return analog_description(config.unit); },
      [](Loop& loop, const SensorConfig& common, const AnalogConfig& config) {
        return AnalogSensor(loop, common, config);
      },
      [](PartPlan&, const AnalogConfig&) {},
      {.notes = "An HX711 is such a converter, too: by the kernel's driver hx711.",
       .aliases = "adc potentiometer thermistor ntc photoresistor ldr hx711"});
#ifdef RTDATA_WITH_GPIO
  registry.add_sensor<CounterConfig>(
      "counter", "pulses on a GPIO line: their number, frequency, and what they stand for",
      [](const CounterConfig& config) { return counter_description(config); },
      [](Loop& loop, const SensorConfig& common, const CounterConfig& config) {
        return CounterSensor(loop, common, config);
      },
      [](PartPlan& plan, const CounterConfig& config) {
        plan.place = place_of(config.input.line.text, config.input.chip);
      });
  registry.add_sensor<EdgeConfig>(
      "edge", "the edges of a GPIO line, such as a button or a limit switch",
      [](const EdgeConfig&) { return Result(description_of<EdgeReading>()); },
      [](Loop& loop, const FeedConfig& common, const EdgeConfig& config) { return EdgeSensor(loop, common, config); },
      [](PartPlan& plan, const EdgeConfig& config) {
        plan.place = place_of(config.input.line.text, config.input.chip);
      });
  registry.add_sensor<LevelsConfig>(
      "gpio", "the levels of GPIO lines, sampled",
      [](const LevelsConfig& config) { return levels_description(config); },
      [](Loop& loop, const SensorConfig& common, const LevelsConfig& config) {
        return LevelsSensor(loop, common, config);
      },
      [](PartPlan& plan, const LevelsConfig& config) {
        for (const GpioLevel& level : config.lines) plan.more_places.push_back(place_of(level.line.text, level.chip));
      });
#endif
  registry.add_sensor<GpsConfig>(
      "gps", "a GPS receiver behind gpsd", [](const GpsConfig&) { return Result(description_of<GpsFix>()); },
      [](Loop& loop, const FeedConfig& common, const GpsConfig& config) { return GpsSensor(loop, common, config); });
  registry.add_sensor<EncoderConfig>(
      "encoder", "a counter of the kernel: a quadrature encoder, or pulses that hardware counts",
      [](const EncoderConfig& config) { return encoder_description(config); },
      [](Loop& loop, const SensorConfig& common, const EncoderConfig& config) {
        return EncoderSensor(loop, common, config);
      });
  registry.add_sensor<HostConfig>(
      "host", "what this computer knows of itself: load, memory, temperature and so on",
      [](const HostConfig& config) { return host_description(config.quantity); },
      [](Loop& loop, const SensorConfig& common, const HostConfig& config) {
        return HostSensor(loop, common, config);
      });
  registry.add_sensor<IioConfig>(
      "iio", "any IIO device of the kernel, asked channel by channel",
      [](const IioConfig& config) { return iio_description(config.channels); },
      [](Loop& loop, const SensorConfig& common, const IioConfig& config) { return IioSensor(loop, common, config); },
      [](PartPlan&, const IioConfig&) {},
      {.notes = "A DHT11, DHT22 or AM2302 has a driver of the kernel, dht11, and an HC-SR04 has srf04: a device tree "
                "overlay\n"
                "names the line (on a Raspberry Pi `dtoverlay=dht11,gpiopin=4`), and then they are IIO devices, which\n"
                "`rtdata scan` finds.",
       .aliases = "dht11 dht22 am2302 hc-sr04 ultrasonic humidity"});
  registry.add_sensor<IioBufferConfig>(
      "iio_buffer", "any IIO device of the kernel, at the rate of its trigger, from its buffer",
      [](const IioBufferConfig& config) { return iio_description(config.channels); },
      [](Loop& loop, const FeedConfig& common, const IioBufferConfig& config) {
        return IioBufferSensor(loop, common, config);
      },
      [](PartPlan& plan, const IioBufferConfig& config) { plan.place = buffer_of(config.device, config.root); });
#ifdef RTDATA_WITH_MQTT
  registry.add_sensor<MqttSensorConfig>(
      "mqtt", "the messages of a broker of MQTT, such as a phone's or an ESP32's",
      [](const MqttSensorConfig& config) { return mqtt_description(config); },
      [](Loop& loop, const FeedConfig& common, const MqttSensorConfig& config) {
        return MqttSensor(loop, common, config);
      },
      [](PartPlan& plan, const MqttSensorConfig& config) { plan.stored_by = config.stored_by; });
#endif
  registry.add_sensor<PpsConfig>(
      "pps", "pulses per second, as the kernel times them; a source of the time of day",
      [](const PpsConfig&) { return Result(description_of<PpsPulse>()); },
      [](Loop& loop, const FeedConfig& common, const PpsConfig& config) { return PpsSensor(loop, common, config); });
  if (Expression::available()) {
    registry.add_sensor<DerivedConfig>(
        "derived", "values computed by expressions from those of other topics",
        [](const DerivedConfig& config) { return derived_description(config); },
        [](Loop& loop, const FeedConfig& common, const DerivedConfig& config) {
          return DerivedSensor(loop, common, config);
        },
        [](PartPlan& plan, const DerivedConfig& config) {
          plan.check_topics = [config](const PartPlan& part, const PartPlan::PayloadOf& payload_of,
                                       Problems& problems) {
            check_derived_names(config, payload_of, part.item, problems);
          };
        });
    registry.add_sensor<TriggerConfig>(
        "trigger", "the events of another topic while a condition holds, and from some time before that on",
        [](const TriggerConfig&) { return Result(std::shared_ptr<const Description>()); },
        [](Loop& loop, const FeedConfig& common, const TriggerConfig& config) {
          return TriggerSensor(loop, common, config);
        },
        [](PartPlan& plan, const TriggerConfig& config) {
          plan.passes_on = config.on;
          plan.check_topics = [config](const PartPlan& part, const PartPlan::PayloadOf& payload_of,
                                       Problems& problems) {
            check_trigger_names(config, payload_of, part.item, problems);
          };
        });
  } else {
    for (const char* type : {"derived", "trigger"})
      registry.leave_out("sensor", type, "this program was built without muParser");
  }
  registry.add_sensor<LimitConfig>(
      "limit", "alarms of a number of another topic: limits with hysteresis, delay, and a latch",
      [](const LimitConfig&) { return Result(description_of<Alarm>()); },
      [](Loop& loop, const FeedConfig& common, const LimitConfig& config) { return LimitSensor(loop, common, config); },
      [](PartPlan& plan, const LimitConfig& config) {
        plan.check_topics = [config](const PartPlan& part, const PartPlan::PayloadOf& payload_of, Problems& problems) {
          check_limit_field(config, payload_of, part.item, problems);
        };
        for (const char* key :
             {"low_low", "low", "high", "high_high", "hysteresis", "delay", "latched", "silence", "join"})
          plan.live[key] = [config](const PartObject& part) { part.as<LimitSensor>()->change(config); };
      });
  app::add_machines(registry);
  registry.add_sensor<W1Config>(
      "w1", "temperature of a DS18B20 or the like on 1-Wire",
      [](const W1Config&) { return Result(description_of<W1Temperature>()); },
      [](Loop& loop, const SensorConfig& common, const W1Config& config) { return W1Sensor(loop, common, config); });
  registry.add_sensor<SerialConfig>(
      "serial", "a device that sends lines of CSV, JSON or NMEA over a serial line",
      [](const SerialConfig& config) { return serial_description(config); },
      [](Loop& loop, const FeedConfig& common, const SerialConfig& config) {
        return SerialLineSensor(loop, common, config);
      },
      [](PartPlan& plan, const SerialConfig& config) {
        plan.place = {"", config.device, ""};
      });
#ifdef RTDATA_WITH_SQLITE
  registry.add_part<ReplayConfig>("sensor", "replay", "the events of a recording, as they came or faster",
                                  [](PartPlan& plan, const ReplayConfig& config) {
                                    plan.name = config.name.empty() ? ReplayConfig{}.name : config.name;
                                    plan.make = [config](Loop& loop, const Parts&) {
                                      return PartObject::made_by<Handle>([&] { return Replay(loop, config); });
                                    };
                                  });
  registry.add_sink<SqliteConfig>(
      "sqlite", "a SQLite file that describes itself and can be verified",
      [](const SqliteConfig& config) { return config.path; },
      [](Loop& loop, const SqliteConfig& config) { return SqliteSink(loop, config); });
#endif
  registry.add_sink<ShippedFileConfig>(
      "file", "a file of JSON lines, CSV, CBOR, lines of InfluxDB or raw bytes",
      [](const ShippedFileConfig& config) { return config.path; },
      [](Loop& loop, const ShippedFileConfig& config) { return FileSink(loop, config); });
#ifdef RTDATA_WITH_POSTGRESQL
  registry.add_sink<PostgresqlConfig>(
      "postgresql", "tables of a PostgreSQL server, each event exactly once",
      [](const PostgresqlConfig&) { return std::string(); },
      [](Loop& loop, const PostgresqlConfig& config) { return PostgresqlSink(loop, config); });
#endif
#ifdef RTDATA_WITH_HTTP
  registry.add_sink<ShippedHttpConfig>(
      "http", "a server, by HTTP or HTTPS: JSON, JSON lines, CBOR, lines of InfluxDB",
      [](const ShippedHttpConfig&) { return std::string(); },
      [](Loop& loop, const ShippedHttpConfig& config) { return HttpSink(loop, config); });
#endif
  registry.add_sink<ConsoleConfig>(
      "console", "lines for people, on standard output",
      [](const ConsoleConfig& config) { return std::string(config.descriptor == 1 ? "-" : ""); },
      [](Loop& loop, const ConsoleConfig& config) { return ConsoleSink(loop, config); });
#ifdef RTDATA_WITH_MQTT
  registry.add_sink<ShippedMqttConfig>(
      "mqtt", "a message an event, to a broker of MQTT", [](const ShippedMqttConfig&) { return std::string(); },
      [](Loop& loop, const ShippedMqttConfig& config) { return MqttSink(loop, config); });
#endif
  registry.add_sink<ShippedTcpConfig>(
      "tcp", "a server that listens on a TCP port", [](const ShippedTcpConfig&) { return std::string(); },
      [](Loop& loop, const ShippedTcpConfig& config) { return TcpSink(loop, config); });
  registry.add_sink<ShippedUdpConfig>(
      "udp", "a datagram an event, for programs that draw what comes, such as PlotJuggler",
      [](const ShippedUdpConfig&) { return std::string(); },
      [](Loop& loop, const ShippedUdpConfig& config) { return UdpSink(loop, config); });
#ifdef RTDATA_WITH_GPIO
  registry.add_output<GpioActuatorConfig>(
      "gpio", "a GPIO line", [](const GpioActuatorConfig& config) { return std::make_unique<GpioActuator>(config); },
      [](PartPlan& plan, const GpioActuatorConfig& config) { plan.place = place_of(config.line.text, config.chip); },
      {.aliases = "relay led valve lamp pump heater buzzer"});
#endif
  registry.add_output<PwmConfig>(
      "pwm", "the duty cycle of a channel of a PWM chip of the kernel",
      [](const PwmConfig& config) { return std::make_unique<PwmActuator>(config); },
      [](PartPlan& plan, const PwmConfig& config) {
        plan.place = {"PWM chip",
                      std::to_string(config.chip) + ", channel " + std::to_string(config.channel) +
                          (config.root == PwmConfig{}.root ? "" : ", below " + config.root),
                      ""};
      });
  registry.add_output<SerialActuatorConfig>(
      "serial", "a device on a serial line that is set by a text",
      [](const SerialActuatorConfig& config) { return std::make_unique<SerialActuator>(config); },
      [](PartPlan& plan, const SerialActuatorConfig& config) {
        plan.place = {"", config.device, ""};
      });
#ifdef RTDATA_WITH_MQTT
  registry.add_output<MqttActuatorConfig>(
      "mqtt", "a device that is set by a message to a broker of MQTT",
      [](const MqttActuatorConfig& config) { return std::make_unique<MqttActuator>(config); },
      [](PartPlan& plan, const MqttActuatorConfig& config) {
        plan.place = {"MQTT topic", config.to + " of " + config.broker.host + ", message " + config.text, ""};
        plan.place.more = std::to_string(config.broker.port);
      });
#endif
#ifdef RTDATA_WITH_HTTP
  registry.add_output<HttpActuatorConfig>(
      "http", "a device that is set by a request to a URL",
      [](const HttpActuatorConfig& config) { return std::make_unique<HttpActuator>(config); },
      [](PartPlan& plan, const HttpActuatorConfig& config) {
        const auto url = detail::parse_http_url(config.server.url);
        if (!url) return;
        plan.place = {"server", url->origin, "two outputs that send the same requests set one device"};
        plan.place.more = config.server.url.substr(config.server.url.find("//") + 2) + " " + config.text;
        if (config.method == HttpSetMethod::get) plan.place.more.resize(plan.place.more.size() - config.text.size());
      });
#endif
#ifndef RTDATA_WITH_GPIO
  for (const char* type : {"counter", "edge", "gpio"})
    registry.leave_out("sensor", type, "this program was built without libgpiod");
  registry.leave_out("output", "gpio", "this program was built without libgpiod");
#endif
#ifndef RTDATA_WITH_MODBUS
  for (const char* kind : {"bus", "sensor"})
    registry.leave_out(kind, "modbus", "this program was built without libmodbus");
#endif
#ifndef RTDATA_WITH_SQLITE
  registry.leave_out("sink", "sqlite", "this program was built without SQLite");
#endif
#ifndef RTDATA_WITH_MQTT
  for (const char* kind : {"output", "sensor", "sink"})
    registry.leave_out(kind, "mqtt", "this program was built without libmosquitto");
#endif
#ifndef RTDATA_WITH_HTTP
  for (const char* kind : {"output", "sink"})
    registry.leave_out(kind, "http", "this program was built without libcurl");
#endif
#ifndef RTDATA_WITH_POSTGRESQL
  registry.leave_out("sink", "postgresql", "this program was built without libpq");
#endif
  return registry;
}

}  // namespace rtdata
