#include <unistd.h>

#include <utility>

#include "app/machine/scanner.hpp"
#include "io/enabling.hpp"

namespace rtdata::app {

void scan_spi(Scanner& scanner) {
  const std::vector<std::string> devices = scanner.files.names("/dev", "spidev");
  std::string controller;
  for (const std::string& device : devices) {
    FoundDevice& found = scanner.add("spi", "/dev/" + device, "bus and chip select " + device.substr(6), R_OK | W_OK);
    const std::string its = device.substr(0, device.find('.'));
    if (its == std::exchange(controller, its)) continue;  // one line for all chip selects of a controller
    scanner.line(found, "buses",
                 json_text("spi" + its.substr(6)) + R"(: {"type": "spi", "device": )" + json_text("/dev/" + its) + "}");
  }
  if (!devices.empty()) return;
  scanner.hint(
      "spi", scanner.files.names("/sys/class/spi_master").empty()
                 ? "no SPI controller: " + detail::how_to_enable("/dev/spidev")
                 : "there is a controller and no spidev on it: `sudo modprobe spidev`, and a device tree overlay that "
                   "gives it one");
}

}  // namespace rtdata::app
