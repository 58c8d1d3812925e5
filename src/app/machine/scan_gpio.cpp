#include <unistd.h>

#include "app/machine/scanner.hpp"

namespace rtdata::app {

void scan_gpio(Scanner& scanner) {
  const std::vector<std::string> chips = scanner.files.names("/sys/bus/gpio/devices", "gpiochip");
  for (const std::string& chip : chips) {
    const std::string folder = "/sys/bus/gpio/devices/" + chip;
    std::string label, lines;
    // The classes of the old interface know label and size; they are read, never written.
    for (const std::string& old : scanner.files.names(folder + "/gpio", "gpiochip")) {
      label = scanner.text(folder + "/gpio/" + old + "/label");
      lines = scanner.text(folder + "/gpio/" + old + "/ngpio");
    }
    std::string what = label.empty() ? scanner.text(folder + "/of_node/name") : label;
    if (!lines.empty()) what += (what.empty() ? "" : ", ") + lines + " lines";
    scanner.add("gpio", "/dev/" + chip, what, R_OK | W_OK);
  }
}

}  // namespace rtdata::app
