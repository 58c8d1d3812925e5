/// MqttSensor: messages of an MQTT broker, for example from a phone, an ESP32 or another rt-data.
///
///     rtdata::MqttSensor phone(loop, {.name = "phone"}, {.broker = {.host = "broker.local"},
///                                                        .topics = {"phones/+/battery"},
///                                                        .fields = {{.name = "level", .unit = "%"},
///                                                                   {.name = "from", .type = rtdata::Kind::text,
///                                                                    .key = "$topic", .length = 60}}});
///
/// Each message becomes one event with the configured fields; its time is the time of the read.
///
/// - A message is an object of JSON, keys in any order, others ignored, "imu.ax" as a `key` for levels; or a line of
///   CSV; a number alone is one, too. The key "$topic" is the topic of the message, "$retained" whether it is a
///   retained message.
/// - An unusable message (not JSON, a missing field, not a number, out of its type's range, longer than `max_message`)
///   is counted as unreadable and reported; other messages are not affected.
/// - Retained messages have an unknown time: unless `retained` is "take" they give no event; if the broker sends them
///   anyway, they are counted as repeated.
/// - If the broker is away, or refuses the connection or all subscriptions, the sensor is faulted and connects again
///   after `retry_first`, doubling to `retry_longest`. The time without the broker is a gap (disconnected). If it
///   refuses only some subscriptions, the sensor is degraded, and the others give events.
/// - QoS 0: messages during a lost connection are lost. QoS 1: the broker repeats messages without an acknowledgement,
///   so a message may give two events. QoS 2: once within a connection. `session` decides what the broker keeps while
///   this sensor is away.
/// - With `stored_by` a message is acknowledged after that sink has stored its event: a kill or a power failure then
///   loses no received message (QoS 1).
///
/// Library `rtdata::mqtt`, which needs libmosquitto. Connecting and name lookup run on a lane, the rest on the loop, at
/// most 256 messages in one turn.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "rtdata/net/mqtt.hpp"
#include "rtdata/sensors/lines.hpp"

namespace rtdata {

enum class MqttRetained { skip, take };
constexpr auto describe(type_tag<MqttRetained>) {
  return enumeration("retained", value("skip", MqttRetained::skip), value("take", MqttRetained::take));
}

struct MqttSensorConfig {
  MqttBroker broker = {};
  std::vector<std::string> topics = {};  ///< subscriptions, with "+" and "#"; "$share/GROUP/..." for a shared one
  std::uint8_t qos = 1;
  LineFormat format = LineFormat::json;
  std::vector<LineField> fields = {};
  char separator = ',';                         ///< between the columns of CSV
  std::string pattern = {};                     ///< of `format` pattern (lines.hpp)
  std::optional<LineMatch> only = {};           ///< which messages become events; others count as filtered
  std::optional<LineMatch> unreadable_if = {};  ///< messages that mean that the device has no value
  std::size_t max_message = 65536;              ///< bytes; a longer one is unreadable
  MqttRetained retained = MqttRetained::skip;
  Duration session{0};         ///< how long the broker keeps messages for this sensor; 0: not at all
  std::string stored_by = {};  ///< name of a sink of this loop: acknowledge after it has stored the event
  Duration silence{0};         ///< without a message for longer, it has a gap; 0: no limit
  Duration retry_first = std::chrono::milliseconds{
      100};  ///< first delay before the program connects to a lost broker again
  Duration retry_longest = std::chrono::seconds{10};  ///< the delay doubles up to this
  bool start = true;                                  ///< start when made

  friend constexpr auto parameters(type_tag<MqttSensorConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        include_member(&MqttSensorConfig::broker),
        parameter("topics", &MqttSensorConfig::topics,
                  "topics of the messages: + for one level, # for all below; $share/GROUP/... shares them with others",
                  rtdata::required),
        parameter("qos", &MqttSensorConfig::qos, "0: at most once, 1: at least once, 2: once for each connection",
                  range(0, 2)),
        parameter("format", &MqttSensorConfig::format, "format of a message; a number alone is csv",
                  choices(value("json", LineFormat::json), value("csv", LineFormat::csv),
                          value("labels", LineFormat::labels), value("pattern", LineFormat::pattern))),
        parameter("fields", &MqttSensorConfig::fields, "values in a message", rtdata::required),
        parameter("separator", &MqttSensorConfig::separator,
                  "character between the columns of CSV, or between label and value",
                  only_with("format", "csv", "labels")),
        parameter("pattern", &MqttSensorConfig::pattern, "a regular expression with a named group for each field",
                  only_with("format", "pattern")),
        parameter("only", &MqttSensorConfig::only, "which messages become events; others count as filtered"),
        parameter("unreadable_if", &MqttSensorConfig::unreadable_if,
                  "messages by which the device says that it has no value"),
        parameter("max_message", &MqttSensorConfig::max_message, "a longer message is unreadable", rtdata::unit("By"),
                  range(16, 1048576)),
        parameter("retained", &MqttSensorConfig::retained,
                  "messages that the broker has kept from earlier: skip them, or treat them as if they came now"),
        parameter("session", &MqttSensorConfig::session,
                  "how long the broker keeps messages while this program is away; needs `client_id`; 0: not at all",
                  range(Duration{0}, Duration{87600h})),
        parameter("stored_by", &MqttSensorConfig::stored_by,
                  "a sink: a message is confirmed to the broker when this sink has stored it", names_part("sink")),
        parameter("silence", &MqttSensorConfig::silence,
                  "after this time without data, the sensor is degraded and has a gap; 0: never",
                  range(Duration{0}, Duration{24h})),
        parameter("retry_first", &MqttSensorConfig::retry_first,
                  "first delay before the program connects to a lost broker again", range(Duration{1ms}, Duration{1h})),
        parameter("retry_longest", &MqttSensorConfig::retry_longest, "the delay doubles up to this",
                  range(Duration{1ms}, Duration{24h})),
        parameter("start", &MqttSensorConfig::start, "start it with the system"));
  }
};

/// The description of the events: "message", with `fields`. Errors: bad-description, bad-argument.
Result<std::shared_ptr<const Description>> mqtt_description(const MqttSensorConfig& config);

/// Checks rules over several parameters: topics, fields and settings that go together.
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
