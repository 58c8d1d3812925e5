#include <unistd.h>

#include "app/machine/doctor.hpp"

namespace rtdata::app {

namespace {

/// The file of the machine that the part is configured with; empty: none. Names of other kinds, such as a disk's or a
/// network's, are looked for by the sensor itself.
std::string device_of(const PartPlan& part) {
  for (const char* key : {"device", "file"}) {
    const ConfigItem* item = part.item.find(key);
    if (item == nullptr) continue;
    if (const auto text = item->as_string(); text && text->starts_with("/")) return *text;
  }
  return "";
}

}  // namespace

std::vector<Finding> examine_devices(const MachineFiles& files, const SystemPlan& plan) {
  std::vector<Finding> found;
  for (const PartPlan& part : plan.parts) {
    std::string device = device_of(part);
    if (device.empty()) continue;
    // An SPI controller has a device for each chip select.
    if (!files.exists(device) && device.starts_with("/dev/spidev")) {
      const auto selects = files.names("/dev", device.substr(5) + ".");
      if (!selects.empty()) device = "/dev/" + selects.front();
    }
    // What the kernel shows below /sys and /proc is read; a bus or a port is written to as well.
    const bool is_read_only = !device.starts_with("/dev/");
    const Access access = access_to(files, device, is_read_only ? R_OK : R_OK | W_OK);
    if (access.is_granted) {
      found.push_back({Severity::good, part.object(), device + " can be used"});
    } else {
      found.push_back({Severity::fault, part.object(), device + ": " + access.why,
                       "it has no data until that is mended", access.advice});
    }
  }
  return found;
}

}  // namespace rtdata::app
