/// UdpLines: devices that send lines by UDP to this machine: an ESP32, a telemetry ground station, an NMEA gateway.
///
///     rtdata::UdpLines wind(loop, {.name = "wind"},
///                           {.port = 5005, .address = "0.0.0.0",
///                            .lines = {.fields = {{.name = "speed", .unit = "m/s"}}}});
///
/// A datagram holds one line or several (or frames of bytes, with `frame`); each becomes one event; lines.hpp says how
/// they are read. The end of a datagram ends its last line.
///
/// - It receives on the loopback address by default; the `address` "0.0.0.0" or "::" means all addresses of this
///   computer, the address of a group ("239.1.2.3") what is sent to that group.
/// - With `from`, datagrams of other senders count as filtered.
/// - UDP may lose datagrams on the way, which only a `sequence_field` shows. Datagrams that the kernel drops because
///   its buffer is full are reported, and count as unreadable; with a `sequence_field` the missing numbers count
///   instead.
/// - A datagram longer than `longest_datagram` is unreadable, once.
/// - If the port is in use or the address does not exist, the sensor is faulted and tries again after `retry_first`,
///   doubling to `retry_longest`. UDP has no connection: only `silence` shows that the sender has stopped.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <cstdint>
#include <string>

#include "rtdata/sensors/lines.hpp"

namespace rtdata {

struct UdpLinesConfig {
  std::uint16_t port = 0;
  std::string address = "127.0.0.1";  ///< of this machine, or of a group
  std::string from = {};              ///< address of the only accepted sender; empty: all
  LineConfig lines = {.first_line = FirstLine::keep, .retry_first = std::chrono::seconds{1}};

  /// True if `address` is a multicast group, which several sensors may use.
  bool is_group() const;

  static constexpr std::size_t longest_datagram = 2048;  ///< bytes

  friend constexpr auto parameters(type_tag<UdpLinesConfig>) {
    return parameter_list(
        parameter("port", &UdpLinesConfig::port, "UDP port of this computer", range(1, 65535), rtdata::required),
        parameter("address", &UdpLinesConfig::address,
                  "address of this computer, \"0.0.0.0\" for all its addresses, or address of a multicast group"),
        parameter("from", &UdpLinesConfig::from,
                  "address of the only sender; datagrams of other senders count as filtered"),
        include_member(&UdpLinesConfig::lines));
  }
};

void check_config(const UdpLinesConfig& config, const ConfigItem& item, Problems& problems);
ReadTime read_time(const UdpLinesConfig& config);

class UdpLines : public AnySensor {
 public:
  UdpLines() noexcept = default;
  /// SetupError: as `Feed`; bad-argument for a configuration that cannot work.
  UdpLines(Loop& loop, FeedConfig feed, UdpLinesConfig config);

 private:
  explicit UdpLines(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
