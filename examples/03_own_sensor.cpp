// A sensor of one's own: a class with open, read and close. Used from code, and as a type that configurations can name.
#include <fcntl.h>
#include <unistd.h>

#include <cstdlib>

#include "rtdata/config/system.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata::literals;

struct Uptime {
  double uptime = 0;
  RTDATA_FIELDS(Uptime, (uptime, "s"))
};
struct UptimeConfig {
  std::string file = "/proc/uptime";
  friend constexpr auto parameters(rtdata::type_tag<UptimeConfig>) {
    return rtdata::parameter_list(rtdata::parameter("file", &UptimeConfig::file, "where the kernel says it"));
  }
};

class UptimeDevice {
 public:
  explicit UptimeDevice(UptimeConfig config) : config_(std::move(config)) {}
  rtdata::Result<void> open() {  // at the start, and again after faults
    fd_ = ::open(config_.file.c_str(), O_RDONLY | O_CLOEXEC);
    if (fd_ < 0) return rtdata::system_error(errno, "cannot open the file", config_.file, "check `file`");
    return {};
  }
  rtdata::Result<Uptime> read() {
    char text[64] = {};
    if (::pread(fd_, text, sizeof text - 1, 0) < 0) return rtdata::system_error(errno, "cannot read", config_.file);
    return Uptime{std::strtod(text, nullptr)};
  }
  void close() { ::close(fd_); }

 private:
  UptimeConfig config_;
  int fd_ = -1;
};

int main() {
  rtdata::Registry registry;
  registry.add_sensor<UptimeConfig>(
      "uptime", "how long the computer is up", [](const UptimeConfig&) { return rtdata::description_of<Uptime>(); },
      [](rtdata::Loop& loop, const rtdata::SensorConfig& common, const UptimeConfig& config) {
        return rtdata::Sensor<Uptime>(loop, common, UptimeDevice(config));
      });
  rtdata::Loop loop;
  rtdata::Sensor<Uptime> from_code(loop, {.name = "code", .topic = "uptime", .rate = 20_Hz}, UptimeDevice({}));
  rtdata::System from_file(loop, registry, rtdata::parse_config(R"({"sensors": [
      {"name": "file", "type": "uptime", "topic": "uptime", "rate": "20 Hz"}]})"));
  int good = 0;
  auto check = loop.subscribe<Uptime>("uptime", [&](const rtdata::Event<Uptime>& e) { good += e->uptime > 0; });
  loop.run_for(500ms);
  return good >= 2 && loop.runtime().balances() ? 0 : 1;
}
