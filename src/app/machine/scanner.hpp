// The common part of `rtdata scan`, which has one file for each kind of device. Private to the program.
#pragma once

#include <initializer_list>
#include <set>
#include <string>

#include "app/machine/scan.hpp"
#include "rtdata/io/i2c.hpp"

namespace rtdata::app {

/// Collects what the parts find.
class Scanner {
 public:
  Scanner(const MachineFiles& files_, const Registry& registry_, Probing probing_)
      : files(files_), registry(registry_), probing(probing_) {}

  const MachineFiles& files;
  const Registry& registry;
  const Probing probing;
  Scan scan;

  /// Adds a device with the path to open it, and, if this user may not open it, the reason and advice. The reference is
  /// valid until the next `add`.
  FoundDevice& add(std::string kind, std::string path, std::string what, int mode);
  /// Adds a device whose data are known without opening it.
  void add(FoundDevice device) { scan.devices.push_back(std::move(device)); }
  void hint(std::string kind, std::string text) { scan.hints.push_back({std::move(kind), std::move(text)}); }

  /// Adds a line to paste, if this program has its type. `bus`: the configuration line of the bus it is on, if any.
  void line(FoundDevice& device, const char* list, const std::string& text, const std::string& bus = {}) const;
  /// The same for a sensor, with a unique name similar to `name`. `members`: its keys after name and type, in JSON.
  void sensor(FoundDevice& device, const std::string& name, const std::string& type, const std::string& members = {},
              const std::string& bus = {});
  /// The file's text for display: at most 80 characters, without control characters.
  std::string text(const std::string& file) const;

 private:
  std::set<std::string> names_;
};

/// A chip at an address of an I2C bus, and the sensors of a configuration that read it.
struct LikelyChip {
  struct Driver {
    std::string type, model;  ///< empty model: the driver has none, or the default one
  };
  std::string what;  ///< "BMP280", "perhaps INA219, INA226"
  std::vector<Driver> drivers = {};
};
/// Searches for it among the chips of all drivers, by its identity and address, and among other common ones.
LikelyChip likely_chip(I2cDevice& chip, const Registry& registry);

/// As a JSON string.
std::string json_text(const std::string& text);
/// Joins the texts that are not empty with blanks.
std::string joined(std::initializer_list<std::string> words);

void scan_serial(Scanner& scanner);
void scan_i2c(Scanner& scanner);
void scan_spi(Scanner& scanner);
void scan_gpio(Scanner& scanner);
void scan_iio(Scanner& scanner);  // and hwmon
void scan_counters(Scanner& scanner);
void scan_one_wire(Scanner& scanner);
void scan_clocks(Scanner& scanner);  // PPS and PWM
void scan_gpsd(Scanner& scanner);

}  // namespace rtdata::app
