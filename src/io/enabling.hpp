// How what a board does not show by itself is switched on. The one place for it: errors of buses and ports, `rtdata
// scan` and `rtdata doctor` say the same.
#pragma once

#include <string>
#include <string_view>

namespace rtdata::detail {

/// By the path of a device that is not there: "/dev/i2c-1", "/dev/spidev0.0", "/dev/serial0", "/sys/bus/w1/devices".
/// Empty: nothing is known of it that would help.
std::string how_to_enable(std::string_view device);

/// Where gpsd is to run on this machine, and nobody listens.
inline constexpr std::string_view how_to_start_gpsd =
    "start it: `sudo systemctl start gpsd.socket` (`sudo apt install gpsd`, if there is no such unit)";

}  // namespace rtdata::detail
