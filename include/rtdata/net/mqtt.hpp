/// MqttBroker: the address and connection settings of an MQTT broker, for the sink, the sensor and the output.
///
///     rtdata::MqttBroker broker{.host = "broker.local", .user = "node", .tls = rtdata::TlsConfig{}};
///
/// A value; any thread.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>

#include "rtdata/data/parameter.hpp"
#include "rtdata/net/tls.hpp"

namespace rtdata {

enum class MqttVersion {
  newest,  ///< 5, or 3.1.1 if the broker does not support 5
  v5,
  v311,
};
constexpr auto describe(type_tag<MqttVersion>) {
  return enumeration("version", value("newest", MqttVersion::newest), value("5", MqttVersion::v5),
                     value("3.1.1", MqttVersion::v311));
}

struct MqttBroker {
  std::string host = "localhost";
  std::uint16_t port = 0;  ///< 0: 1883, with TLS 8883
  MqttVersion version = MqttVersion::newest;
  std::string client_id = {};  ///< empty: the broker chooses
  std::string user = {};
  std::string password = {};
  std::optional<TlsConfig> tls = {};
  Duration keepalive = std::chrono::seconds{30};        ///< longest silence before a ping
  Duration connect_timeout = std::chrono::seconds{10};  ///< includes the name lookup

  friend constexpr auto parameters(type_tag<MqttBroker>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("host", &MqttBroker::host, "host name or IP address of the broker"),
        parameter("port", &MqttBroker::port, "port of the broker; 0: 1883, with `tls` 8883"),
        parameter("version", &MqttBroker::version, "version of MQTT"),
        parameter("client_id", &MqttBroker::client_id, "client id at the broker; empty: the broker chooses one"),
        parameter("user", &MqttBroker::user, "user name at the broker"),
        parameter("password", &MqttBroker::password,
                  "password of the user, written as {\"env\": ...} or {\"file\": ...}"),
        parameter("tls", &MqttBroker::tls,
                  "encrypts the connection; {} is enough if a public authority signed the broker's certificate"),
        parameter("keepalive", &MqttBroker::keepalive, "longest silence on the connection before a ping is sent",
                  range(5s, 18h)),
        parameter("connect_timeout", &MqttBroker::connect_timeout, "how long connecting may take", range(10ms, 10min)));
  }
};

}  // namespace rtdata
