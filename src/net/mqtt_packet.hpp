// Checks the data of an MQTT broker without consuming it: packets must be complete and allowed.
#pragma once

#include <cstddef>
#include <string_view>

namespace rtdata::detail {

/// What the packets of a connection must be.
struct MqttExpectation {
  bool is_v5 = true;           ///< else 3.1.1
  bool is_accepted = false;    ///< the answer to the connection has come
  bool takes_messages = true;  ///< something may have been subscribed to
};

/// The first packet of some bytes.
struct MqttPacket {
  enum class State { cut, good, bad };
  State state = State::cut;
  const char* why = "";     ///< why the packet is bad
  unsigned char type = 0;   ///< as MQTT numbers them
  std::size_t prefix = 0;   ///< bytes of type and length
  std::size_t head = 0;     ///< bytes up to the payload of a message, which are all of any other packet
  std::size_t payload = 0;  ///< bytes that follow, of a message; not looked at, and need not have come
};

/// Longest `head` of a good packet: two texts of MQTT and more.
inline constexpr std::size_t most_mqtt_head = 256 * 1024;

/// Checks according to MQTT 3.1.1 and 5, never beyond `bytes`. libmosquitto can process all accepted packets.
MqttPacket look_at_mqtt(std::string_view bytes, const MqttExpectation& expected) noexcept;

}  // namespace rtdata::detail
