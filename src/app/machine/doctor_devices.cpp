#include <grp.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <sstream>

#include "app/machine/doctor.hpp"

namespace rtdata::app {

namespace {

/// The file of the machine that the part is configured with; empty: none. Names of other kinds, such as a disk's or a
/// network's, are looked for by the sensor itself.
std::string device_of(const PartPlan& part) {
  for (const char* key : {"device", "file"}) {
    const ConfigItem* item = part.item.find(key);
    const std::string* text = item != nullptr ? item->as_string() : nullptr;
    if (text != nullptr && text->starts_with("/")) return *text;
  }
  return "";
}

Finding examine_device(const MachineFiles& files, const PartPlan& part, const std::string& device) {
  constexpr const char* cost = "it has no data until that is mended";
  // What the kernel shows below /sys and /proc is read; a bus or a port is written to as well.
  const bool is_node = device.starts_with("/dev/");
  const Access access = access_to(files, device, is_node ? R_OK | W_OK : R_OK);
  if (!access.is_granted) return {Severity::fault, part.object(), device + ": " + access.why, cost, access.advice};
  if (!files.is_this_machine() || !is_node) return {Severity::good, part.object(), device + " can be used"};
  struct stat status {};
  if (::stat(device.c_str(), &status) == 0 && !S_ISCHR(status.st_mode)) {
    return {Severity::fault, part.object(), device + " is no device but a file or folder", cost,
            "somebody wrote to that name while the device was not there: remove it, and plug the device in again"};
  }
  const bool is_alone = part.type == "serial";
  const std::string holder = is_alone ? holder_of(device) : "";
  if (holder.empty()) return {Severity::good, part.object(), device + " can be used"};
  return {Severity::warning, part.object(), device + ": " + holder + " has it open",
          "two programs at one port take each other's bytes", "end that first"};
}

/// A chip on I2C that a driver of the kernel has; the others are known when they are talked to.
std::vector<Finding> examine_chip(const MachineFiles& files, const SystemPlan& plan, const PartPlan& part) {
  constexpr std::string_view before = "address 0x";
  if (part.place.bus.empty() || !part.place.text.starts_with(before)) return {};
  const std::string address = part.place.text.substr(before.size());
  for (const PartPlan& bus : plan.parts) {
    if (bus.kind != "bus" || bus.name != part.place.bus) continue;
    const std::string device = device_of(bus);
    if (!device.starts_with("/dev/i2c-")) return {};
    const std::string chip = device.substr(9) + "-" + std::string(4 - std::min<std::size_t>(address.size(), 4), '0') +
                             address;
    const std::string driver = files.link_name("/sys/bus/i2c/devices/" + chip + "/driver");
    if (driver.empty()) return {};
    return {{Severity::fault, part.object(), "the kernel's driver " + driver + " has the chip at 0x" + address,
             "it has no data until that is mended",
             "use what that driver offers (`rtdata scan` lists it), or: echo " + chip +
                 " | sudo tee /sys/bus/i2c/drivers/" + driver + "/unbind"}};
  }
  return {};
}

}  // namespace

std::vector<Finding> examine_devices(const MachineFiles& files, const SystemPlan& plan) {
  std::vector<Finding> found;
  for (const PartPlan& part : plan.parts) {
    for (Finding& one : examine_chip(files, plan, part)) found.push_back(std::move(one));
    std::string device = device_of(part);
    if (device.empty()) continue;
    // An SPI controller has a device for each chip select.
    if (!files.exists(device) && device.starts_with("/dev/spidev")) {
      const auto selects = files.names("/dev", device.substr(5) + ".");
      if (!selects.empty()) device = "/dev/" + selects.front();
    }
    found.push_back(examine_device(files, part, device));
  }
  return found;
}

std::vector<Finding> examine_groups(const MachineFiles& files) {
  // To these, distributions give the devices of ports and buses.
  constexpr std::string_view wanted[] = {"dialout", "i2c", "spi", "gpio", "iio"};
  std::vector<gid_t> mine;
  if (files.is_this_machine()) {
    if (::geteuid() == 0) return {{Severity::good, "groups", "root may open all devices"}};
    mine.resize(static_cast<std::size_t>(std::max(0, ::getgroups(0, nullptr))));
    if (::getgroups(static_cast<int>(mine.size()), mine.data()) < 0) mine.clear();
    mine.push_back(::getegid());
  }
  std::string missing;
  std::istringstream lines(files.text("/etc/group").value_or(""));
  for (std::string line; std::getline(lines, line);) {
    const std::string name = line.substr(0, line.find(':'));
    if (std::find(std::begin(wanted), std::end(wanted), name) == std::end(wanted)) continue;
    bool has_member = !line.ends_with(':');  // of a copy, whose users nobody knows here: anybody
    if (files.is_this_machine()) {
      const std::size_t at = line.find(':', name.size() + 1);
      const std::string number = at == std::string::npos ? "" : line.substr(at + 1, line.find(':', at + 1) - at - 1);
      has_member = std::any_of(mine.begin(), mine.end(), [&](gid_t group) { return std::to_string(group) == number; });
    }
    if (!has_member) missing += (missing.empty() ? "" : ",") + name;
  }
  if (missing.empty()) return {{Severity::good, "groups", "of those that devices belong to, none is missing"}};
  return {{Severity::note, "groups", (files.is_this_machine() ? "this user is not in: " : "nobody is in: ") + missing,
           "devices of these groups cannot be opened", "sudo usermod -aG " + missing + " $USER, then log in again"}};
}

}  // namespace rtdata::app
