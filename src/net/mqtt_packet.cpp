#include "net/mqtt_packet.hpp"

#include <algorithm>
#include <array>
#include <cstdint>

#include "data/utf8.hpp"

namespace rtdata::detail {
namespace {

// MQTT 5 section 2.1.2.
enum MqttType : unsigned char {
  mqtt_connack = 2,
  mqtt_publish = 3,
  mqtt_puback = 4,
  mqtt_pubrec = 5,
  mqtt_pubrel = 6,
  mqtt_pubcomp = 7,
  mqtt_suback = 9,
  mqtt_pingresp = 13,
  mqtt_disconnect = 14,
};

/// The rest of a packet. A read beyond its end, or of a forbidden value, marks it as bad.
class MqttBytes {
 public:
  explicit MqttBytes(std::string_view bytes) : bytes_(bytes) {}
  bool is_good() const noexcept { return is_good_; }
  std::size_t size() const noexcept { return bytes_.size(); }
  unsigned number(std::size_t bytes) noexcept {
    unsigned value = 0;
    for (const char c : take(bytes)) value = value << 8 | static_cast<unsigned char>(c);
    return value;
  }
  /// A length, or another number, of one to four bytes (MQTT 5 section 1.5.5).
  unsigned variable() noexcept {
    unsigned value = 0;
    for (unsigned shift = 0; shift < 28; shift += 7) {
      const unsigned byte = number(1);
      value |= (byte & 0x7f) << shift;
      if ((byte & 0x80) != 0) continue;
      is_good_ = is_good_ && (byte != 0 || shift == 0);
      return value;
    }
    is_good_ = false;
    return 0;
  }
  std::string_view binary() noexcept { return take(number(2)); }
  std::string_view text() noexcept {
    const std::string_view bytes = binary();
    is_good_ = is_good_ && is_utf8(bytes) && bytes.find('\0') == std::string_view::npos;
    return bytes;
  }
  MqttBytes part(std::size_t size) noexcept { return MqttBytes(take(size)); }

 private:
  std::string_view take(std::size_t size) noexcept {
    is_good_ = is_good_ && size <= bytes_.size();
    if (!is_good_) return {};
    const std::string_view taken = bytes_.substr(0, size);
    bytes_.remove_prefix(size);
    return taken;
  }
  std::string_view bytes_;
  bool is_good_ = true;
};

enum class MqttKind : unsigned char { none, flag, two, four, variable, text, binary, pair };

struct MqttProperty {
  MqttKind kind = MqttKind::none;
  std::uint16_t packets = 0;  // a bit a type
};

constexpr std::uint16_t mqtt_bit(MqttType type) { return static_cast<std::uint16_t>(1U << type); }

/// By identifier, of packets that brokers send (MQTT 5 section 2.2.2.2); without those of an authentication, which this
/// client never begins.
constexpr auto mqtt_properties = [] {
  std::array<MqttProperty, 0x2b> all{};
  constexpr std::uint16_t answers = mqtt_bit(mqtt_connack) | mqtt_bit(mqtt_puback) | mqtt_bit(mqtt_pubrec) |
                                    mqtt_bit(mqtt_pubrel) | mqtt_bit(mqtt_pubcomp) | mqtt_bit(mqtt_suback) |
                                    mqtt_bit(mqtt_disconnect);
  all[0x01] = {MqttKind::flag, mqtt_bit(mqtt_publish)};                              // payload format
  all[0x02] = {MqttKind::four, mqtt_bit(mqtt_publish)};                              // expiry of the message
  all[0x03] = {MqttKind::text, mqtt_bit(mqtt_publish)};                              // content type
  all[0x08] = {MqttKind::text, mqtt_bit(mqtt_publish)};                              // response topic
  all[0x09] = {MqttKind::binary, mqtt_bit(mqtt_publish)};                            // correlation
  all[0x0b] = {MqttKind::variable, mqtt_bit(mqtt_publish)};                          // subscription
  all[0x11] = {MqttKind::four, mqtt_bit(mqtt_connack) | mqtt_bit(mqtt_disconnect)};  // expiry of the session
  all[0x12] = {MqttKind::text, mqtt_bit(mqtt_connack)};                              // client's name
  all[0x13] = {MqttKind::two, mqtt_bit(mqtt_connack)};                               // keepalive
  all[0x15] = {MqttKind::text, mqtt_bit(mqtt_connack)};                              // authentication
  all[0x16] = {MqttKind::binary, mqtt_bit(mqtt_connack)};                            // its data
  all[0x1a] = {MqttKind::text, mqtt_bit(mqtt_connack)};                              // response information
  all[0x1c] = {MqttKind::text, mqtt_bit(mqtt_connack) | mqtt_bit(mqtt_disconnect)};  // another server
  all[0x1f] = {MqttKind::text, answers};                                             // reason
  all[0x21] = {MqttKind::two, mqtt_bit(mqtt_connack)};                               // unanswered messages
  all[0x22] = {MqttKind::two, mqtt_bit(mqtt_connack)};                               // topic aliases
  all[0x24] = {MqttKind::flag, mqtt_bit(mqtt_connack)};                              // QoS
  all[0x25] = {MqttKind::flag, mqtt_bit(mqtt_connack)};                              // retained messages
  all[0x26] = {MqttKind::pair, answers | mqtt_bit(mqtt_publish)};                    // of the user
  all[0x27] = {MqttKind::four, mqtt_bit(mqtt_connack)};                              // packet size
  all[0x28] = {MqttKind::flag, mqtt_bit(mqtt_connack)};                              // wildcards
  all[0x29] = {MqttKind::flag, mqtt_bit(mqtt_connack)};                              // subscription numbers
  all[0x2a] = {MqttKind::flag, mqtt_bit(mqtt_connack)};                              // shared subscriptions
  return all;
}();

/// Null: no mistake.
const char* mistake_of_properties(MqttBytes& from, MqttType type) noexcept {
  constexpr unsigned subscription = 0x0b, unanswered = 0x21, user = 0x26, packet_size = 0x27;
  MqttBytes bytes = from.part(from.variable());
  std::uint64_t seen = 0;
  while (from.is_good() && bytes.is_good() && bytes.size() > 0) {
    const unsigned number = bytes.variable();
    const MqttProperty property = number < mqtt_properties.size() ? mqtt_properties[number] : MqttProperty{};
    if ((property.packets & mqtt_bit(type)) == 0) return "a property that MQTT does not allow there";
    const std::uint64_t mark = std::uint64_t{1} << number;
    if ((seen & mark) != 0 && number != user && number != subscription) return "a property that occurs twice";
    seen |= mark;
    unsigned value = 1;
    switch (property.kind) {
      case MqttKind::flag:
        if (bytes.number(1) > 1) return "a property that is neither 0 nor 1";
        break;
      case MqttKind::two:
        value = bytes.number(2);
        break;
      case MqttKind::four:
        value = bytes.number(4);
        break;
      case MqttKind::variable:
        value = bytes.variable();
        break;
      case MqttKind::pair:
        bytes.text();
        [[fallthrough]];
      case MqttKind::text:
        bytes.text();
        break;
      case MqttKind::binary:
        bytes.binary();
        break;
      case MqttKind::none:
        break;
    }
    const bool may_be_zero = number != unanswered && number != packet_size && number != subscription;
    if (value == 0 && !may_be_zero) return "a property that is 0";
  }
  return from.is_good() && bytes.is_good() ? nullptr : "truncated properties";
}

const char* mistake_of_connack(MqttBytes& bytes, bool is_v5) noexcept {
  const unsigned flags = bytes.number(1), reason = bytes.number(1);
  if (!bytes.is_good() || flags > 1) return "a malformed answer to the connection";
  // A broker that does not support MQTT 5 may refuse it as 3.1.1 does.
  if (!is_v5 || (bytes.size() == 0 && reason != 0)) return nullptr;
  return mistake_of_properties(bytes, mqtt_connack);
}

/// Checks an answer to a message, or to an answer.
const char* mistake_of_answer(MqttBytes& bytes, MqttType type, bool is_v5) noexcept {
  const unsigned number = bytes.number(2);
  if (!bytes.is_good() || number == 0) return "an answer to an unknown message";
  if (!is_v5 || bytes.size() == 0) return nullptr;
  bytes.number(1);
  return bytes.size() == 0 ? nullptr : mistake_of_properties(bytes, type);
}

const char* mistake_of_suback(MqttBytes& bytes, bool is_v5) noexcept {
  const unsigned number = bytes.number(2);
  if (!bytes.is_good() || number == 0) return "an answer to an unknown subscription";
  if (const char* const mistake = is_v5 ? mistake_of_properties(bytes, mqtt_suback) : nullptr) return mistake;
  if (bytes.size() == 0) return "an answer to a subscription without its result";
  while (bytes.size() > 0)
    if (const unsigned granted = bytes.number(1); granted > 2 && granted < 0x80)
      return "a malformed answer to a subscription";
  return nullptr;
}

const char* mistake_of_disconnect(MqttBytes& bytes, bool is_v5) noexcept {
  if (!is_v5) return "a DISCONNECT, which only clients send in MQTT 3.1.1";
  if (bytes.size() == 0) return nullptr;
  bytes.number(1);
  return bytes.size() == 0 ? nullptr : mistake_of_properties(bytes, mqtt_disconnect);
}

/// Up to the payload.
const char* mistake_of_message(MqttBytes& bytes, unsigned flags, bool is_v5) noexcept {
  constexpr unsigned qos_mask = 6, duplicate = 8;
  const unsigned qos = (flags & qos_mask) >> 1;
  if (qos > 2 || (qos == 0 && (flags & duplicate) != 0)) return "a message with an invalid QoS";
  const std::string_view topic = bytes.text();
  if (!bytes.is_good()) return "a message whose topic is not text";
  if (topic.empty()) return "a message without a topic";
  if (topic.find_first_of("+#") != std::string_view::npos) return "a message whose topic is a pattern";
  if (qos > 0 && bytes.number(2) == 0) return "a message without a number";
  return is_v5 ? mistake_of_properties(bytes, mqtt_publish) : nullptr;
}

/// Null: no mistake.
const char* mistake_of_packet(MqttBytes& bytes, MqttType type, unsigned flags,
                              const MqttExpectation& expected) noexcept {
  constexpr unsigned flags_of_pubrel = 2;
  if ((type == mqtt_connack) == expected.is_accepted)
    return expected.is_accepted ? "a second answer to the connection" : "a packet before the answer to the connection";
  if (type != mqtt_publish && flags != (type == mqtt_pubrel ? flags_of_pubrel : 0))
    return "flags that MQTT does not have";
  if ((type == mqtt_publish || type == mqtt_pubrel || type == mqtt_suback) && !expected.takes_messages)
    return "a message without a subscription";
  const bool is_v5 = expected.is_v5;
  switch (type) {
    case mqtt_connack:
      return mistake_of_connack(bytes, is_v5);
    case mqtt_publish:
      return mistake_of_message(bytes, flags, is_v5);
    case mqtt_puback:
    case mqtt_pubrec:
    case mqtt_pubrel:
    case mqtt_pubcomp:
      return mistake_of_answer(bytes, type, is_v5);
    case mqtt_suback:
      return mistake_of_suback(bytes, is_v5);
    case mqtt_pingresp:
      return nullptr;
    case mqtt_disconnect:
      return mistake_of_disconnect(bytes, is_v5);
  }
  return "a packet that brokers do not send";
}

MqttPacket bad_mqtt(MqttPacket packet, const char* why) noexcept {
  packet.state = MqttPacket::State::bad;
  packet.why = why;
  return packet;
}

}  // namespace

MqttPacket look_at_mqtt(std::string_view bytes, const MqttExpectation& expected) noexcept {
  constexpr std::size_t most_prefix = 5;
  MqttPacket packet;
  if (bytes.empty()) return packet;
  const auto first = static_cast<unsigned char>(bytes[0]);
  packet.type = first >> 4;
  const std::size_t end_of_prefix = std::find_if(bytes.begin() + 1, bytes.begin() + std::min(bytes.size(), most_prefix),
                                                 [](char c) { return (c & 0x80) == 0; }) -
                                    bytes.begin();
  if (end_of_prefix == most_prefix) return bad_mqtt(packet, "a packet with a malformed length");
  if (end_of_prefix >= bytes.size()) return packet;
  MqttBytes prefix(bytes.substr(1, end_of_prefix));
  const std::size_t length = prefix.variable();
  if (!prefix.is_good()) return bad_mqtt(packet, "a packet with a malformed length");
  packet.prefix = 1 + end_of_prefix;
  bytes.remove_prefix(packet.prefix);
  const bool is_message = packet.type == mqtt_publish;
  if (!is_message && length > most_mqtt_head) return bad_mqtt(packet, "a packet that is too long");
  const bool is_whole = bytes.size() >= length;
  if (!is_message && !is_whole) return packet;
  MqttBytes rest(bytes.substr(0, length));
  const std::size_t there = rest.size();
  if (const char* const why = mistake_of_packet(rest, static_cast<MqttType>(packet.type), first & 0x0f, expected)) {
    // The missing bytes of an incomplete message may come later.
    const bool may_be_cut = !is_whole && !rest.is_good();
    return may_be_cut && there <= most_mqtt_head ? packet : bad_mqtt(packet, why);
  }
  if (!rest.is_good() || (!is_message && rest.size() > 0)) {
    if (is_message && !is_whole && there <= most_mqtt_head) return packet;
    return bad_mqtt(packet, "a packet that is longer or shorter than its content");
  }
  packet.state = MqttPacket::State::good;
  packet.head = packet.prefix + there - rest.size();
  packet.payload = length - (there - rest.size());
  return packet;
}

}  // namespace rtdata::detail
