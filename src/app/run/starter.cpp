#include "app/run/starter.hpp"

#include <filesystem>
#include <vector>

#include "app/core/terminal_text.hpp"
#include "app/machine/scan.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/sensors/host.hpp"

namespace rtdata::app {
namespace {

struct Entry {
  std::string comment;
  std::string text;
};

/// True if the item could be made: its type exists in this program and it has no mistakes.
bool is_usable(const Registry& registry, const char* list, const std::string& text) {
  return plan_system(registry, parse_config("{\"" + std::string(list) + "\": [" + text + "]}")).good();
}

void add_list(std::string& file, const Registry& registry, const char* list, const std::vector<Entry>& entries) {
  std::string items;
  for (const Entry& entry : entries) {
    if (!is_usable(registry, list, entry.text)) continue;
    items += (items.empty() ? "\n" : ",\n");
    if (!entry.comment.empty()) items += "    // " + entry.comment + "\n";
    items += "    " + entry.text;
  }
  file += "  \"" + std::string(list) + "\": [" + items + (items.empty() ? "]" : "\n  ]");
}

/// The host sensors that every computer has, and this one's temperature.
std::vector<Entry> host_entries() {
  const auto entry = [](std::string comment, const char* name, const char* rate) {
    return Entry{std::move(comment), R"({"name": ")" + std::string(name) + R"(", "type": "host", "quantity": ")" +
                                         name + R"(", "rate": ")" + rate + R"(", "topic": "host/)" + name + R"("})"};
  };
  std::vector<Entry> entries{
      entry("this program; it can be read a thousand times a second too: \"1 kHz\"", "process", "10 Hz"),
      entry("the computer", "scheduler", "10 Hz"), entry("", "memory", "2 Hz"), entry("", "cpu", "2 Hz"),
      entry("", "load", "1 Hz")};
  for (const HostSensorInfo& info : available_host_sensors()) {
    if (info.quantity != HostQuantity::temperature) continue;
    entries.push_back(entry("", "temperature", "1 Hz"));
    break;
  }
  return entries;
}

/// Devices found by scan that need no knowledge of the wiring: converters of the kernel, 1-Wire thermometers, gpsd; at
/// most four of each kind. A comment lists the other devices.
std::vector<Entry> found_entries(const Registry& registry, const MachineFiles& files, std::string& others) {
  struct Wanted {
    std::string_view kind;
    const char* comment;
    std::size_t count = 0;
  };
  Wanted wanted[] = {{"iio", "set the scale and unit of your sensors; see: rtdata types analog"},
                     {"1-wire", "thermometers on 1-Wire"},
                     {"gpsd", "the receiver of gpsd; see: rtdata types gps"}};
  std::vector<Entry> entries;
  for (const FoundDevice& device : scan_machine(files, registry, Probing::no).devices) {
    bool is_used = false;
    for (Wanted& one : wanted) {
      if (device.kind != one.kind || !device.obstacle.empty()) continue;
      for (const FoundDevice::Line& line : device.lines) {
        is_used = true;
        if (one.count++ < 4) entries.push_back({one.count == 1 ? one.comment : "", line.text});
      }
    }
    if (is_used || device.lines.empty() || device.kind == "hwmon") continue;
    others += "//   " + device.kind + ": " + printable(device.path) + (device.what.empty() ? "" : ", ") +
              printable(device.what) + "\n";
  }
  return entries;
}

}  // namespace

std::string starter_file(const Registry& registry, const std::string& file, const std::string& root) {
  const std::string stem = std::filesystem::path(file).stem().string();
  std::vector<Entry> sensors = host_entries();
  std::string others;
  for (Entry& entry : found_entries(registry, MachineFiles(root), others)) sensors.push_back(std::move(entry));
  if (!others.empty()) others = "// What else there is here, with lines to paste: rtdata scan\n" + others;
  std::string text = "// A starter file for this machine. Run it:    rtdata run " + file +
                     " --for 10s\n// What else can be configured:               rtdata types\n" + others +
                     "{\n  \"$schema\": \"" + std::string(schema_file) +
                     "\",\n  \"name\": " + ConfigItem::of(stem).to_json(ConfigItem::Layout::one_line) + ",\n";
  add_list(text, registry, "sensors", sensors);
  text += ",\n";
  const auto output = [&](const char* extension) {
    return ConfigItem::of(stem + extension).to_json(ConfigItem::Layout::one_line);
  };
  const bool is_card = is_on_card(std::filesystem::path(file).parent_path().string(), root);
  const std::string recording = R"({"type": "sqlite", "path": )" + output(".db") + R"(, "topics": ["#"], )" +
                                (is_card ? R"("profile": "card", )" : "") + R"("max_bytes": 1000000000})";
  const std::string lines = R"({"type": "file", "path": )" + output(".jsonl") +
                            R"(, "topics": ["#"], "rotate": {"bytes": 100000000}, "keep": 9})";
  add_list(text, registry, "sinks",
           {{"check it with: rtdata verify " + stem + ".db; from 1 GB on, its oldest rows are deleted" +
                 (is_card ? "\n    // card: fewer writes, since this is an SD card; a power failure costs 10 s" : ""),
             recording},
            {"one JSON object per line; 10 files of 100 MB, then the oldest is deleted", lines}});
  return text + "\n}\n";
}

}  // namespace rtdata::app
