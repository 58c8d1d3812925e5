#include <algorithm>

#include "app/core/standard_drivers.hpp"
#include "rtdata/sinks/console.hpp"
#include "rtdata/sinks/file.hpp"
#include "rtdata/sinks/tcp.hpp"
#include "rtdata/sinks/udp.hpp"
#ifdef RTDATA_WITH_HTTP
#include "rtdata/sinks/http.hpp"
#endif
#ifdef RTDATA_WITH_MQTT
#include "rtdata/sinks/mqtt.hpp"
#endif
#ifdef RTDATA_WITH_POSTGRESQL
#include "rtdata/sinks/postgresql.hpp"
#endif

namespace rtdata::app {
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
    check_format(format_of(config), {"jsonl"}, item, problems);
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

void add_shipped_sinks(Registry& registry) {
  registry.add_sink<ShippedFileConfig>(
      "file", "a file of JSON lines, CSV, CBOR, lines of InfluxDB or raw bytes",
      [](const ShippedFileConfig& config) { return config.path; }, makes<FileSink>);
#ifdef RTDATA_WITH_POSTGRESQL
  registry.add_sink<PostgresqlConfig>(
      "postgresql", "tables of a PostgreSQL server, each event exactly once",
      [](const PostgresqlConfig&) { return std::string(); }, makes<PostgresqlSink>);
#endif
#ifdef RTDATA_WITH_HTTP
  registry.add_sink<ShippedHttpConfig>(
      "http", "a server, by HTTP or HTTPS: JSON, JSON lines, CBOR, lines of InfluxDB",
      [](const ShippedHttpConfig&) { return std::string(); }, makes<HttpSink>);
#endif
  registry.add_sink<ConsoleConfig>(
      "console", "lines for people, on standard output",
      [](const ConsoleConfig& config) { return std::string(config.descriptor == 1 ? "-" : ""); }, makes<ConsoleSink>);
#ifdef RTDATA_WITH_MQTT
  registry.add_sink<ShippedMqttConfig>(
      "mqtt", "a message an event, to a broker of MQTT", [](const ShippedMqttConfig&) { return std::string(); },
      makes<MqttSink>);
#endif
  registry.add_sink<ShippedTcpConfig>(
      "tcp", "a server that listens on a TCP port", [](const ShippedTcpConfig&) { return std::string(); },
      makes<TcpSink>);
  registry.add_sink<ShippedUdpConfig>(
      "udp", "a datagram an event, for programs that draw what comes, such as PlotJuggler",
      [](const ShippedUdpConfig&) { return std::string(); }, makes<UdpSink>);
}

}  // namespace rtdata::app
