#include <grp.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <sstream>

#include "app/machine/doctor.hpp"
#include "io/enabling.hpp"

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
  // A sensor waits for its device; an output is safe from the start on, or there is none.
  const bool is_output = part.kind == "output";
  const char* const cost = is_output ? "the run does not start" : "it has no data until that is mended";
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
          is_output ? cost : "two programs at one port take each other's bytes", "end that first"};
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

const std::string* text_of(const PartPlan& part, std::string_view key) {
  const ConfigItem* item = part.item.find(key);
  return item != nullptr ? item->as_string() : nullptr;
}

/// A thermometer on 1-Wire, of which the configuration has no file's path.
std::vector<Finding> examine_w1(const MachineFiles& files, const PartPlan& part) {
  constexpr const char* cost = "it has no data until that is mended";
  const std::string* root = text_of(part, "root");
  const std::string bus = (root != nullptr ? *root : "") + "/sys/bus/w1";
  if (!files.exists(bus))
    return {{Severity::fault, part.object(), "there is no 1-Wire bus (" + bus + ")", cost,
             detail::how_to_enable("/sys/bus/w1")}};
  const std::string* device = text_of(part, "device");
  if (device == nullptr || device->empty()) return {};
  const std::string folder = bus + "/devices/" + *device;
  if (!files.exists(folder))
    return {{Severity::fault, part.object(), *device + " is not on the 1-Wire bus", cost,
             "look at its wires and its pull-up resistor; `rtdata scan` lists those that answer"}};
  if (!files.exists(folder + "/w1_slave"))
    return {{Severity::fault, part.object(), *device + " has no driver", cost,
             "sudo modprobe w1_therm; for good: a line `w1_therm` in /etc/modules"}};
  return {{Severity::good, part.object(), *device + " is on the 1-Wire bus"}};
}

/// A receiver behind this machine's gpsd: whether that is installed. Whether it runs, a sensor says.
std::vector<Finding> examine_gps(const MachineFiles& files, const PartPlan& part) {
  const std::string* host = text_of(part, "host");
  if (host != nullptr && *host != "localhost" && *host != "127.0.0.1" && *host != "::1") return {};
  for (const char* program : {"/usr/sbin/gpsd", "/usr/local/sbin/gpsd", "/usr/bin/gpsd", "/run/gpsd.sock"})
    if (files.exists(program)) return {};
  return {{Severity::warning, part.object(), "no gpsd is installed", "it has no data unless gpsd runs in a container",
           std::string(detail::how_to_start_gpsd)}};
}

}  // namespace

std::vector<Finding> examine_devices(const MachineFiles& files, const SystemPlan& plan) {
  std::vector<Finding> found;
  for (const PartPlan& part : plan.parts) {
    for (Finding& one : examine_chip(files, plan, part)) found.push_back(std::move(one));
    if (part.kind == "sensor" && part.type == "w1")
      for (Finding& one : examine_w1(files, part)) found.push_back(std::move(one));
    if (part.kind == "sensor" && part.type == "gps")
      for (Finding& one : examine_gps(files, part)) found.push_back(std::move(one));
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
