/// TcpLines: a device behind a TCP port that sends lines: an ESP32, a serial line shared by ser2net.
///
///     rtdata::TcpLines wind(loop, {.name = "wind"},
///                           {.host = "192.168.1.7", .port = 10110,
///                            .lines = {.fields = {{.name = "speed", .unit = "m/s"}}}});
///
/// Each line becomes one event; lines.hpp says how lines are read. The connection is made and kept on the loop; only
/// host names are looked up on a lane.
///
/// With `listen` the device connects to this machine: {.port = 5000, .listen = "0.0.0.0"}. Sensors of one loop may
/// listen on the same port, each to the device that its `from` names. A sensor has one connection at a time. If another
/// is made and nothing comes on the first for 1 s, the device has restarted, and the new one is used; otherwise the new
/// one is closed, which is reported.
///
/// - If the device refuses the connection, does not answer within `connect_timeout`, or ends it, the sensor is faulted
///   and connects again after `retry_first`, doubling to `retry_longest`. The time without it is a gap (disconnected).
/// - A device that vanishes without a word is noticed after about a minute, or after `silence`.
/// - While no device is connected to a sensor that listens, it is faulted, and there is a gap (disconnected). If its
///   port is taken, it tries again in the same way.
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
  std::string host = {};  ///< host name or IP address; empty with `listen`
  std::uint16_t port = 0;
  std::string listen = {};  ///< an address of this machine, to which the device connects: "127.0.0.1", "0.0.0.0"
  std::string from = {};    ///< with `listen`: the address of the only device that may connect; empty: any
  Duration connect_timeout = std::chrono::seconds{5};
  std::vector<std::string> at_open = {};      ///< sent after each connection, in order, with their ends
  std::vector<std::string> at_open_hex = {};  ///< bytes, sent after them
  LineConfig lines = {.retry_first = std::chrono::seconds{1}};

  friend constexpr auto parameters(type_tag<TcpLinesConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("host", &TcpLinesConfig::host, "host name or IP address of the device"),
        parameter("port", &TcpLinesConfig::port, "TCP port of the device; with `listen`, of this computer",
                  range(1, 65535), rtdata::required),
        parameter("listen", &TcpLinesConfig::listen,
                  "instead of `host`: address of this computer to which the device connects, \"0.0.0.0\" for all its "
                  "addresses"),
        parameter("from", &TcpLinesConfig::from, "with `listen`: the address of the only device that may connect"),
        parameter("connect_timeout", &TcpLinesConfig::connect_timeout, "time limit for connecting",
                  range(Duration{10ms}, Duration{1min})),
        parameter("at_open", &TcpLinesConfig::at_open, "what is sent after each connection"),
        parameter("at_open_hex", &TcpLinesConfig::at_open_hex, "bytes that are sent after `at_open`"),
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
