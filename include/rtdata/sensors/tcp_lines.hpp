/// TcpLines: a device behind a TCP port that sends lines: an ESP32, a serial line shared by ser2net.
///
///     rtdata::TcpLines wind(loop, {.name = "wind"},
///                           {.host = "192.168.1.7", .port = 10110,
///                            .lines = {.fields = {{.name = "speed", .unit = "m/s"}}}});
///
/// Each line becomes one event; lines.hpp says how lines are read. The connection is made and kept on the loop; only
/// names of hosts are looked up on a lane.
///
/// - If the device refuses the connection, does not answer within `connect_timeout`, or ends it, the sensor is faulted
///   and connects again after `retry_first`, doubling to `retry_longest`. The time without it is a gap (disconnected).
/// - A device that vanishes without a word is noticed after about a minute, or after `silence`.
/// - `at_open` is sent after each connection, such as a request to begin.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "rtdata/sensors/lines.hpp"

namespace rtdata {

struct TcpLinesConfig {
  std::string host = {};  ///< a name or an address
  std::uint16_t port = 0;
  Duration connect_timeout = std::chrono::seconds{5};
  std::vector<std::string> at_open = {};  ///< sent after each connection, in order, with their ends
  LineConfig lines = {.retry_first = std::chrono::seconds{1}};

  friend constexpr auto parameters(type_tag<TcpLinesConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(parameter("host", &TcpLinesConfig::host, "name or address of the device", rtdata::required),
                          parameter("port", &TcpLinesConfig::port, "its TCP port", range(1, 65535), rtdata::required),
                          parameter("connect_timeout", &TcpLinesConfig::connect_timeout,
                                    "how long it may take to connect", range(Duration{10ms}, Duration{1min})),
                          parameter("at_open", &TcpLinesConfig::at_open, "what is sent after each connection"),
                          include_member(&TcpLinesConfig::lines));
  }
};

void check_config(const TcpLinesConfig& config, const ConfigItem& item, Problems& problems);
ReadTime read_time(const TcpLinesConfig& config);

class TcpLines : public AnySensor {
 public:
  TcpLines() noexcept = default;
  /// SetupError: as `Feed`; bad-argument for a configuration that cannot work.
  TcpLines(Loop& loop, FeedConfig feed, TcpLinesConfig config);

 private:
  explicit TcpLines(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
