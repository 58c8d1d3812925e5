#include <unistd.h>

#include <algorithm>
#include <vector>

#include "app/machine/scanner.hpp"
#include "rtdata/io/gpio.hpp"

namespace rtdata::app {
namespace {

/// The chips according to the kernel, if this user may open them; none for another machine or without libgpiod.
std::vector<GpioChipInfo> chips_of_kernel([[maybe_unused]] const MachineFiles& files) {
#ifdef RTDATA_WITH_GPIO
  if (files.is_this_machine()) return make_kernel_gpio()->chips();
#endif
  return {};
}

/// "; free: GPIO2 GPIO3 7; used: GPIO4 (led0)"
std::string lines_text(const GpioChipInfo& chip) {
  std::string free, used;
  for (std::size_t i = 0; i < chip.lines.size(); ++i) {
    const GpioLineInfo& one = chip.lines[i];
    const std::string name = one.name.empty() ? std::to_string(i) : one.name;
    std::string& list = one.is_used ? used : free;
    list += " " + name;
    if (one.is_used && !one.consumer.empty()) list += " (" + one.consumer + ")";
  }
  return (free.empty() ? "" : "; free:" + free) + (used.empty() ? "" : "; used:" + used);
}

/// The name if it is unique, otherwise the number.
std::string line_name(const std::vector<GpioChipInfo>& all, const std::string& name, const std::string& chip,
                      std::size_t number) {
  std::size_t alike = 0;
  for (const GpioChipInfo& one : all)
    for (const GpioLineInfo& other : one.lines) alike += other.name == name ? 1 : 0;
  return !name.empty() && alike == 1 ? name : chip + ":" + std::to_string(number);
}

}  // namespace

void scan_gpio(Scanner& scanner) {
  const std::vector<GpioChipInfo> known = chips_of_kernel(scanner.files);
  for (const std::string& chip : scanner.files.names("/sys/bus/gpio/devices", "gpiochip")) {
    const std::string folder = "/sys/bus/gpio/devices/" + chip;
    std::string label, count;
    // The old interface shows label and size; it is only read.
    for (const std::string& old : scanner.files.names(folder + "/gpio", "gpiochip")) {
      label = scanner.text(folder + "/gpio/" + old + "/label");
      count = scanner.text(folder + "/gpio/" + old + "/ngpio");
    }
    const auto info = std::find_if(known.begin(), known.end(),
                                   [&](const GpioChipInfo& one) { return one.path == "/dev/" + chip; });
    if (info != known.end() && info->error_number == 0) {
      label = info->label;
      count = std::to_string(info->lines.size());
    }
    std::string what = label.empty() ? scanner.text(folder + "/of_node/name") : label;
    if (!count.empty()) what += (what.empty() ? "" : ", ") + count + " lines";
    if (info != known.end()) what += lines_text(*info);
    FoundDevice& found = scanner.add("gpio", "/dev/" + chip, what, R_OK | W_OK);
    if (info == known.end()) continue;
    // Lines to paste for the first line that is free.
    for (std::size_t i = 0; i < info->lines.size(); ++i) {
      if (info->lines[i].is_used) continue;
      const std::string name = line_name(known, info->lines[i].name, chip, i);
      const std::string common = R"("line": )" + json_text(name) + R"(, "bias": "pull-up")";
      scanner.sensor(found, "button", "edge", common + R"(, "active_low": true)");
      scanner.sensor(found, "pulses", "counter", R"("rate": "1 Hz", )" + common);
      break;
    }
  }
}

}  // namespace rtdata::app
