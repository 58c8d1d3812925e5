/// MqttActuator: an output device that is set by a message to an MQTT broker.
///
///     rtdata::MqttActuator pump({.broker = {.host = "broker.local"}, .to = "garden/pump/set",
///                                .words = {{"0", "OFF"}, {"1", "ON"}}});
///
/// A value is set when the broker has confirmed the message (with `qos` 0: when it was written to the connection),
/// within `timeout`. The broker does not tell if a device has received it.
///
/// The connection stays open while the output holds the device. The first value, which is the output's safe value, is
/// the connection's will: the broker publishes it when the connection is lost, for example by a power failure here, at
/// once or after 1.5 times `keepalive`. With `keep` there is no will.
///
/// Library `rtdata::mqtt`, which needs libmosquitto. The connection has its own thread, which is abandoned if the name
/// servers do not answer.
///
/// Errors: bad-argument (an invalid host or topic); disconnected (no connection, or no answer in time: an output starts
/// anyway and tries again); not-permitted (the broker refuses the connection or, with MQTT 5, the message; a broker of
/// MQTT 3.1.1 confirms messages even if it discards them).
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>

#include "rtdata/net/mqtt.hpp"
#include "rtdata/outputs/output.hpp"

namespace rtdata {

struct MqttActuatorConfig {
  MqttBroker broker = {.keepalive = std::chrono::seconds{10}};
  std::string to = {};                            ///< the topic
  std::string text = "{value}";                   ///< the message; `{value}`: the shortest exact number: 1, 0.5
  std::map<std::string, std::string> words = {};  ///< texts to send for values: {"0": "OFF", "1": "ON"}
  std::uint8_t qos = 1;
  bool retain = false;                         ///< the broker keeps the last message for devices that connect later
  Duration timeout = std::chrono::seconds{1};  ///< from connecting to the confirmation

  friend constexpr auto parameters(type_tag<MqttActuatorConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        include_member(&MqttActuatorConfig::broker),
        parameter("to", &MqttActuatorConfig::to, "topic of the message", required),
        parameter("text", &MqttActuatorConfig::text, "the message; {value} stands for the value",
                  placeholders("value")),
        parameter("words", &MqttActuatorConfig::words,
                  "text that replaces {value}, for each value: {\"0\": \"OFF\", \"1\": \"ON\"}"),
        parameter("qos", &MqttActuatorConfig::qos, "0: at most once, 1: at least once, 2: exactly once", range(0, 2)),
        parameter("retain", &MqttActuatorConfig::retain,
                  "true: the broker keeps the last message for later subscribers"),
        parameter("timeout", &MqttActuatorConfig::timeout, "time limit from connecting to the broker's confirmation",
                  range(Duration{10ms}, Duration{1500ms})));
  }
  friend void check_config(const MqttActuatorConfig& config, const ConfigItem& item, Problems& problems);
};
/// Sends nothing.
void check_config(const MqttActuatorConfig& config, const ConfigItem& item, Problems& problems);

class MqttActuator : public CheckedActuator {
 public:
  explicit MqttActuator(MqttActuatorConfig config);
  MqttActuator(const MqttActuator&) = delete;
  MqttActuator& operator=(const MqttActuator&) = delete;
  /// Disconnects properly, so that the broker does not publish the will.
  ~MqttActuator() override;
  Result<void> open(std::optional<double> value) override;
  Result<void> set(double value) override;
  Result<void> check() override;

 private:
  struct Link;
  const MqttActuatorConfig config_;
  std::shared_ptr<Link> link_;
};

}  // namespace rtdata
