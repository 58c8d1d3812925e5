#include "app/run/starter.hpp"

#include <sys/stat.h>
#include <sys/sysmacros.h>

#include <filesystem>
#include <vector>

#include "app/machine/scan.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/sensors/host.hpp"

namespace rtdata::app {
namespace {

struct Entry {
  std::string comment;
  std::string text;
};

/// Whether it could be made: a type of this program, without mistakes.
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

/// What every computer knows of itself, and this one of its temperature.
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

/// Converters of the kernel that can be read here: four at most.
std::vector<Entry> analog_entries(const Registry& registry, const MachineFiles& files) {
  std::vector<Entry> entries;
  for (const FoundDevice& device : scan_machine(files, registry, Probing::no).devices) {
    if (device.kind != "iio" || !device.obstacle.empty()) continue;
    for (const FoundDevice::Line& line : device.lines) {
      if (entries.size() == 4) return entries;
      entries.push_back(
          {entries.empty() ? "set the scale and unit of your sensors; see: rtdata types analog" : "", line.text});
    }
  }
  return entries;
}

}  // namespace

bool is_on_card(const std::string& folder, const std::string& root) {
  struct stat status {};
  if (::stat(folder.empty() ? "." : folder.c_str(), &status) != 0) return false;
  const std::string device = std::to_string(major(status.st_dev)) + ":" + std::to_string(minor(status.st_dev));
  std::error_code ignored;
  const auto found = std::filesystem::read_symlink(root + "/sys/dev/block/" + device, ignored);
  return found.filename().string().starts_with("mmcblk");
}

std::string starter_file(const Registry& registry, const std::string& file, const std::string& root) {
  const std::string stem = std::filesystem::path(file).stem().string();
  std::string text = "// A starter file for this machine. Run it:    rtdata run " + file +
                     " --for 10s\n// What else can be configured:               rtdata types\n{\n  \"$schema\": \"" +
                     std::string(schema_file) +
                     "\",\n  \"name\": " + ConfigItem::of(stem).to_json(ConfigItem::Layout::one_line) + ",\n";
  std::vector<Entry> sensors = host_entries();
  for (Entry& entry : analog_entries(registry, MachineFiles(root))) sensors.push_back(std::move(entry));
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
           {{"check it with: rtdata verify " + stem + ".db; at 1 GB its oldest rows give way to new ones" +
                 (is_card ? "\n    // card: fewer writes, since this is an SD card; a power cut costs 10 s" : ""),
             recording},
            {"one JSON object a line; 10 files of 100 MB, then the oldest goes", lines}});
  return text + "\n}\n";
}

}  // namespace rtdata::app
