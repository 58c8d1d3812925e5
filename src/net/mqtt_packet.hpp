// What a broker of MQTT sends, looked at without taking it: whether a packet is whole, and one that it may send.
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
  const char* why = "";     ///< it is bad
  unsigned char type = 0;   ///< as MQTT numbers them
  std::size_t prefix = 0;   ///< bytes of type and length
  std::size_t head = 0;     ///< bytes up to the payload of a message, which are all of any other packet
  std::size_t payload = 0;  ///< bytes that follow, of a message; not looked at, and need not have come
};

/// Longest `head` of a good packet: two texts of MQTT and more.
inline constexpr std::size_t most_mqtt_head = 256 * 1024;

/// Reads as MQTT 3.1.1 and 5 say, and no further than `bytes`. What is good, libmosquitto can take.
MqttPacket look_at_mqtt(std::string_view bytes, const MqttExpectation& expected) noexcept;

}  // namespace rtdata::detail
