// Checks that the devices, chips, GPIO lines and PWM channels of a configuration exist and are free.
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <optional>

#include "app/machine/doctor.hpp"
#include "config/read/mistakes.hpp"
#include "io/enabling.hpp"
#include "io/gpio_lookup.hpp"
#include "io/kernel_file.hpp"

namespace rtdata::app {
namespace {

using config_detail::text_or_empty;
using Found = std::optional<Finding>;

constexpr const char* no_data = "this part has no data until this is fixed";
constexpr const char* begins_as_failed = "the output begins as failed, and is tried each second";
/// A line or a channel is opened when the part is made.
constexpr const char* no_start = "the run does not start";

Finding at_fault(const PartPlan& part, std::string what, std::string advice, const char* cost = no_data) {
  return {Severity::fault, part.object(), std::move(what), part.kind == "output" ? no_start : cost, std::move(advice)};
}
/// A finding for a missing device: an output is made without it, unless it is `required`.
Finding missing(const PartPlan& part, std::string what, std::string advice, const char* cost = no_data) {
  bool is_required = false;
  Problems ignored;
  if (const ConfigItem* item = part.item.find("required")) ConfigValue<bool>::read(*item, is_required, ignored);
  Finding found = at_fault(part, std::move(what), std::move(advice), cost);
  if (part.kind == "output" && !is_required) found.cost = begins_as_failed;
  return found;
}
Finding well(const PartPlan& part, std::string what) { return {Severity::good, part.object(), std::move(what)}; }

/// The device file of the part; empty: none. The sensor itself searches for other names, such as a disk or a network.
std::string device_of(const MachineFiles& files, const PartPlan& part) {
  for (const char* key : {"device", "file"}) {
    const std::string device = text_or_empty(part.item, key);
    if (!device.starts_with("/")) continue;
    // An SPI controller has a device for each chip select.
    const auto selects = device.starts_with("/dev/spidev") ? files.names("/dev", device.substr(5) + ".")
                                                           : std::vector<std::string>();
    return selects.empty() || files.exists(device) ? device : "/dev/" + selects.front();
  }
  return "";
}

Finding examine_device(const MachineFiles& files, const PartPlan& part, const std::string& device) {
  // Files below /sys and /proc are only read; a bus or a port is also written.
  const bool is_node = device.starts_with("/dev/");
  const Access access = access_to(files, device, is_node ? R_OK | W_OK : R_OK);
  if (!access.is_granted)
    return (files.exists(device) ? at_fault : missing)(part, device + ": " + access.why, access.advice, no_data);
  struct stat status {};
  if (files.is_this_machine() && is_node && ::stat(device.c_str(), &status) == 0 && !S_ISCHR(status.st_mode))
    return at_fault(
        part, device + " is not a device but a file or folder",
        "a program wrote to that name while the device was unplugged: remove it, and plug the device in again");
  const std::string holder = files.is_this_machine() && is_node && part.type == "serial" ? detail::holder_of(device)
                                                                                         : "";
  if (holder.empty()) return well(part, device + " can be used");
  return {Severity::warning, part.object(), device + ": " + holder + " has it open",
          part.kind == "output" ? no_start : two_at_a_port, "end that program first"};
}

/// Checks for a chip on I2C that a kernel driver has. Other chips can only be checked by talking to them.
Found examine_chip(const MachineFiles& files, const SystemPlan& plan, const PartPlan& part) {
  constexpr std::string_view before = "address 0x";
  if (!part.place.text.starts_with(before)) return {};
  const std::string address = part.place.text.substr(before.size());
  for (const PartPlan* bus : plan.of_kind("bus")) {
    const std::string device = text_or_empty(bus->item, "device");
    if (bus->name != part.place.bus || !device.starts_with("/dev/i2c-")) continue;
    const std::string chip = device.substr(9) + "-" + std::string(4 - std::min<std::size_t>(address.size(), 4), '0') +
                             address;
    const std::string driver = files.link_name("/sys/bus/i2c/devices/" + chip + "/driver");
    if (!driver.empty())
      return at_fault(part, "the kernel's driver " + driver + " has the chip at 0x" + address,
                      "use what that driver offers (`rtdata scan` lists it), or: echo " + chip +
                          " | sudo tee /sys/bus/i2c/drivers/" + driver + "/unbind");
  }
  return {};
}

/// Checks a thermometer on 1-Wire, which has no file path in the configuration.
Found examine_w1(const MachineFiles& files, const PartPlan& part) {
  if (part.kind != "sensor" || part.type != "w1") return {};
  const std::string bus = text_or_empty(part.item, "root") + "/sys/bus/w1", device = text_or_empty(part.item, "device");
  if (!files.exists(bus))
    return at_fault(part, "there is no 1-Wire bus (" + bus + ")", detail::how_to_enable("/sys/bus/w1"));
  if (device.empty()) return {};
  const std::string folder = bus + "/devices/" + device;
  if (!files.exists(folder))
    return at_fault(part, device + " is not on the 1-Wire bus",
                    "check its wires and its pull-up resistor; `rtdata scan` lists those that answer");
  if (!files.exists(folder + "/w1_slave")) return at_fault(part, device + " has no driver", load_w1_therm);
  return well(part, device + " is on the 1-Wire bus");
}

/// Checks that gpsd is installed, for a receiver on this machine. The sensor reports if it does not run.
Found examine_gps(const MachineFiles& files, const PartPlan& part) {
  if (part.kind != "sensor" || part.type != "gps") return {};
  const std::string host = text_or_empty(part.item, "host");
  if (!host.empty() && host != "localhost" && host != "127.0.0.1" && host != "::1") return {};
  for (const char* program : {"/usr/sbin/gpsd", "/usr/local/sbin/gpsd", "/usr/bin/gpsd", "/run/gpsd.sock"})
    if (files.exists(program)) return {};
  return Finding{Severity::warning, part.object(), "no gpsd is installed",
                 "the sensor has no data unless gpsd runs in a container", std::string(detail::how_to_start_gpsd)};
}

/// Empty for a copy of another machine's files, because the lines of its chips are unknown.
Found examine_line(const MachineFiles& files, const PartPlan& part, [[maybe_unused]] const ConfigItem& item) {
  if (files.names("/dev", "gpiochip").empty())
    return missing(part, "this machine has no GPIO chip", "`ls /dev/gpiochip*` shows them", no_start);
#ifdef RTDATA_WITH_GPIO
  GpioLineName line;
  Problems ignored;
  const ConfigItem* name = item.find("line");
  if (!files.is_this_machine() || name == nullptr || !ConfigValue<GpioLineName>::read(*name, line, ignored)) return {};
  const auto found = detail::find_gpio_line(make_kernel_gpio()->chips(), line, text_or_empty(item, "chip"));
  if (!found)
    return (found.error().code == Errc::not_found ? missing : at_fault)(
        part, found.error().where + ": " + found.error().why, found.error().advice, no_start);
  if (!found->line.is_used) return well(part, found->text + " is free");
  const std::string& who = found->line.consumer;
  return Finding{
      Severity::warning, part.object(),
      found->text + ": " + (who.empty() ? "another program uses it, which gives no name" : "\"" + who + "\" has it"),
      no_start, "end that program, or use another line; a driver of the kernel is named in the device tree"};
#else
  return {};
#endif
}

std::int64_t number_at(const ConfigItem& item, std::string_view key) {
  const ConfigItem* found = item.find(key);
  std::int64_t number = 0;
  Problems ignored;
  return found != nullptr && ConfigValue<std::int64_t>::read(*found, number, ignored) ? number : 0;
}

Finding examine_pwm(const MachineFiles& files, const PartPlan& part) {
  const std::string root = text_or_empty(part.item, "root");
  const std::string chip = (root.empty() ? "/sys/class/pwm" : root) + "/pwmchip" +
                           std::to_string(number_at(part.item, "chip"));
  const std::int64_t channel = number_at(part.item, "channel");
  const auto count = files.text(chip + "/npwm");
  if (!count)
    return missing(part, "there is no PWM chip " + chip,
                   "on a Raspberry Pi, add the line `dtoverlay=pwm-2chan` to /boot/firmware/config.txt, then reboot");
  std::int64_t channels = 0;
  std::from_chars(count->data(), count->data() + count->size(), channels);
  if (channel >= channels)
    return missing(part, chip + " has " + *count + " channels, counted from 0", "set `channel` to one of them");
  const std::string folder = chip + "/pwm" + std::to_string(channel);
  const std::string file = files.exists(folder) ? folder + "/duty_cycle" : chip + "/export";
  const Access access = access_to(files, file, W_OK);
  if (!access.is_granted) return at_fault(part, file + ": " + access.why, access.advice);
  return well(part, folder + " can be used");
}

}  // namespace

std::vector<Finding> examine_devices(const MachineFiles& files, const SystemPlan& plan) {
  std::vector<Finding> found;
  for (const PartPlan& part : plan.parts) {
    for (const Found& one : {examine_chip(files, plan, part), examine_w1(files, part), examine_gps(files, part)})
      if (one) found.push_back(*one);
    if (const std::string device = device_of(files, part); !device.empty())
      found.push_back(examine_device(files, part, device));
  }
  return found;
}

std::vector<Finding> examine_lines(const MachineFiles& files, const SystemPlan& plan) {
  std::vector<Finding> found;
  for (const PartPlan& part : plan.parts) {
    if (part.kind == "output" && part.type == "pwm") found.push_back(examine_pwm(files, part));
    std::vector<const ConfigItem*> items;
    if ((part.kind == "output" && part.type == "gpio") ||
        (part.kind == "sensor" && (part.type == "edge" || part.type == "counter")))
      items.push_back(&part.item);
    const ConfigItem* lines = part.kind == "sensor" && part.type == "gpio" ? part.item.find("lines") : nullptr;
    for (std::size_t i = 0; lines != nullptr && lines->is_array() && lines->find(i) != nullptr; ++i)
      items.push_back(lines->find(i));
    for (const ConfigItem* item : items)
      if (Found one = examine_line(files, part, *item)) found.push_back(*std::move(one));
  }
  return found;
}

}  // namespace rtdata::app
