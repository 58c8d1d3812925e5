#include "app/machine/scan.hpp"

#include <unistd.h>

#include <utility>

#include "app/core/table.hpp"
#include "app/core/terminal_text.hpp"
#include "app/machine/scanner.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/data/config_item.hpp"

namespace rtdata::app {

FoundDevice& Scanner::add(std::string kind, std::string path, std::string what, int mode) {
  scan.devices.push_back({std::move(kind), std::move(path), std::move(what)});
  FoundDevice& device = scan.devices.back();
  const Access access = access_to(files, device.path, mode);
  if (!access.is_granted) {
    device.obstacle = access.why;
    device.advice = access.advice;
  }
  return device;
}

void Scanner::line(FoundDevice& device, const char* list, const std::string& text, const std::string& bus) const {
  std::string document;
  if (std::string_view(list) == "buses") {
    document = "{\"buses\": {" + text + "}}";
  } else {
    document = "{\"buses\": {" + bus + "}, \"" + list + "\": [" + text + "]}";
  }
  if (plan_system(registry, parse_config(document)).good()) device.lines.push_back({list, text});
}

std::string Scanner::text(const std::string& file) const {
  return fitted(printable(files.text(file).value_or("")), 80);
}

void Scanner::sensor(FoundDevice& device, const std::string& name, const std::string& type, const std::string& members,
                     const std::string& bus) {
  std::string unused = name;  // "bmp280", "bmp280-2"
  for (unsigned number = 2; !names_.insert(unused).second; ++number) unused = name + "-" + std::to_string(number);
  line(device, "sensors",
       R"({"name": )" + json_text(unused) + R"(, "type": )" + json_text(type) + (members.empty() ? "" : ", ") +
           members + "}",
       bus);
}

std::string json_text(const std::string& text) { return ConfigItem::of(text).to_json(ConfigItem::Layout::one_line); }

std::string joined(std::initializer_list<std::string> words) {
  std::string all;
  for (const std::string& word : words)
    if (!word.empty()) all += (all.empty() ? "" : " ") + word;
  return all;
}

void scan_clocks(Scanner& scanner) {
  const auto all_of = [&](const char* kind, const std::string& folder, const char* what) {
    for (const std::string& name : scanner.files.names(folder)) {
      const std::string known = scanner.text(folder + "/" + name + "/name");
      const std::string device = "/dev/" + name;
      FoundDevice& found = scanner.add(kind, scanner.files.exists(device) ? device : folder + "/" + name,
                                       known.empty() ? what : known, R_OK);
      if (std::string_view(kind) != "pps") continue;
      found.obstacle = found.advice = "";  // the sensor reads /sys, which every user may
      scanner.sensor(found, name, "pps", R"("device": )" + json_text(name));
    }
  };
  all_of("pps", "/sys/class/pps", "pulse per second");
  all_of("pwm", "/sys/class/pwm", "PWM controller");
}

Scan scan_machine(const MachineFiles& files, const Registry& registry, Probing probing) {
  Scanner scanner(files, registry, probing);
  for (const auto part :
       {scan_serial, scan_i2c, scan_spi, scan_gpio, scan_iio, scan_counters, scan_one_wire, scan_clocks, scan_gpsd})
    part(scanner);
  return std::move(scanner.scan);
}

}  // namespace rtdata::app
