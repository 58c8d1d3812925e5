/// SerialActuator: an output device that is set by sending it a text, on a serial line or a TCP connection.
///
///     rtdata::Output relay(loop, {.name = "relay"}, [] {
///       return std::make_unique<rtdata::SerialActuator>(
///           rtdata::SerialActuatorConfig{.device = "/dev/ttyUSB0", .words = {{"0", "off"}, {"1", "on"}}});
///     });
///
/// Devices that need bytes are set by `words_hex`: {{"0", "a0 01 00 a1"}, {"1", "a0 01 01 a2"}} is a USB relay. Then
/// other values cannot be set, and `text` is not used.
///
/// With `host` and `port` instead of `device` it is a TCP connection, which stays open: an instrument, a board with
/// relays. Use an IP address as `host`, so that nothing waits for a name server.
///
/// A value is set when the kernel has sent the text and, with `answer`, the device has sent that answer within
/// `timeout`. With `keep`, opening sends nothing. Other data from the device is discarded.
///
/// Owner: its output, or the guard. Thread: a lane's, or the guard's. Errors: those of opening a serial line;
/// timed-out; disconnected; io-failed.
#pragma once

#include <map>
#include <string>

#include "rtdata/io/serial.hpp"
#include "rtdata/outputs/output.hpp"

namespace rtdata {

struct SerialActuatorConfig {
  std::string device = {};  ///< "/dev/serial/by-id/...", "/dev/ttyUSB0"
  std::string host = {};    ///< instead of `device`: host name or IP address
  std::uint16_t port = 0;   ///< TCP port of the device
  SerialSettings serial = {};
  std::string text = "{value}\n";                     ///< `{value}`: the shortest exact number: 1, 0.5
  std::map<std::string, std::string> words = {};      ///< texts to send for values: {"0": "off", "1": "on"}
  std::map<std::string, std::string> words_hex = {};  ///< bytes to send for values, instead of `text`
  std::string answer = {};                            ///< the device's reply after a value; empty: do not wait for one
  std::string answer_hex = {};                        ///< the reply as bytes
  Duration timeout = std::chrono::milliseconds{500};

  friend constexpr auto parameters(type_tag<SerialActuatorConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("device", &SerialActuatorConfig::device, "the serial device", TextIs::device),
        parameter("host", &SerialActuatorConfig::host, "instead of `device`: host name or IP address of the device"),
        parameter("port", &SerialActuatorConfig::port, "with `host`: TCP port of the device", range(0, 65535)),
        include_member(&SerialActuatorConfig::serial),
        parameter("text", &SerialActuatorConfig::text, "what is sent; {value} stands for the value",
                  placeholders("value")),
        parameter("words", &SerialActuatorConfig::words,
                  "text that replaces {value}, for each value: {\"0\": \"off\", \"1\": \"on\"}"),
        parameter("words_hex", &SerialActuatorConfig::words_hex,
                  "instead of `text`: the bytes for each value: {\"0\": \"a0 01 00 a1\", \"1\": \"a0 01 01 a2\"}"),
        parameter("answer", &SerialActuatorConfig::answer,
                  "what the device answers when it has taken the value; empty: no answer is awaited"),
        parameter("answer_hex", &SerialActuatorConfig::answer_hex, "the answer as bytes, in hexadecimal digits"),
        parameter("timeout", &SerialActuatorConfig::timeout, "time limit for sending and the answer",
                  range(Duration{1ms}, Duration{1500ms})));
  }
  friend void check_config(const SerialActuatorConfig& config, const ConfigItem& item, Problems& problems) {
    check(config, item, problems);
  }
  static void check(const SerialActuatorConfig& config, const ConfigItem& item, Problems& problems);
};

class SerialActuator : public CheckedActuator {
 public:
  explicit SerialActuator(SerialActuatorConfig config);
  SerialActuator(const SerialActuator&) = delete;
  SerialActuator& operator=(const SerialActuator&) = delete;
  ~SerialActuator() override;
  Result<void> open(std::optional<double> value) override;
  Result<void> set(double value) override;
  Result<void> check() override;

 private:
  Result<std::string> text_of(double value) const;
  Error gone() const;

  SerialActuatorConfig config_;
  const std::string place_;
  std::string answer_;
  int fd_ = -1;
};

}  // namespace rtdata
