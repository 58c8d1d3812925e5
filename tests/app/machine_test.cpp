// What `rtdata scan` and `rtdata doctor` find, in copies of machines' files and on this one.
#include <doctest/doctest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <random>

#include "app/core/terminal_text.hpp"
#include "app/machine/doctor.hpp"
#include "app/machine/scan.hpp"
#include "app/machine/scanner.hpp"
#include "app/process.hpp"
#include "app/run/starter.hpp"
#include "io/enabling.hpp"
#include "paths.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/testing/fake_i2c.hpp"
#include "sensors/fixture.hpp"

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

/// That scan and doctor look at, or might.
constexpr const char* files_of_a_machine[] = {
    "/dev/serial/by-id/usb-x",
    "/dev/ttyUSB0",
    "/dev/ttyS0",
    "/dev/i2c-1",
    "/dev/spidev0.0",
    "/dev/gpiochip0",
    "/sys/class/tty/ttyUSB0/device",
    "/sys/class/tty/ttyUSB0/manufacturer",
    "/sys/class/tty/ttyS0/type",
    "/sys/bus/i2c/devices/i2c-1/name",
    "/sys/bus/i2c/devices/1-0076/name",
    "/sys/bus/i2c/devices/1-0076/driver",
    "/sys/bus/i2c/devices/i2c-x/name",
    "/sys/class/spi_master/spi0",
    "/sys/bus/gpio/devices/gpiochip0/gpio",
    "/sys/bus/iio/devices/iio:device0/name",
    "/sys/bus/iio/devices/iio:device0/in_voltage0_raw",
    "/sys/class/hwmon/hwmon0/name",
    "/sys/class/hwmon/hwmon0/temp1_input",
    "/sys/class/hwmon/hwmon0/in0_lcrit_alarm",
    "/sys/bus/w1/devices/28-1/temperature",
    "/sys/bus/w1/devices/2",
    "/sys/class/pps/pps0/name",
    "/sys/class/pwm",
    "/proc/cmdline",
    "/proc/version",
    "/proc/mounts",
    "/proc/swaps",
    "/proc/self/timerslack_ns",
    "/proc/sys/kernel/sched_rt_runtime_us",
    "/proc/sys/kernel/sched_rt_period_us",
    "/etc/group",
    "/etc/security/limits.conf",
    "/etc/security/limits.d/a.conf",
    "/sys/kernel/realtime",
    "/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor",
    "/sys/devices/system/cpu/cpuidle/current_driver",
    "/sys/devices/system/clocksource/clocksource0/current_clocksource",
    "/sys/devices/system/clocksource/clocksource0/available_clocksource",
    "/sys/devices/platform/soc/soc:firmware/get_throttled",
    "/sys/class/rtc",
    "/run/systemd/timesync/synchronized",
    "/sys/class/thermal/thermal_zone0/type",
    "/sys/class/thermal/thermal_zone0/temp",
    "/sys/bus/w1/devices/28-1/w1_slave",
    "/proc/loadavg",
    "/proc/stat",
    "/proc/meminfo",
    "/proc/net/dev",
    "/proc/diskstats",
    "/sys/class/net/eth0/statistics/rx_bytes",
    "/sys/bus/counter/devices/counter0/name",
    "/boot/firmware/config.txt",
    "/sys/firmware/devicetree/base/model",
};

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
    board.file("/sys/class/hwmon/hwmon1/name", "ina226\n");
    board.file("/sys/class/hwmon/hwmon1/in1_input", "12000\n");
    board.file("/sys/class/hwmon/hwmon1/power1_input", "1\n");
    for (const auto& [file, text] : {std::pair{"counter0/name", "qep\n"},
                                     {"counter0/count0/count", "3\n"},
                                     {"counter1/name", "timer\n"},
                                     {"counter1/count0/count", "3\n"},
                                     {"counter1/count1/count", "3\n"}})
      board.file("/sys/bus/counter/devices/" + std::string(file), text);
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
    const FoundDevice* power = find(scan, "/sys/class/hwmon/hwmon1", "ina226, 2 values");
    REQUIRE(power != nullptr);
    REQUIRE(power->lines.size() == 2);
    CHECK(power->lines[0].text ==
          R"({"name": "ina226/in1", "type": "host", "quantity": "voltage", "device": "ina226/in1", "rate": "1 Hz"})");
    const FoundDevice* counter = find(scan, "/sys/bus/counter/devices/counter0", "qep, 1 count");
    REQUIRE(counter != nullptr);
    REQUIRE(counter->lines.size() == 1);
    CHECK(counter->lines[0].text == R"({"name": "qep", "type": "encoder", "device": "qep", "rate": "10 Hz"})");
    const FoundDevice* timer = find(scan, "/sys/bus/counter/devices/counter1", "timer, 2 counts");
    REQUIRE(timer != nullptr);
    REQUIRE(timer->lines.size() == 2);
    CHECK(timer->lines[1].text ==
          R"({"name": "timer-2", "type": "encoder", "device": "timer", "channel": "count1", "rate": "10 Hz"})");
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
    CHECK(document["sensors"].size() == 15);
  }

  TEST_CASE("FW-2 scan knows the chips of all drivers by their identity, with lines that check takes") {
    const Registry registry = standard_registry();
    std::size_t known = 0;
    for (const TypeInfo& type : registry.sensors().types()) {
      for (const KnownChip& one : type.page.chips) {
        for (const unsigned address : one.addresses) {
          if (address == 0) continue;
          CAPTURE(type.name);
          CAPTURE(one.name);
          CAPTURE(address);
          CHECK(mistake_in(address).empty());
          const auto wires = std::make_shared<FakeI2c>();
          FakeI2cChip& chip = wires->chip(address);
          if (one.identity) put_code(chip, one.identity->number, one.identity->value, one.identity->size());
          const I2cBus bus("i2c1", wires);
          I2cDevice device = bus.device({address});
          const LikelyChip likely = likely_chip(device, registry);
          const bool is_sure = one.identity && one.identity->value != 0xff;
          CHECK(likely.what.starts_with("perhaps ") == !is_sure);
          CHECK(likely.what.find(one.name) != std::string::npos);
          bool is_driven = false;
          for (const LikelyChip::Driver& driver : likely.drivers) {
            is_driven = is_driven || (driver.type == type.name && driver.model == one.model);
            const std::string model = driver.model.empty() ? "" : R"(, "model": ")" + driver.model + "\"";
            const std::string
                text = R"({"buses": {"b": {"type": "i2c", "device": "/dev/i2c-1"}}, "sensors": [{"name": "s",
                "rate": "1 Hz", "bus": "b", "type": ")" +
                       driver.type + R"(", "address": )" + std::to_string(address) + model + "}]}";
            const SystemPlan plan = plan_system(registry, parse_config(text));
            CHECK_MESSAGE(plan.good(), plan.report());
          }
          CHECK(is_driven);
          if (!is_sure) continue;
          ++known;
          put_code(chip, one.identity->number, one.identity->value ^ one.identity->mask, one.identity->size());
          CHECK(likely_chip(device, registry).what.find(one.name) == std::string::npos);
        }
      }
    }
    CHECK(known > 50);
  }

  TEST_CASE("FW-2 scan names the chips that an address may have, without an identity and without a driver") {
    const Registry registry = standard_registry();
    struct Case {
      unsigned address;
      std::uint8_t number;
      std::uint32_t value;  // of the registers from there on
      const char* what;
      std::size_t drivers;
    };
    for (const Case& one : {
             Case{0x76, 0xd0, 0x58, "BMP280", 1},
             {0x76, 0x00, 0x60, "BMP390", 1},
             {0x47, 0x01, 0x50, "BMP581", 1},
             {0x77, 0xd0, 0x00, "perhaps MS5611", 1},
             {0x69, 0x75, 0x71, "MPU-9250", 1},
             {0x69, 0x00, 0xea, "ICM-20948", 1},
             {0x68, 0x75, 0x00, "perhaps a clock (DS3231, DS1307)", 0},
             {0x6a, 0x0f, 0x6c, "LSM6DSO or LSM6DSOX", 2},
             {0x6b, 0x0f, 0x68, "LSM9DS1", 1},
             {0x1c, 0x0f, 0x3d, "LIS3MDL or LSM9DS1's magnetometer", 2},
             {0x1e, 0x0a, 0x483433, "HMC5883L", 1},
             {0x0d, 0x0d, 0xff, "perhaps QMC5883L", 1},
             {0x53, 0x00, 0xe5, "ADXL345 or ADXL375", 2},
             {0x29, 0x00, 0xa0, "BNO055", 1},
             {0x29, 0x00, 0x00, "perhaps VL53L0X, TSL2591", 0},
             {0x2a, 0x1f, 0x0f, "NAU7802", 1},
             {0x2a, 0x1f, 0xff, "perhaps NAU7802", 1},
             {0x23, 0x00, 0x00, "perhaps a port expander (PCF8574, MCP23017), BH1750", 0},
             {0x40, 0x00, 0x00, "perhaps INA219, HDC1080, PCA9685", 1},
             {0x40, 0xff, 0x2260, "INA226", 1},
             {0x45, 0x3f, 0x2281, "INA228", 1},
             {0x41, 0xff, 0x3220, "INA3221", 1},
             {0x19, 0x0f, 0x33, "LIS3DH", 1},
             {0x62, 0x00, 0x00, "perhaps SCD40, SCD41", 1},
             {0x77, 0xd0, 0x61, "BME680, BME688", 1},
             {0x44, 0x00, 0x00, "perhaps SHT3x, SHT4x, INA219", 3},
             {0x48, 0x00, 0x00, "perhaps LM75, TMP75, ADS1115, ADS1015, TMP102", 2},
             {0x4f, 0x00, 0x00, "perhaps LM75, TMP75", 1},
             {0x50, 0x00, 0x00, "perhaps an EEPROM (24Cxx)", 0},
             {0x12, 0x00, 0x00, "a chip that is not known here", 0},
         }) {
      CAPTURE(one.address);
      const auto wires = std::make_shared<FakeI2c>();
      put_code(wires->chip(one.address), one.number, one.value, one.value > 0xffff ? 3 : one.value > 0xff ? 2 : 1);
      const I2cBus bus("i2c1", wires);
      I2cDevice device = bus.device({one.address});
      const LikelyChip likely = likely_chip(device, registry);
      CHECK(likely.what == one.what);
      CHECK(likely.drivers.size() == one.drivers);
    }
  }

  TEST_CASE("FW-2 scan of a machine that has nothing says what to switch on") {
    const Machine empty;
    const Scan scan = scan_machine(empty.files(), standard_registry(), Probing::yes);
    CHECK(scan.devices.empty());
    REQUIRE(scan.hints.size() == 3);
    CHECK(scan.hints[0].kind == "i2c");
    CHECK(scan.hints[1].kind == "spi");
    CHECK(scan.hints[2].kind == "1-wire");
    CHECK(scan.hints[2].text.find("dtoverlay=w1-gpio") != std::string::npos);
  }

  TEST_CASE("NFR-5 a device that is not there says how it is switched on, and scan and doctor say the same") {
    const Machine empty;
    const Scan scan = scan_machine(empty.files(), standard_registry(), Probing::no);
    const I2cBus i2c({.device = "/dev/i2c-77"});
    I2cDevice chip = i2c.device({0x48});
    std::array<std::uint8_t, 1> byte{};
    const Result<void> answered = chip.read(byte);
    REQUIRE_FALSE(answered);
    const std::string advice = rtdata::detail::how_to_enable("/dev/i2c-77");
    CHECK(advice.find("raspi-config nonint do_i2c 0") != std::string::npos);
    CHECK(advice.find("dtparam=i2c_arm=on") != std::string::npos);
    CHECK(advice.find("modprobe i2c-dev") != std::string::npos);
    CHECK(answered.error().advice == advice);
    CHECK(scan.hints[0].text == "no I2C adapter: " + advice);
    CHECK(access_to(empty.files(), "/dev/i2c-77", R_OK).advice == advice);
    CHECK(scan.hints[1].text == "no SPI controller: " + rtdata::detail::how_to_enable("/dev/spidev0.0"));
    CHECK(rtdata::detail::how_to_enable("/dev/serial0").find("do_serial_hw 0") != std::string::npos);
    CHECK(rtdata::detail::how_to_enable("/dev/ttyUSB0").empty());  // what is plugged in is not switched on
    CHECK(access_to(empty.files(), "/dev/ttyUSB0", R_OK).advice.find("plug it in") == 0);
  }

  TEST_CASE("FW-2 scan says what stands in the way: the kernel's console, a driver that is missing") {
    const Machine board;
    board.file("/sys/class/tty/ttyAMA0/type", "1\n");
    board.file("/dev/ttyAMA0");
    board.file("/proc/cmdline", "console=ttyAMA0,115200 root=/dev/mmcblk0p2\n");
    board.file("/sys/bus/w1/devices/28-0000075565ad/rw", "");
    board.file("/sys/bus/w1/devices/29-0000000000aa/rw", "");
    board.file("/sys/class/spi_master/spi0/uevent", "");
    board.file("/sys/bus/gpio/devices/gpiochip0/gpio/gpiochip512/label", "pinctrl\x1b[31m\n");
    board.file("/sys/bus/gpio/devices/gpiochip0/gpio/gpiochip512/ngpio", "54\n");
    board.file("/dev/gpiochip0");
    const Scan scan = scan_machine(board.files(), standard_registry(), Probing::no);
    const FoundDevice* port = find(scan, "/dev/ttyAMA0");
    REQUIRE(port != nullptr);
    CHECK(port->obstacle.find("the kernel writes its messages to it") == 0);
    CHECK(port->advice.find("raspi-config") != std::string::npos);
    const FoundDevice* thermometer = find(scan, "/sys/bus/w1/devices/28-0000075565ad");
    REQUIRE(thermometer != nullptr);
    CHECK(thermometer->advice.find("sudo modprobe w1_therm") == 0);
    CHECK(find(scan, "/sys/bus/w1/devices/29-0000000000aa", "family 29")->obstacle.empty());
    const FoundDevice* chip = find(scan, "/dev/gpiochip0");
    REQUIRE(chip != nullptr);
    CHECK(chip->what == "pinctrl?[31m, 54 lines");  // nothing that commands a terminal
    CHECK(scan.hints[1].text.find("sudo modprobe spidev") != std::string::npos);
    CHECK(printable("a\xc2\x9b"
                    "b\x7f\xc3\xa9") == "a?b?\xc3\xa9");
  }

  TEST_CASE("FW-2 init writes what scan finds, and names the rest; also of files that hold anything") {
    const Registry registry = standard_registry();
    const Machine board;
    board.file("/sys/bus/w1/devices/28-0000075565ad/temperature", "21500\n");
    board.file("/sys/bus/iio/devices/iio:device0/in_voltage0_raw", "1\n");
    board.file("/sys/bus/i2c/devices/i2c-1/name", "bcm\n2835\n");
    board.file("/dev/i2c-1");
    board.link("/dev/serial/by-id/usb\n\"x\"", "../../ttyUSB0");
    board.file("/dev/ttyUSB0");
    const std::string text = starter_file(registry, "first.json", board.root);
    CAPTURE(text);
    CHECK(text.find(R"("type": "w1", "rate": "0.5 Hz", "device": "28-0000075565ad")") != std::string::npos);
    CHECK(text.find("in_voltage0_raw") != std::string::npos);
    CHECK(text.find("\n//   i2c: /dev/i2c-1, bcm?2835\n") != std::string::npos);
    CHECK(text.find("\n//   serial: /dev/serial/by-id/usb?\"x\", ttyUSB0\n") != std::string::npos);
    CHECK(plan_system(registry, parse_config(text)).good());
  }

  TEST_CASE("FW-2 FW-3 scan, doctor and init take any machine: files that are missing, huge, binary, folders, pipes") {
    const Registry registry = standard_registry();
    for (unsigned seed = 0; seed < 40; ++seed) {
      CAPTURE(seed);
      std::mt19937 random(seed);
      const Machine machine;
      for (const char* path : files_of_a_machine) {
        const auto at = std::filesystem::path(machine.root + path);
        std::error_code taken;  // by a file that stands where a folder should
        std::filesystem::create_directories(at.parent_path(), taken);
        std::string bytes(random() % 300, '\0');
        for (char& byte : bytes) byte = static_cast<char>(random() & 0xff);
        switch (random() % 10) {
          case 0:
            break;
          case 1:
            std::ofstream(at, std::ios::binary) << std::string(300'000, 'x');
            break;
          case 2:
            std::filesystem::create_directories(at / bytes.substr(0, 0) / "name", taken);
            break;
          case 3:
            ::mkfifo(at.c_str(), 0600);
            break;
          case 4:
            std::filesystem::create_symlink(at.filename(), at, taken);  // to itself
            break;
          case 5:
            std::filesystem::create_symlink("/nowhere/" + std::string(200, 'a'), at, taken);
            break;
          case 6:
            std::ofstream(at, std::ios::binary) << "99999999999999999999999\n-1\n";
            break;
          case 7:
            std::ofstream(at, std::ios::binary) << "a b c d\n: : :\n\x1b[2J\n/ / / ro\n";
            break;
          case 8:
            std::ofstream(at, std::ios::binary) << "1\n";
            std::filesystem::permissions(at, std::filesystem::perms::none, taken);
            break;
          default:
            std::ofstream(at, std::ios::binary) << bytes;
            break;
        }
      }
      const Scan scan = scan_machine(machine.files(), registry, Probing::yes);  // a copy is not probed
      for (const FoundDevice& device : scan.devices) CHECK_FALSE(device.kind.empty());
      for (const std::vector<Finding>& findings :
           {examine_timing(machine.files(), nullptr), examine_clock(machine.files()),
            examine_disks(machine.files(), nullptr), examine_groups(machine.files())}) {
        for (const Finding& finding : findings) {
          CHECK_FALSE(finding.subject.empty());
          CHECK_FALSE(finding.what.empty());
          if (finding.severity >= Severity::warning) CHECK(finding.cost.size() + finding.advice.size() > 0);
        }
      }
      const std::string starter = starter_file(registry, "first.json", machine.root);
      const SystemPlan plan = plan_system(registry, parse_config(starter));
      INFO(starter << plan.report());
      CHECK(plan.good());
      if (seed % 8 != 0) continue;
      for (const char* command : {"scan", "doctor"}) {
        Process json(machine.folder, shipped, {command, "--root", machine.root, "--json"});
        CHECK(json.end() != 1);
        CHECK(nlohmann::json::accept(json.out));
        Process text(machine.folder, shipped, {command, "--root", machine.root});
        CHECK(text.end() != 1);
        CHECK(text.out.find('\x1b') == std::string::npos);
      }
    }
  }

  TEST_CASE("FW-2 scan and doctor wait for no pipe, in whatever file's place one stands") {
    const Machine machine;
    for (const char* path : files_of_a_machine) {
      const auto at = std::filesystem::path(machine.root + path);
      std::filesystem::create_directories(at.parent_path());
      CHECK(::mkfifo(at.c_str(), 0600) == 0);
    }
    for (const char* command : {"scan", "doctor"}) {
      Process run(machine.folder, shipped, {command, "--root", machine.root, "--json"});
      CHECK(run.end() != 1);
      CHECK(nlohmann::json::accept(run.out));
    }
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
    // Kernels that do not show the firmware's state have an alarm of the supply.
    std::filesystem::remove(board.root + "/sys/devices/platform/soc/soc:firmware/get_throttled");
    CHECK(find(examine_timing(board.files(), nullptr), "power") == nullptr);
    board.file("/sys/class/hwmon/hwmon1/name", "rpi_volt\n");
    for (const auto& [alarm, severity] :
         {std::pair("1\n", Severity::warning), std::pair("0\n", Severity::good), std::pair("x\n", Severity::warning)}) {
      board.file("/sys/class/hwmon/hwmon1/in0_lcrit_alarm", alarm);
      CHECK(find(examine_timing(board.files(), nullptr), "power")->severity == severity);
    }
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

    // A sensor waits for its device; an output begins as failed, as `run` says, too, unless its device is required.
    CHECK(run.out.find("this part has no data until this is fixed") != std::string::npos);
    folder.write("valve.json", R"({"sensors": [{"name": "l", "type": "host", "quantity": "load", "rate": "1 Hz"}],
      "outputs": [{"name": "valve", "type": "serial", "device": "/dev/does-not-exist"}]})");
    Process valve(folder, shipped, {"doctor", "valve.json"});
    CHECK(valve.end() == 2);
    CHECK(valve.out.find("fault: output valve: /dev/does-not-exist: No such file or directory") == 0);
    CHECK(valve.out.find("the output begins as failed, and is tried each second") != std::string::npos);
    CHECK(valve.out.find("has no data") == std::string::npos);
    Process faulted(folder, shipped, {"run", "valve.json", "--for", "100ms"});
    CHECK(faulted.end() == 1);
    CHECK(faulted.err.find("output valve: cannot open the serial line") != std::string::npos);
    CHECK(faulted.out.find("NOT known to be safe: output valve") != std::string::npos);
    folder.write("required.json", R"({"sensors": [{"name": "l", "type": "host", "quantity": "load", "rate": "1 Hz"}],
      "outputs": [{"name": "valve", "type": "serial", "device": "/dev/does-not-exist", "required": true}]})");
    Process required(folder, shipped, {"doctor", "required.json"});
    CHECK(required.end() == 2);
    CHECK(required.out.find("the run does not start") != std::string::npos);
    Process refused(folder, shipped, {"run", "required.json", "--for", "100ms"});
    CHECK(refused.end() == 1);
    CHECK(refused.out.find("NOT known to be safe") == std::string::npos);

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
    Process wrong_json(folder, shipped, {"doctor", "--json", "wrong.json"});
    CHECK(wrong_json.end() == 2);
    const auto mistakes = nlohmann::json::parse(wrong_json.out);
    CHECK(mistakes["worst"] == "fault");
    REQUIRE(mistakes["findings"].size() == 1);
    CHECK(mistakes["findings"][0]["what"].get<std::string>().find("host") != std::string::npos);

    Process nowhere(folder, shipped, {"doctor", "--root", "nowhere"});
    CHECK(nowhere.end() == 1);
    CHECK(nowhere.err ==
          "rtdata: cannot read the copy of the machine: nowhere: No such file or directory [not-found]\n");
    for (const char* command : {"scan", "doctor"}) {
      Process file(folder, shipped, {command, "--root", "wrong.json"});
      CHECK(file.end() == 1);
      CHECK(file.err.find("wrong.json: Not a directory") != std::string::npos);
    }

    Process here(folder, shipped, {"doctor", "--json"});
    const int status = here.end();
    const auto json = nlohmann::json::parse(here.out);
    CHECK(status == (json["worst"] == "fault" ? 2 : json["worst"] == "warning" ? 3 : 0));
    CHECK(json["findings"].size() >= 6);
  }

  TEST_CASE("FW-3 doctor says which GPIO lines, PWM channels and processors of a configuration are not there") {
    const Machine board;
    const bool has_gpio = standard_registry().outputs().find("gpio").has_value();
    const std::string gpio = has_gpio ? R"({"name": "lamp", "type": "gpio", "line": "GPIO99"},)" : "";
    const SystemPlan plan = plan_system(standard_registry(), parse_config(R"({"tiers": {"fast": {"cpu": 77},
      "any": {}}, "sensors": [{"name": "l", "type": "host", "quantity": "load", "rate": "1 Hz"}], "outputs": [)" +
                                                                          gpio +
                                                                          R"(
      {"name": "fan", "type": "pwm"}, {"name": "heater", "type": "pwm", "chip": 2, "channel": 3}]})"));
    REQUIRE_MESSAGE(plan.good(), plan.report());
    board.file("/sys/class/pwm/pwmchip2/npwm", "2\n");
    board.file("/sys/devices/system/cpu/cpu0/online", "1\n");
    std::vector<Finding> found = examine_lines(board.files(), plan);
    REQUIRE(find(found, "output fan") != nullptr);
    CHECK(find(found, "output fan")->severity == Severity::fault);
    CHECK(find(found, "output fan")->what == "there is no PWM chip /sys/class/pwm/pwmchip0");
    REQUIRE(find(found, "output heater") != nullptr);
    CHECK(find(found, "output heater")->what == "/sys/class/pwm/pwmchip2 has 2 channels, counted from 0");
    REQUIRE((find(found, "output lamp") != nullptr) == has_gpio);
    if (has_gpio) CHECK(find(found, "output lamp")->what == "this machine has no GPIO chip");
    const std::vector<Finding> timing = examine_timing(board.files(), &plan);
    REQUIRE(find(timing, "tier fast") != nullptr);
    CHECK(find(timing, "tier fast")->severity == Severity::warning);
    CHECK(find(timing, "tier fast")->what.find("77") != std::string::npos);
    CHECK(find(timing, "tier any") == nullptr);

    board.file("/dev/gpiochip0");
    board.file("/sys/class/pwm/pwmchip0/npwm", "1\n");
    board.file("/sys/class/pwm/pwmchip0/export");
    board.file("/sys/class/pwm/pwmchip2/npwm", "4\n");
    board.file("/sys/class/pwm/pwmchip2/pwm3/duty_cycle", "0\n");
    board.file("/sys/devices/system/cpu/cpu77/online", "1\n");
    found = examine_lines(board.files(), plan);
    REQUIRE(found.size() == 2);  // which lines the chip of a copy has is not known
    CHECK(found[0].severity == Severity::good);
    CHECK(found[1].severity == Severity::good);
    CHECK(find(examine_timing(board.files(), &plan), "tier fast") == nullptr);
  }

  TEST_CASE("FW-3 doctor says which groups nobody is in, and that the kernel has a chip") {
    const Machine board;
    board.file("/etc/group", "root:x:0:\ndialout:x:20:pi\ni2c:x:994:\nspi:x:995:\nvideo:x:44:\n");
    const Finding groups = examine_groups(board.files()).at(0);
    CHECK(groups.severity == Severity::note);
    CHECK(groups.what == "no user is in: i2c,spi");
    CHECK(groups.advice.find("usermod -aG i2c,spi $USER") != std::string::npos);
    board.file("/etc/group", "i2c:x:994:pi\n");
    CHECK(examine_groups(board.files()).at(0).severity == Severity::good);

    board.file("/dev/i2c-1");
    board.file("/sys/bus/i2c/devices/1-0048/name", "lm75\n");
    board.link("/sys/bus/i2c/devices/1-0048/driver", "../../../bus/i2c/drivers/lm75");
    const SystemPlan plan = plan_system(standard_registry(), parse_config(R"({"buses": {"i2c1": {"type": "i2c",
      "device": "/dev/i2c-1"}}, "sensors": [{"name": "room", "type": "lm75", "bus": "i2c1", "rate": "1 Hz"},
      {"name": "hall", "type": "lm75", "bus": "i2c1", "address": "0x49", "rate": "1 Hz"}]})"));
    REQUIRE(plan.good());
    const std::vector<Finding> found = examine_devices(board.files(), plan);
    const Finding* room = find(found, "sensor room");
    REQUIRE(room != nullptr);
    CHECK(room->severity == Severity::fault);
    CHECK(room->what == "the kernel's driver lm75 has the chip at 0x48");
    CHECK(room->advice.find("echo 1-0048 | sudo tee /sys/bus/i2c/drivers/lm75/unbind") != std::string::npos);
    CHECK(find(found, "sensor hall") == nullptr);
    CHECK(find(found, "bus i2c1")->severity == Severity::good);
  }

  TEST_CASE("FW-3 doctor says what a configuration needs that is not switched on or installed: 1-Wire, gpsd") {
    const SystemPlan plan = plan_system(standard_registry(), parse_config(R"({"sensors": [
      {"name": "room", "type": "w1", "device": "28-0000075565ad", "rate": "0.5 Hz"},
      {"name": "where", "type": "gps"}, {"name": "far", "type": "gps", "host": "boat.local"}]})"));
    REQUIRE(plan.good());
    const Machine board;
    const auto doctor = [&](const char* subject) -> std::optional<Finding> {
      const std::vector<Finding> found = examine_devices(board.files(), plan);
      const Finding* one = find(found, subject);
      return one != nullptr ? std::optional(*one) : std::nullopt;
    };
    REQUIRE(doctor("sensor room"));
    CHECK(doctor("sensor room")->severity == Severity::fault);
    CHECK(doctor("sensor room")->what == "there is no 1-Wire bus (/sys/bus/w1)");
    CHECK(doctor("sensor room")->advice.find("dtoverlay=w1-gpio") != std::string::npos);
    REQUIRE(doctor("sensor where"));
    CHECK(doctor("sensor where")->severity == Severity::warning);
    CHECK(doctor("sensor where")->what == "no gpsd is installed");
    CHECK(doctor("sensor where")->advice.find("sudo apt install gpsd") != std::string::npos);
    CHECK_FALSE(doctor("sensor far"));  // another machine's gpsd

    const Scan scan = scan_machine(board.files(), standard_registry(), Probing::no);
    CHECK(scan.hints.back().text == "no 1-Wire bus: " + doctor("sensor room")->advice);

    board.file("/sys/bus/w1/devices/28-0000000000bb/rw");
    CHECK(doctor("sensor room")->what == "28-0000075565ad is not on the 1-Wire bus");
    board.file("/sys/bus/w1/devices/28-0000075565ad/rw");
    CHECK(doctor("sensor room")->what == "28-0000075565ad has no driver");
    CHECK(doctor("sensor room")->advice.find("sudo modprobe w1_therm") == 0);
    board.file("/sys/bus/w1/devices/28-0000075565ad/w1_slave");
    CHECK(doctor("sensor room")->severity == Severity::good);
    board.file("/usr/sbin/gpsd");
    CHECK_FALSE(doctor("sensor where"));
  }

  TEST_CASE("FW-3 doctor says that a file stands where a device should be") {
    const Folder folder;
    const std::string path = "/dev/rtdata-test-" + std::to_string(::getpid());
    std::ofstream(path) << "x";
    if (!std::filesystem::exists(path)) {
      MESSAGE("skipped: this user may not write in /dev");
      return;
    }
    folder.write("bench.json", R"({"sensors": [{"name": "board", "type": "serial", "device": ")" + path +
                                   R"(", "fields": [{"name": "x"}]}]})");
    Process run(folder, shipped, {"doctor", "bench.json"});
    CHECK(run.end() == 2);
    CHECK(run.out.find("fault: sensor board: " + path + " is not a device but a file or folder") == 0);
    std::filesystem::remove(path);
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
