// What this machine has that could be measured with. Private to the program.
#pragma once

#include <string>
#include <vector>

#include "app/machine/machine_files.hpp"
#include "rtdata/config/registry.hpp"

namespace rtdata::app {

/// A device, or a place where devices are.
struct FoundDevice {
  /// "serial", "i2c", "spi", "gpio", "iio", "hwmon", "counter", "1-wire", "pps", "pwm", "gpsd"
  std::string kind;
  std::string path;           ///< by which it is opened
  std::string what;           ///< what is known of it: "FTDI FT232R USB UART, ttyUSB0"
  std::string obstacle = {};  ///< why it cannot be used; empty: it can, as far as is known
  std::string advice = {};    ///< what to do about that
  struct Line {
    std::string list;  ///< "buses", "sensors"
    std::string text;  ///< of that list, in JSON
  };
  std::vector<Line> lines = {};  ///< to paste: each is one that `check` takes
};

/// What a bus or a kind of device would need that this machine lacks: "modprobe i2c-dev".
struct ScanHint {
  std::string kind, text;
};

struct Scan {
  std::vector<FoundDevice> devices;
  std::vector<ScanHint> hints;
};

enum class Probing {
  no,   ///< files of the kernel are read, and gpsd is connected to; no device is touched
  yes,  ///< every free address of every I2C adapter is read from, which can disturb a chip
};

/// Only lines of types that the registry has.
Scan scan_machine(const MachineFiles& files, const Registry& registry, Probing probing);

}  // namespace rtdata::app
