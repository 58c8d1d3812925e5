#include <unistd.h>

#include <algorithm>
#include <vector>

#include "app/core/terminal_text.hpp"
#include "app/machine/scanner.hpp"
#include "io/enabling.hpp"
#include "rtdata/io/iio.hpp"
#include "rtdata/sensors/host.hpp"

namespace rtdata::app {
namespace {

void hwmon_chips(Scanner& scanner) {
  const std::vector<HostSensorInfo> known = available_host_sensors(scanner.files.path(""));
  for (const std::string& chip : scanner.files.names("/sys/class/hwmon", "hwmon")) {
    const std::string folder = "/sys/class/hwmon/" + chip;
    std::vector<std::string> inputs;
    for (const std::string& file : scanner.files.names(folder))
      if (file.ends_with("_input")) inputs.push_back(file);
    if (inputs.empty()) continue;
    FoundDevice& found = scanner.add(
        "hwmon", folder, scanner.text(folder + "/name") + ", " + std::to_string(inputs.size()) + " values", R_OK);
    for (const HostSensorInfo& input : known) {
      if (!input.file.starts_with(scanner.files.path(folder) + "/")) continue;
      scanner.sensor(found, printable(input.device), "host",
                     R"("quantity": )" + json_text(std::string(name_of(input.quantity))) + R"(, "device": )" +
                         json_text(input.device) + R"(, "rate": "1 Hz")");
    }
  }
}

/// The name of a device if it is unique, otherwise the kernel's name ("iio:device0").
std::string name_of(const Scanner& scanner, const std::string& device, const char* prefix, const std::string& folder) {
  const std::string name = scanner.text(folder + "/" + device + "/name");
  const std::vector<std::string> all = scanner.files.names(folder, prefix);
  const auto alike = std::count_if(all.begin(), all.end(), [&](const std::string& other) {
    return scanner.text(folder + "/" + other + "/name") == name;
  });
  return name.empty() || alike != 1 ? device : name;
}

/// A line for all channels of a device: through its buffer if it has its own trigger, otherwise one by one.
void iio_line(Scanner& scanner, FoundDevice& found, const std::string& device) {
  const MachineFiles& files = scanner.files;
  const std::string folder = "/sys/bus/iio/devices/" + device;
  const std::string trigger = scanner.text(folder + "/name") + "-dev" + device.substr(10);
  bool has_trigger = false;
  for (const std::string& other : files.names("/sys/bus/iio/devices", "trigger"))
    has_trigger = has_trigger || scanner.text("/sys/bus/iio/devices/" + other + "/name") == trigger;
  const bool is_buffered = has_trigger && files.exists(folder + "/buffer/enable");
  std::string channels;
  const auto add_channel = [&](const std::string& file, std::string_view end) {
    if (!file.ends_with(end) || file.size() <= 3 + end.size()) return;
    const std::string channel = file.substr(3, file.size() - 3 - end.size());
    const std::string quoted = json_text(channel);
    if (iio_quantity(channel) != nullptr && channels.find(quoted) == std::string::npos)
      channels += (channels.empty() ? "" : ", ") + quoted;
  };
  for (const std::string& file : files.names(is_buffered ? folder + "/scan_elements" : folder, "in_")) {
    if (is_buffered) {
      add_channel(file, "_type");
    } else {
      add_channel(file, "_raw");
      add_channel(file, "_input");
    }
  }
  if (channels.empty()) return;
  const std::string which = name_of(scanner, device, "iio:device", "/sys/bus/iio/devices");
  scanner.sensor(found, which, is_buffered ? "iio_buffer" : "iio",
                 (is_buffered ? R"("device": )" : R"("rate": "10 Hz", "device": )") + json_text(which) +
                     R"(, "channels": [)" + channels + "]");
}

}  // namespace

void scan_iio(Scanner& scanner) {
  std::size_t count = 0;  // of the lines
  for (const std::string& device : scanner.files.names("/sys/bus/iio/devices", "iio:device")) {
    const std::string folder = "/sys/bus/iio/devices/" + device;
    std::vector<std::string> channels;
    for (const std::string& file : scanner.files.names(folder, "in_"))
      if (file.ends_with("_raw") || file.ends_with("_input")) channels.push_back(file);
    FoundDevice& found = scanner.add(
        "iio", folder, scanner.text(folder + "/name") + ", " + std::to_string(channels.size()) + " channels", R_OK);
    for (const std::string& channel : channels) {
      if (!channel.starts_with("in_voltage") || !channel.ends_with("_raw")) continue;
      scanner.sensor(
          found, "adc" + std::to_string(count++), "analog",
          R"("rate": "10 Hz", "file": )" + json_text(folder + "/" + channel) + R"(, "scale": 3.3, "unit": "V")");
    }
    iio_line(scanner, found, device);
  }
  hwmon_chips(scanner);
}

void scan_counters(Scanner& scanner) {
  const MachineFiles& files = scanner.files;
  const std::string all = "/sys/bus/counter/devices";
  for (const std::string& device : files.names(all, "counter")) {
    const std::string folder = all + "/" + device;
    std::vector<std::string> counts;
    for (const std::string& count : files.names(folder, "count"))
      if (files.exists(folder + "/" + count + "/count")) counts.push_back(count);
    FoundDevice& found = scanner.add("counter", folder,
                                     scanner.text(folder + "/name") + ", " + std::to_string(counts.size()) +
                                         (counts.size() == 1 ? " count" : " counts"),
                                     R_OK);
    const std::string which = name_of(scanner, device, "counter", all);
    for (const std::string& count : counts) {
      const std::string channel = counts.size() == 1 ? "" : R"(, "channel": )" + json_text(count);
      scanner.sensor(found, which, "encoder", R"("device": )" + json_text(which) + channel + R"(, "rate": "10 Hz")");
    }
  }
}

void scan_one_wire(Scanner& scanner) {
  const std::vector<std::string> devices = scanner.files.names("/sys/bus/w1/devices");
  if (devices.empty()) {
    scanner.hint("1-wire", "no 1-Wire bus: " + detail::how_to_enable("/sys/bus/w1"));
  }
  for (const std::string& device : devices) {
    if (device.starts_with("w1_bus_master")) continue;
    const std::string folder = "/sys/bus/w1/devices/" + device;
    const bool is_thermometer = scanner.files.exists(folder + "/temperature");
    FoundDevice& found = scanner.add("1-wire", folder,
                                     device.starts_with("28-")   ? "DS18B20"
                                     : device.starts_with("10-") ? "DS18S20"
                                     : is_thermometer            ? "a thermometer"
                                                                 : "family " + device.substr(0, 2),
                                     R_OK);
    if (!is_thermometer) {
      const bool is_known = device.starts_with("28-") || device.starts_with("10-");
      if (is_known && !scanner.files.exists(folder + "/w1_slave")) {
        found.obstacle = "the kernel has no driver for it";
        found.advice = load_w1_therm;
      }
      continue;
    }
    scanner.sensor(found, device, "w1", R"("rate": "0.5 Hz", "device": )" + json_text(device));
  }
}

}  // namespace rtdata::app
