/// MqttSensor: the messages of topics of an MQTT broker, as a phone, an ESP32 or another rt-data sends them.
///
///     rtdata::MqttSensor phone(loop, {.name = "phone"}, {.broker = {.host = "broker.local"},
///                                                        .topics = {"phones/+/battery"},
///                                                        .fields = {{.name = "level", .unit = "%"},
///                                                                   {.name = "from", .type = Kind::text,
///                                                                    .key = "$topic", .length = 60}}});
///
/// Each message becomes one event, whose fields are the configured ones; its time is that of the read which brought it.
///
/// - A message is an object of JSON, keys in any order, others ignored, "imu.ax" as a `key` for levels; or a line of
///   CSV, which a number alone is, too. The key "$topic" stands for the topic that the message came on, "$retained" for
///   whether the broker had kept it from before.
/// - What cannot be used (no JSON, a field missing, no number, out of its type's range, longer than `max_message`) is
///   counted as unreadable and reported, and costs no other message anything.
/// - Retained messages are values of an unknown time: unless `retained` is "take" they make no event; those that the
///   broker sends nevertheless are counted as repeated.
/// - A broker that is away, refuses the connection, or all subscriptions, makes the sensor faulted; it is connected to
///   again after `retry_first`, doubling to `retry_longest`. The time without it is a gap (disconnected). When it
///   refuses some subscriptions, the sensor is degraded, and the others bring events.
/// - QoS 0: what comes while the connection is lost is gone. QoS 1: the broker sends again what it had no answer to, so
///   that a message may come twice, as two events. QoS 2: once within a connection. What the broker keeps while this
///   sensor is away depends on `session`.
/// - With `stored_by` the broker gets its answer once that sink has stored the events: a program that is killed, or a
///   machine that loses power, then loses nothing that came (QoS 1).
///
/// The library `rtdata::mqtt`, which needs libmosquitto. Connecting and looking up names happen on a lane, all else on
/// the loop, at most 256 messages in a turn of it.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "rtdata/net/mqtt.hpp"
#include "rtdata/sensors/serial_line.hpp"

namespace rtdata {

enum class MqttFormat { json, csv };
constexpr auto describe(type_tag<MqttFormat>) {
  return enumeration("format", value("json", MqttFormat::json), value("csv", MqttFormat::csv));
}
enum class MqttRetained { skip, take };
constexpr auto describe(type_tag<MqttRetained>) {
  return enumeration("retained", value("skip", MqttRetained::skip), value("take", MqttRetained::take));
}

struct MqttSensorConfig {
  MqttBroker broker = {};
  std::vector<std::string> topics = {};  ///< what is subscribed to, "+" and "#" in it; "$share/GROUP/..." with others
  std::uint8_t qos = 1;
  MqttFormat format = MqttFormat::json;
  std::vector<LineField> fields = {};
  char separator = ',';             ///< between the columns of CSV
  std::size_t max_message = 65536;  ///< bytes; a longer one is unreadable
  MqttRetained retained = MqttRetained::skip;
  Duration session{0};         ///< the broker keeps what comes for so long while this is away; 0: not at all
  std::string stored_by = {};  ///< name of a sink of the same loop that has stored a message before it is answered
  Duration silence{0};         ///< silent for longer, it has a gap; 0: it may be silent
  Duration retry_first = std::chrono::milliseconds{100};  ///< wait before a lost broker is connected to again
  Duration retry_longest = std::chrono::seconds{10};      ///< the wait doubles up to this
  bool start = true;                                      ///< start when made

  friend constexpr auto parameters(type_tag<MqttSensorConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        include_member(&MqttSensorConfig::broker),
        parameter("topics", &MqttSensorConfig::topics,
                  "of the messages: + for one level, # for all below; $share/GROUP/... shares them with others",
                  rtdata::required),
        parameter("qos", &MqttSensorConfig::qos, "0: at most once, 1: at least once, 2: once for each connection",
                  range(0, 2)),
        parameter("format", &MqttSensorConfig::format, "how a message is written; a number alone is csv"),
        parameter("fields", &MqttSensorConfig::fields, "what is in a message", rtdata::required),
        parameter("separator", &MqttSensorConfig::separator, "between the columns of CSV", only_with("format", "csv")),
        parameter("max_message", &MqttSensorConfig::max_message, "a longer message is unreadable", rtdata::unit("By"),
                  range(16, 1048576)),
        parameter("retained", &MqttSensorConfig::retained,
                  "what the broker has kept from before: skip it, or take it as if it came now"),
        parameter("session", &MqttSensorConfig::session,
                  "so long the broker keeps what comes while this is away; needs `client_id`; 0: not at all",
                  range(Duration{0}, Duration{87600h})),
        parameter("stored_by", &MqttSensorConfig::stored_by,
                  "a sink: the broker hears that a message has come once this has stored it", names_part("sink")),
        parameter("silence", &MqttSensorConfig::silence, "silent for longer, it is degraded and has a gap; 0: never",
                  range(Duration{0}, Duration{24h})),
        parameter("retry_first", &MqttSensorConfig::retry_first, "wait before a lost broker is connected to again",
                  range(Duration{1ms}, Duration{1h})),
        parameter("retry_longest", &MqttSensorConfig::retry_longest, "the wait doubles up to this",
                  range(Duration{1ms}, Duration{24h})),
        parameter("start", &MqttSensorConfig::start, "start it with the system"));
  }
};

/// The description of the events: "message", with `fields`. Errors: bad-description, bad-argument.
Result<std::shared_ptr<const Description>> mqtt_description(const MqttSensorConfig& config);

/// What no parameter says by itself: topics, fields and settings that go together.
void check_config(const MqttSensorConfig& config, const ConfigItem& item, Problems& problems);
/// How long the longest read takes: 256 short messages.
ReadTime read_time(const MqttSensorConfig& config);

class MqttSensor : public AnySensor {
 public:
  MqttSensor() noexcept = default;
  /// SetupError: as `Feed`; bad-argument for a configuration that cannot work; not-found (no such sink as `stored_by`).
  MqttSensor(Loop& loop, FeedConfig feed, MqttSensorConfig config);

 private:
  explicit MqttSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
