#include <algorithm>
#include <type_traits>

#include "app/core/standard_drivers.hpp"
#include "config/read/mistakes.hpp"
#include "data/listed.hpp"
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
#include "rtdata/postgresql/sink.hpp"
#endif

namespace rtdata::app {
namespace {

/// Accepts only the included formats and those of this sink.
void check_format(const std::string& name, std::initializer_list<const char*> own, const ConfigItem& item,
                  Problems& problems) {
  std::vector<std::string> formats = CodecRegistry::standard().names();
  formats.insert(formats.end(), own.begin(), own.end());
  if (std::find(formats.begin(), formats.end(), name) != formats.end()) return;
  std::string message = "there is no format \"" + name + "\"";
  std::string nearest = nearest_name(name, formats);
  if (nearest.empty()) message += "; available: " + detail::listed(formats, " ");
  problems.add(
      config_detail::child_or_self(item, "format").problem("unknown-choice", std::move(message), std::move(nearest)));
}

template <class Config>
struct Shipped : Config {
  friend constexpr auto parameters(type_tag<Shipped>) { return parameter_list(include<Config>); }
  friend void check_config(const Shipped& config, const ConfigItem& item, Problems& problems) {
    check_config(static_cast<const Config&>(config), item, problems);
    if constexpr (std::is_same_v<Config, FileConfig>) {
      check_format(format_of(config), {"jsonl"}, item, problems);
    } else if constexpr (std::is_same_v<Config, UdpConfig>) {
      check_format(config.format, {"fields", "jsonl"}, item, problems);
    } else {
      check_format(config.format, {"jsonl"}, item, problems);
    }
  }
};

}  // namespace

void add_shipped_sinks(Registry& registry) {
  const auto no_path = [](const auto&) { return std::string(); };
  registry.add_sink<Shipped<FileConfig>>(
      "file", "a file of JSON lines, CSV, CBOR, lines of InfluxDB or raw bytes",
      [](const Shipped<FileConfig>& config) { return config.path; }, makes<FileSink>);
#ifdef RTDATA_WITH_POSTGRESQL
  registry.add_sink<PostgresqlConfig>("postgresql", "tables of a PostgreSQL server, each event exactly once", no_path,
                                      makes<PostgresqlSink>);
#endif
#ifdef RTDATA_WITH_HTTP
  registry.add_sink<Shipped<HttpConfig>>(
      "http", "a server, by HTTP or HTTPS: JSON, JSON lines, CBOR, lines of InfluxDB", no_path, makes<HttpSink>);
#endif
  registry.add_sink<ConsoleConfig>(
      "console", "readable lines, on standard output",
      [](const ConsoleConfig& config) { return std::string(config.descriptor == 1 ? "-" : ""); }, makes<ConsoleSink>);
#ifdef RTDATA_WITH_MQTT
  registry.add_sink<Shipped<MqttConfig>>("mqtt", "one message per event, to a broker of MQTT", no_path,
                                         makes<MqttSink>);
#endif
  registry.add_sink<Shipped<TcpConfig>>("tcp", "a server that listens on a TCP port", no_path, makes<TcpSink>);
  registry.add_sink<Shipped<UdpConfig>>(
      "udp", "one datagram per event, for programs that draw what comes, such as PlotJuggler", no_path, makes<UdpSink>);
}

}  // namespace rtdata::app
