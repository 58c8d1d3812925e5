// Advice for enabling buses that a board disables by default. One place for errors of buses and ports, `rtdata scan`
// and `rtdata doctor`.
#pragma once

#include <string>
#include <string_view>

namespace rtdata::detail {

/// Advice for the path of a missing device: "/dev/i2c-1", "/dev/spidev0.0", "/dev/serial0", "/sys/bus/w1/devices".
/// Empty: no advice.
std::string how_to_enable(std::string_view device);

/// Advice if gpsd should run on this machine but nobody listens.
inline constexpr std::string_view how_to_start_gpsd =
    "start it: `sudo systemctl start gpsd.socket` (`sudo apt install gpsd`, if there is no such unit)";

}  // namespace rtdata::detail
