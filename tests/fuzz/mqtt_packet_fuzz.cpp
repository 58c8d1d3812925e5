/// Any bytes as what a broker of MQTT sends: looking at them reads nothing beyond them, refuses nothing without a
/// reason, and says the same of a packet whatever comes behind it; and one that is good is cut wherever it is cut.
///
///     tests/fuzz/run.sh 60
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <string_view>
#include <vector>

#include "net/mqtt_packet.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using rtdata::detail::look_at_mqtt;
  using rtdata::detail::MqttPacket;
  if (size == 0) return 0;
  rtdata::detail::MqttExpectation expected{(data[0] & 1) != 0, (data[0] & 2) != 0, (data[0] & 4) != 0};
  std::string_view bytes(reinterpret_cast<const char*>(data) + 1, size - 1);
  while (!bytes.empty()) {
    const MqttPacket packet = look_at_mqtt(bytes, expected);
    if (packet.state == MqttPacket::State::cut) return 0;
    if (packet.state == MqttPacket::State::bad) {
      if (std::string_view(packet.why).empty()) std::abort();
      return 0;
    }
    if (packet.head < 2 || packet.head > bytes.size() || packet.prefix > packet.head) std::abort();
    for (std::size_t part = 0; part <= packet.head; ++part) {
      // Apart, so that a read behind its end shows.
      const std::vector<char> copy(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(part));
      const MqttPacket cut = look_at_mqtt({copy.data(), copy.size()}, expected);
      if (cut.state != (part < packet.head ? MqttPacket::State::cut : MqttPacket::State::good)) std::abort();
    }
    expected.is_accepted = true;
    bytes.remove_prefix(std::min(bytes.size(), packet.head + packet.payload));
  }
  return 0;
}
