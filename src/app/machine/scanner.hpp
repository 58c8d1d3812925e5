// What the parts of `rtdata scan` share: one file for each kind of device. Private to the program.
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

  /// A device that is opened by `path`; if this user may not, with the reason and what to do. The reference is valid
  /// until the next one is added.
  FoundDevice& add(std::string kind, std::string path, std::string what, int mode);
  /// What is known of one without opening it.
  void add(FoundDevice device) { scan.devices.push_back(std::move(device)); }
  void hint(std::string kind, std::string text) { scan.hints.push_back({std::move(kind), std::move(text)}); }

  /// A line to paste, if this program takes it; one of a type that it lacks is left out. `bus`: the item that it is on.
  void line(FoundDevice& device, const char* list, const std::string& text, const std::string& bus = {}) const;
  /// The same of a sensor, with a name like this one. `members`: what follows its name and type, in JSON.
  void sensor(FoundDevice& device, const std::string& name, const std::string& type, const std::string& members = {},
              const std::string& bus = {});
  /// The file's text, for people: at most 80 characters, none of them a control character.
  std::string text(const std::string& file) const;

 private:
  std::set<std::string> names_;
};

/// What answers at an address of an I2C bus, and the sensors of a configuration that read it.
struct LikelyChip {
  struct Driver {
    std::string type, model;  ///< no model: the driver has none, or its default
  };
  std::string what;  ///< "BMP280", "perhaps INA219, INA226"
  std::vector<Driver> drivers = {};
};
/// Looks for it among the chips of all drivers, by its identity and address, and among others that are often there.
LikelyChip likely_chip(I2cDevice& chip, const Registry& registry);

/// As a JSON string.
std::string json_text(const std::string& text);
/// Those that are not empty, with blanks between.
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
