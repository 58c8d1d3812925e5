// What `rtdata scan` and `rtdata doctor` find, in copies of machines' files and on this one.
#include <doctest/doctest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "app/machine/doctor.hpp"
#include "app/machine/scan.hpp"
#include "app/process.hpp"
#include "paths.hpp"
#include "rtdata/app/standard.hpp"

using namespace rtdata;
using namespace rtdata::app;
using rtdata::test::Folder;
using rtdata::test::Process;

namespace {

/// A machine's files in a folder.
struct Machine {
  void file(const std::string& path, const std::string& text = "") const {
    std::filesystem::create_directories(std::filesystem::path(root + path).parent_path());
    std::ofstream(root + path, std::ios::binary) << text;
  }
  void link(const std::string& path, const std::string& target) const {
    std::filesystem::create_directories(std::filesystem::path(root + path).parent_path());
    std::filesystem::create_symlink(target, root + path);
  }
  MachineFiles files() const { return MachineFiles(root); }
  const Folder folder;
  const std::string root = folder.path();
};

const FoundDevice* find(const Scan& scan, const std::string& path, const std::string& what = "") {
  for (const FoundDevice& device : scan.devices)
    if (device.path == path && device.what.find(what) != std::string::npos) return &device;
  return nullptr;
}

const Finding* find(const std::vector<Finding>& findings, const std::string& subject) {
  for (const Finding& finding : findings)
    if (finding.subject == subject) return &finding;
  return nullptr;
}

const std::string shipped = rtdata::test::built("rtdata");

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("FW-2 scan lists what a board has, with lines that check takes") {
    const Machine board;
    board.link("/dev/serial/by-id/usb-FTDI_FT232R-if00", "../../ttyUSB0");
    board.file("/dev/ttyUSB0");
    board.file("/dev/ttyS0");
    board.file("/sys/class/tty/ttyS0/type", "0\n");  // a port that is not there
    board.file("/sys/class/tty/ttyAMA0/type", "1\n");
    board.file("/dev/ttyAMA0");
    board.file("/sys/bus/i2c/devices/i2c-1/name", "bcm2835 (i2c@7e804000)\n");
    board.file("/sys/bus/i2c/devices/i2c-10/name", "mux\n");
    board.file("/dev/i2c-1");
    board.file("/sys/bus/i2c/devices/1-0048/name", "lm75\n");
    board.link("/sys/bus/i2c/devices/1-0048/driver", "../../../bus/i2c/drivers/lm75");
    board.file("/dev/spidev0.1");
    board.file("/sys/bus/iio/devices/iio:device0/name", "mcp3208\n");
    for (const char* channel : {"in_voltage0_raw", "in_voltage1_raw", "in_voltage10_raw", "in_temp_raw"})
      board.file("/sys/bus/iio/devices/iio:device0/" + std::string(channel), "1\n");
    const std::string imu_folder = "/sys/bus/iio/devices/iio:device1/";
    board.file(imu_folder + "name", "mpu6050\n");
    board.file(imu_folder + "buffer/enable", "0\n");
    board.file(imu_folder + "scan_elements/in_accel_x_type", "be:s16/16>>0\n");
    board.file(imu_folder + "scan_elements/in_timestamp_type", "le:s64/64>>0\n");
    board.file("/sys/bus/iio/devices/trigger0/name", "mpu6050-dev1\n");
    board.file("/sys/class/pps/pps0/assert", "1700000000.000000001#1\n");
    board.file("/dev/pps0");
    board.file("/sys/class/hwmon/hwmon0/name", "cpu_thermal\n");
    board.file("/sys/class/hwmon/hwmon0/temp1_input", "42000\n");
    board.file("/sys/bus/w1/devices/28-0000075565ad/temperature", "21500\n");
    board.file("/sys/bus/w1/devices/w1_bus_master1/w1_master_slave_count", "1\n");
    const Registry registry = standard_registry();
    const Scan scan = scan_machine(board.files(), registry, Probing::no);

    const FoundDevice* usb = find(scan, "/dev/serial/by-id/usb-FTDI_FT232R-if00");
    REQUIRE(usb != nullptr);
    CHECK(usb->what == "ttyUSB0");
    CHECK(usb->lines.size() == 1);
    CHECK(find(scan, "/dev/ttyAMA0") != nullptr);
    CHECK(find(scan, "/dev/ttyS0") == nullptr);
    CHECK(find(scan, "/dev/ttyUSB0") == nullptr);  // it has a better name
    const FoundDevice* adapter = find(scan, "/dev/i2c-1", "bcm2835");
    REQUIRE(adapter != nullptr);
    CHECK(adapter->obstacle.empty());
    CHECK(find(scan, "/dev/i2c-1", "address 0x48: lm75, used by the kernel's driver lm75") != nullptr);
    const FoundDevice* closed = find(scan, "/dev/i2c-10");
    REQUIRE(closed != nullptr);
    CHECK(closed->obstacle == "No such file or directory");
    CHECK(closed->advice.find("modprobe i2c-dev") != std::string::npos);
    const FoundDevice* spi = find(scan, "/dev/spidev0.1", "0.1");
    REQUIRE(spi != nullptr);
    REQUIRE(spi->lines.size() == 1);
    CHECK(spi->lines[0].text == R"("spi0": {"type": "spi", "device": "/dev/spidev0"})");
    const FoundDevice* adc = find(scan, "/sys/bus/iio/devices/iio:device0");
    REQUIRE(adc != nullptr);
    CHECK(adc->what == "mcp3208, 4 channels");
    REQUIRE(adc->lines.size() == 4);
    CHECK(adc->lines[2].text.find("in_voltage10_raw") != std::string::npos);  // by number, not by letters
    CHECK(
        adc->lines[3].text ==
        R"({"name": "mcp3208", "type": "iio", "rate": "10 Hz", "device": "mcp3208", "channels": ["temp", "voltage0", "voltage1", "voltage10"]})");
    const FoundDevice* imu = find(scan, "/sys/bus/iio/devices/iio:device1");
    REQUIRE(imu != nullptr);
    REQUIRE(imu->lines.size() == 1);
    CHECK(imu->lines[0].text ==
          R"({"name": "mpu6050", "type": "iio_buffer", "device": "mpu6050", "channels": ["accel_x"]})");
    CHECK(find(scan, "/dev/pps0")->lines.size() == 1);
    CHECK(find(scan, "/sys/class/hwmon/hwmon0", "cpu_thermal")->lines.size() == 1);
    CHECK(find(scan, "/sys/bus/w1/devices/28-0000075565ad", "DS18B20")->lines.size() == 1);
    CHECK(find(scan, "/sys/bus/w1/devices/w1_bus_master1") == nullptr);

    // All of them together are a configuration.
    nlohmann::json document{{"buses", nlohmann::json::object()}, {"sensors", nlohmann::json::array()}};
    for (const FoundDevice& device : scan.devices) {
      for (const FoundDevice::Line& line : device.lines) {
        if (line.list == "buses") {
          document["buses"].update(nlohmann::json::parse("{" + line.text + "}"));
        } else {
          document[line.list].push_back(nlohmann::json::parse(line.text));
        }
      }
    }
    const SystemPlan plan = plan_system(registry, parse_config(document.dump()));
    INFO(plan.report());
    CHECK(plan.good());
    CHECK(document["sensors"].size() == 10);
  }

  TEST_CASE("FW-2 scan of a machine that has nothing says what to switch on") {
    const Machine empty;
    const Scan scan = scan_machine(empty.files(), standard_registry(), Probing::yes);
    CHECK(scan.devices.empty());
    REQUIRE(scan.hints.size() == 2);
    CHECK(scan.hints[0].kind == "i2c");
    CHECK(scan.hints[1].kind == "spi");
  }

  TEST_CASE("FW-2 scan takes files of the kernel that hold garbage") {
    const Machine broken;
    broken.file("/sys/bus/i2c/devices/i2c-/name", std::string(200000, '\xff'));
    broken.file("/sys/bus/i2c/devices/i2c-1/name", std::string("\0\0", 2));
    broken.file("/sys/bus/i2c/devices/1-zz/name", "x");
    broken.file("/sys/bus/iio/devices/iio:deviceX/in_voltage\"_raw", "");
    broken.link("/dev/serial/by-id/loop", "loop");
    broken.file("/sys/class/hwmon/hwmon0/temp1_input/is_a_folder");
    Process run(broken.folder, shipped, {"scan", "--root", broken.root, "--json"});
    CHECK(run.end() == 0);
    CHECK(nlohmann::json::accept(run.out));
  }

  TEST_CASE("FW-3 doctor tells of a Raspberry Pi what costs timing or data, and what to do") {
    const Machine board;
    board.file("/proc/version", "Linux version 6.6.31 #1 SMP PREEMPT\n");
    board.file("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "ondemand\n");
    board.file("/sys/devices/platform/soc/soc:firmware/get_throttled", "50005\n");
    board.file("/sys/devices/system/clocksource/clocksource0/current_clocksource", "jiffies\n");
    board.file("/proc/mounts", "/dev/mmcblk0p2 / ext4 rw,noatime 0 0\ntmpfs /run tmpfs rw 0 0\n");
    board.file("/etc/security/limits.d/99-rtdata.conf", "# rt\n@realtime - rtprio 95\n");
    const std::vector<Finding> timing = examine_timing(board.files(), nullptr);
    CHECK(find(timing, "kernel")->severity == Severity::note);
    CHECK(find(timing, "frequency")->what == "the governor is \"ondemand\"");
    CHECK(find(timing, "real-time priorities")->what == "@realtime may use those up to 95");
    std::vector<std::string> power;
    for (const Finding& finding : timing)
      if (finding.subject == "power") power.push_back(finding.what);
    CHECK(power ==
          std::vector<std::string>{"the supply's voltage was too low now", "the processors were throttled now"});
    const std::vector<Finding> clock = examine_clock(board.files());
    CHECK(find(clock, "clock source")->severity == Severity::warning);
    CHECK(find(clock, "hardware clock")->severity == Severity::note);
    const std::vector<Finding> disk = examine_disks(board.files(), nullptr);
    REQUIRE(disk.size() == 1);
    CHECK(disk[0].what == "it is an SD card or eMMC");

    board.file("/sys/kernel/realtime", "1\n");
    board.file("/sys/devices/platform/soc/soc:firmware/get_throttled", "0\n");
    board.file("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "performance\n");
    for (const Finding& finding : examine_timing(board.files(), nullptr)) {
      CAPTURE(finding.subject);
      CHECK(finding.severity == Severity::good);
    }
    board.file("/sys/devices/platform/soc/soc:firmware/get_throttled", "?\n");
    CHECK(find(examine_timing(board.files(), nullptr), "power")->severity == Severity::warning);
    board.file("/proc/mounts", "/dev/sda1 / ext4 ro,relatime 0 0\n");
    CHECK(examine_disks(board.files(), nullptr)[0].what == "it is mounted read-only");
  }

  TEST_CASE("FW-3 doctor looks at the devices, disks and tiers of a configuration; the exit status says the worst") {
    const Folder folder;
    folder.write("bench.json", R"({"tiers": {"fast": {"policy": "fifo", "priority": 80}},
      "sensors": [{"name": "board", "type": "serial", "device": "/dev/does-not-exist", "fields": [{"name": "x"}],
      "tier": "fast"}], "sinks": [{"type": "file", "path": "bench.jsonl"}]})");
    Process run(folder, shipped, {"doctor", "bench.json"});
    CHECK(run.end() == 2);
    CHECK(run.out.find("fault: sensor board: /dev/does-not-exist: No such file or directory") == 0);  // the worst first
    CHECK(run.out.find("disk of " + folder.path()) != std::string::npos);
    CHECK_FALSE(std::filesystem::exists(folder.path() + "/bench.jsonl"));  // it looks, and makes nothing

    folder.write("away.json", R"({"sensors": [{"name": "l", "type": "host", "quantity": "load", "rate": "1 Hz"}],
      "sinks": [{"type": "file", "path": "/proc/nowhere/bench.jsonl"}]})");
    Process away(folder, shipped, {"doctor", "away.json"});
    CHECK(away.end() == 2);
    CHECK((away.err + away.out).find("/proc/nowhere") != std::string::npos);

    folder.write("wrong.json", R"({"sensors": [{"name": "l", "type": "hots"}]})");
    Process wrong(folder, shipped, {"doctor", "wrong.json"});
    CHECK(wrong.end() == 2);
    CHECK(wrong.err.find("host") != std::string::npos);
    CHECK(wrong.out.empty());

    Process nowhere(folder, shipped, {"doctor", "--root", "nowhere"});
    CHECK(nowhere.end() == 1);
    CHECK(nowhere.err.find("nowhere") != std::string::npos);

    Process here(folder, shipped, {"doctor", "--json"});
    const int status = here.end();
    const auto json = nlohmann::json::parse(here.out);
    CHECK(status == (json["worst"] == "fault" ? 2 : json["worst"] == "warning" ? 3 : 0));
    CHECK(json["findings"].size() >= 6);
  }

  TEST_CASE("FW-3 doctor says that a device may not be opened, and which group may") {
    if (::geteuid() == 0) {
      MESSAGE("skipped: root may open everything");
      return;
    }
    const Access access = access_to(MachineFiles(), "/dev/mem", R_OK);
    CHECK_FALSE(access.is_granted);
    CHECK(access.why == "Permission denied");
    CHECK_FALSE(access.advice.empty());
  }
}
