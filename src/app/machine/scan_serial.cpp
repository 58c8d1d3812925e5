#include <unistd.h>

#include <algorithm>
#include <vector>

#include "app/machine/scanner.hpp"
#include "io/enabling.hpp"
#include "io/kernel_file.hpp"

namespace rtdata::app {
namespace {

void serial_port(Scanner& scanner, const std::string& path, const std::string& tty) {
  // The folder of the USB device lies above those of its interface and of the port.
  const std::string device = "/sys/class/tty/" + tty + "/device/";
  std::string what;
  for (const char* up : {"../", "../../"}) {
    what = joined({scanner.text(device + up + "manufacturer"), scanner.text(device + up + "product")});
    if (!what.empty()) break;
  }
  FoundDevice& found = scanner.add("serial", path, tty + (what.empty() ? "" : ", " + what), R_OK | W_OK);
  if (scanner.files.is_this_machine()) {
    if (const std::string holder = detail::holder_of(path); !holder.empty()) {
      found.obstacle = holder + " has it open";
      found.advice = std::string("end that program first: ") + two_at_a_port;
    }
  }
  if (scanner.text("/proc/cmdline").find("console=" + tty) != std::string::npos && found.obstacle.empty()) {
    found.obstacle = "the kernel writes its messages to it, and a login may wait there";
    const std::string enabling = detail::how_to_enable("/dev/" + tty);
    found.advice = "remove `console=" + tty + "` from the kernel's command line" +
                   (enabling.empty() ? "" : "; " + enabling);
  }
  scanner.sensor(found, tty, "serial",
                 R"("device": )" + json_text(path) + R"(, "baud_rate": 9600, "fields": [{"name": "value"}])");
}

}  // namespace

void scan_serial(Scanner& scanner) {
  const MachineFiles& files = scanner.files;
  std::vector<std::string> named;
  for (const std::string& id : files.names("/dev/serial/by-id")) {
    const std::string tty = files.link_name("/dev/serial/by-id/" + id);
    if (tty.empty()) continue;
    named.push_back(tty);
    serial_port(scanner, "/dev/serial/by-id/" + id, tty);
  }
  for (const char* prefix : {"ttyUSB", "ttyACM", "ttyAMA", "ttyS", "ttymxc", "ttyTHS", "ttySC", "ttyO"}) {
    for (const std::string& tty : files.names("/sys/class/tty", prefix)) {
      if (!files.exists("/dev/" + tty) || std::find(named.begin(), named.end(), tty) != named.end()) continue;
      // PCs have ports ttyS0 to ttyS31 of which most are not there: their type is 0.
      if (scanner.text("/sys/class/tty/" + tty + "/type") != "0") serial_port(scanner, "/dev/" + tty, tty);
    }
  }
}

}  // namespace rtdata::app
