// Finds devices of this machine for measurements. Private to the program.
#pragma once

#include <string>
#include <vector>

#include "app/machine/machine_files.hpp"
#include "rtdata/config/registry.hpp"

namespace rtdata::app {

/// A device, or a bus for devices.
struct FoundDevice {
  /// "serial", "i2c", "spi", "gpio", "iio", "hwmon", "counter", "1-wire", "pps", "pwm", "gpsd"
  std::string kind;
  std::string path;           ///< path to open it
  std::string what;           ///< its description: "FTDI FT232R USB UART, ttyUSB0"
  std::string obstacle = {};  ///< why it cannot be used; empty: no obstacle known
  std::string advice = {};    ///< what to do about that
  struct Line {
    std::string list;  ///< "buses", "sensors"
    std::string text;  ///< item for that list, in JSON
  };
  std::vector<Line> lines = {};  ///< lines to paste, accepted by `check`
};

/// Advice for a missing bus or kind of device: "modprobe i2c-dev".
struct ScanHint {
  std::string kind, text;
};

struct Scan {
  std::vector<FoundDevice> devices;
  std::vector<ScanHint> hints;
};

enum class Probing {
  no,   ///< reads files of the kernel and connects to gpsd; uses no device
  yes,  ///< reads from every free address of every I2C adapter, which can disturb a chip
};

/// Only lines of types that the registry has.
Scan scan_machine(const MachineFiles& files, const Registry& registry, Probing probing);

}  // namespace rtdata::app
