/// MqttSink: sends each event as a message to an MQTT 5 or 3.1.1 broker.
///
///     rtdata::MqttSink plant(loop, {.broker = {.host = "broker.local"}, .topic = "plant/{topic}", .qos = 1,
///                                   .sink = {.through = "run.db"}});
///
/// `{topic}` and `{origin}` in `topic` are replaced by those of the event; characters that MQTT does not allow (+ and #
/// in an origin) become _. The payload is an event in a format: "json" (its default), "cbor", "influx", "raw", or one
/// of the program's.
///
/// Guarantees: with `qos` 1 or 2 the sink keeps an event until the broker has confirmed it. After a lost connection it
/// sends unconfirmed events again, so they may arrive twice (also with QoS 2, because the session ends with the
/// connection). With `qos` 0 an event counts as sent when the kernel has taken it. With MQTT 5, a message that the
/// broker refuses (for example by an ACL) is reported, dropped and counted; a broker of MQTT 3.1.1 confirms discarded
/// messages too, and with QoS 0 there is no answer. While a broker refuses the connection (password, name), the sink is
/// faulted and events wait.
///
/// Library `rtdata::mqtt`, which needs libmosquitto. Connecting and name lookup run on a lane, the rest on the loop,
/// with a limited number of messages in one turn.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's; events are encoded on the sink's lane.
/// Errors of the constructor (SetupError): bad-argument (no host, a topic that MQTT does not take, csv), not-found (no
/// such format); those of `Sink`.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "rtdata/data/codec.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/net/mqtt.hpp"
#include "rtdata/sinks/sender.hpp"

namespace rtdata {

class ConfigItem;
class Problems;

/// What the broker publishes when the connection is lost.
struct MqttWill {
  std::string topic = {};
  std::string message = {};
  std::uint8_t qos = 0;
  bool retain = false;

  friend constexpr auto parameters(type_tag<MqttWill>) {
    return parameter_list(parameter("topic", &MqttWill::topic, "topic on which the broker publishes it", required),
                          parameter("message", &MqttWill::message, "what it publishes when the connection is lost"),
                          parameter("qos", &MqttWill::qos, "0, 1 or 2", range(0, 2)),
                          parameter("retain", &MqttWill::retain, "the broker keeps it for later subscribers"));
  }
};

struct MqttConfig {
  MqttBroker broker = {};
  std::string topic = "{topic}";
  std::string format = "json";
  std::uint8_t qos = 1;
  bool retain = false;               ///< the broker keeps the last message of each topic for later subscribers
  bool wait_for_subscriber = false;  ///< repeat an event until there is a subscriber
  std::optional<MqttWill> will = {};
  SendingConfig sending = {.window = 4, .parcel_rows = 100};
  SinkConfig sink = {.batch_time = std::chrono::milliseconds{100}};  ///< name: "mqtt" by default

  friend constexpr auto parameters(type_tag<MqttConfig>) {
    return parameter_list(
        include_member(&MqttConfig::broker),
        parameter("topic", &MqttConfig::topic, "topic of a message; {topic} and {origin} are those of the event",
                  placeholders("topic", "origin")),
        parameter("format", &MqttConfig::format, "json, cbor, influx or raw"),
        parameter("qos", &MqttConfig::qos, "0: at most once, 1: at least once, 2: once for each connection",
                  range(0, 2)),
        parameter("retain", &MqttConfig::retain, "the broker keeps the last message for later subscribers"),
        parameter("wait_for_subscriber", &MqttConfig::wait_for_subscriber,
                  "an event without a subscriber waits until there is one; version 5, qos 1"),
        parameter("will", &MqttConfig::will, "what the broker publishes when the connection is lost"),
        include_member(&MqttConfig::sending), include_member(&MqttConfig::sink));
  }
};

/// Checks rules over several parameters: a valid host, valid topics, and a format that can be sent.
void check_config(const MqttConfig& config, const ConfigItem& item, Problems& problems);

class MqttSink : public Sink {
 public:
  MqttSink() noexcept = default;
  /// `formats` is used during the call only.
  MqttSink(Loop& loop, MqttConfig config, const CodecRegistry& formats = CodecRegistry::standard());
};

}  // namespace rtdata
