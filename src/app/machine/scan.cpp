#include "app/machine/scan.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <string_view>
#include <utility>

#include "rtdata/config/system.hpp"
#include "rtdata/data/config_item.hpp"

namespace rtdata::app {
namespace {

std::string json_text(const std::string& text) { return ConfigItem::of(text).to_json(ConfigItem::Layout::one_line); }

class Scanner {
 public:
  Scanner(const MachineFiles& files, const Registry& registry, Probing probing)
      : files_(files), registry_(registry), probing_(probing) {}

  Scan all() {
    serial_ports();
    i2c_adapters();
    spi_devices();
    gpio_chips();
    iio_devices();
    hwmon_chips();
    one_wire();
    of_class("pps", "/sys/class/pps", "pulse per second");
    of_class("pwm", "/sys/class/pwm", "PWM controller");
    gpsd();
    return std::move(scan_);
  }

 private:
  FoundDevice& add(std::string kind, std::string path, std::string what, int mode = R_OK | W_OK) {
    scan_.devices.push_back({std::move(kind), std::move(path), std::move(what)});
    FoundDevice& device = scan_.devices.back();
    const Access access = access_to(files_, device.path, mode);
    if (!access.is_granted) {
      device.obstacle = access.why;
      device.advice = access.advice;
    }
    return device;
  }
  void hint(std::string kind, std::string text) { scan_.hints.push_back({std::move(kind), std::move(text)}); }

  /// A line that this program takes; one of a type that it lacks is left out. `bus`: the item that it is on.
  void line(FoundDevice& device, const char* list, const std::string& text, const std::string& bus = {}) const {
    std::string document;
    if (std::string_view(list) == "buses") {
      document = "{\"buses\": {" + text + "}}";
    } else {
      document = "{\"buses\": {" + bus + "}, \"" + list + "\": [" + text + "]}";
    }
    if (plan_system(registry_, parse_config(document)).good()) device.lines.push_back({list, text});
  }

  std::string text(const std::string& file) const { return files_.text(file).value_or(""); }

  static std::string joined(std::initializer_list<std::string> words) {
    std::string all;
    for (const std::string& word : words)
      if (!word.empty()) all += (all.empty() ? "" : " ") + word;
    return all;
  }

  void serial_port(const std::string& path, const std::string& tty) {
    // The folder of the USB device lies above those of its interface and of the port.
    const std::string device = "/sys/class/tty/" + tty + "/device/";
    std::string what;
    for (const char* up : {"../", "../../"}) {
      what = joined({text(device + up + "manufacturer"), text(device + up + "product")});
      if (!what.empty()) break;
    }
    FoundDevice& found = add("serial", path, tty + (what.empty() ? "" : ", " + what));
    line(found, "sensors",
         R"({"name": )" + json_text(tty) + R"(, "type": "serial", "device": )" + json_text(path) +
             R"(, "baud_rate": 9600, "fields": [{"name": "value"}]})");
  }

  void serial_ports() {
    std::vector<std::string> named;
    for (const std::string& id : files_.names("/dev/serial/by-id")) {
      const std::string tty = files_.link_name("/dev/serial/by-id/" + id);
      if (tty.empty()) continue;
      named.push_back(tty);
      serial_port("/dev/serial/by-id/" + id, tty);
    }
    for (const char* prefix : {"ttyUSB", "ttyACM", "ttyAMA", "ttyS", "ttymxc", "ttyTHS", "ttySC", "ttyO"}) {
      for (const std::string& tty : files_.names("/sys/class/tty", prefix)) {
        if (!files_.exists("/dev/" + tty)) continue;
        bool is_known = false;
        for (const std::string& one : named) is_known = is_known || one == tty;
        // PCs have ports ttyS0 to ttyS31 of which most are not there: their type is 0.
        if (is_known || text("/sys/class/tty/" + tty + "/type") == "0") continue;
        serial_port("/dev/" + tty, tty);
      }
    }
  }

  void i2c_adapters() {
    const std::vector<std::string> adapters = files_.names("/sys/bus/i2c/devices", "i2c-");
    if (adapters.empty())
      hint("i2c", "no I2C adapter: on a Raspberry Pi `sudo raspi-config nonint do_i2c 0`, then start it again");
    for (const std::string& adapter : adapters) {
      const std::string number = adapter.substr(4);
      FoundDevice& found = add("i2c", "/dev/" + adapter, text("/sys/bus/i2c/devices/" + adapter + "/name"));
      if (!files_.exists(found.path))
        found.advice = "sudo modprobe i2c-dev; for good: a line `i2c-dev` in /etc/modules";
      const std::string bus = json_text("i2c" + number) + R"(: {"type": "i2c", "device": )" + json_text(found.path) +
                              "}";
      line(found, "buses", bus);
      const bool is_open = found.obstacle.empty();
      for (const std::string& chip : files_.names("/sys/bus/i2c/devices", number + "-")) {
        const std::string folder = "/sys/bus/i2c/devices/" + chip;
        const std::string driver = files_.link_name(folder + "/driver");
        const unsigned long address = std::strtoul(chip.c_str() + chip.rfind('-') + 1, nullptr, 16);
        scan_.devices.push_back({"i2c", "/dev/" + adapter,
                                 "address " + to_text(address) + ": " + text(folder + "/name") +
                                     (driver.empty() ? ", known to the kernel, without a driver"
                                                     : ", used by the kernel's driver " + driver)});
      }
      if (probing_ == Probing::no || !is_open || !files_.is_this_machine()) continue;
      const std::size_t first = scan_.devices.size();
      probe_i2c(files_, adapter, scan_.devices);
      for (std::size_t i = first; i < scan_.devices.size(); ++i) chip_lines(scan_.devices[i], "i2c" + number, bus);
    }
    if (probing_ == Probing::no && !adapters.empty() && files_.is_this_machine())
      hint("i2c", "which chips answer: rtdata scan --probe (reads a byte from every free address)");
  }

  static std::string to_text(unsigned long address) {
    constexpr std::string_view digits = "0123456789abcdef";
    return {'0', 'x', digits[address >> 4 & 15], digits[address & 15]};
  }

  /// The driver of a chip that has said what it is: of "address 0x76: BMP280".
  void chip_lines(FoundDevice& chip, const std::string& bus_name, const std::string& bus) const {
    struct Driven {
      std::string_view chip, type, members;
    };
    constexpr Driven known[] = {{"BMP280", "barometer", R"(, "model": "bmp280")"},
                                {"BME280", "barometer", R"(, "model": "bme280")"},
                                {"BMP388", "barometer", R"(, "model": "bmp388")"},
                                {"BMP390", "barometer", R"(, "model": "bmp390")"},
                                {"MPU-6050", "imu", R"(, "model": "mpu6050")"},
                                {"MPU-6500", "imu", R"(, "model": "mpu6500")"},
                                {"MPU-9250", "imu", R"(, "model": "mpu9250")"},
                                {"LSM6DSO or LSM6DSOX", "imu", R"(, "model": "lsm6dso")"},
                                {"LSM6DS3", "imu", R"(, "model": "lsm6ds3")"},
                                {"LSM6DS3TR-C", "imu", R"(, "model": "lsm6ds3trc")"},
                                {"LSM9DS1, accelerometer and gyroscope", "imu", R"(, "model": "lsm9ds1")"},
                                {"ADXL345 or ADXL375", "accelerometer", R"(, "model": "adxl345")"},
                                {"BNO055", "bno055", ""}};
    const std::size_t at = chip.what.find(": ");
    if (at == std::string::npos) return;
    const std::string address = chip.what.substr(8, at - 8);
    for (const Driven& one : known) {
      if (chip.what.substr(at + 2) != one.chip) continue;
      const std::string type(one.type);
      line(chip, "sensors",
           R"({"name": )" + json_text(type) + R"(, "type": )" + json_text(type) + R"(, "bus": )" + json_text(bus_name) +
               R"(, "address": )" + json_text(address) + std::string(one.members) + R"(, "rate": "10 Hz"})",
           bus);
    }
  }

  void spi_devices() {
    const std::vector<std::string> devices = files_.names("/dev", "spidev");
    std::string controller;
    for (const std::string& device : devices) {
      FoundDevice& found = add("spi", "/dev/" + device, "bus and chip select " + device.substr(6));
      const std::string its = device.substr(0, device.find('.'));
      if (its == std::exchange(controller, its)) continue;  // one line for all chip selects of a controller
      line(found, "buses",
           json_text("spi" + its.substr(6)) + R"(: {"type": "spi", "device": )" + json_text("/dev/" + its) + "}");
    }
    if (devices.empty()) {
      hint("spi", files_.names("/sys/class/spi_master").empty()
                      ? "no SPI controller: on a Raspberry Pi `sudo raspi-config nonint do_spi 0`, then start it again"
                      : "there is a controller and no spidev on it: a device tree overlay gives it one");
    }
  }

  void gpio_chips() {
    for (const std::string& chip : files_.names("/sys/bus/gpio/devices", "gpiochip")) {
      const std::string of = "/sys/bus/gpio/devices/" + chip + "/of_node/name";
      const std::string device = files_.link_name("/sys/bus/gpio/devices/" + chip + "/device");
      std::string label, lines;
      // The classes of the old interface know label and size; they are read, never written.
      for (const std::string& old : files_.names("/sys/bus/gpio/devices/" + chip + "/gpio", "gpiochip")) {
        const std::string folder = "/sys/bus/gpio/devices/" + chip + "/gpio/" + old;
        label = text(folder + "/label");
        lines = text(folder + "/ngpio");
      }
      std::string what = label.empty() ? text(of) : label;
      if (!lines.empty()) what += (what.empty() ? "" : ", ") + lines + " lines";
      add("gpio", "/dev/" + chip, what);
    }
  }

  void iio_devices() {
    for (const std::string& device : files_.names("/sys/bus/iio/devices", "iio:device")) {
      const std::string folder = "/sys/bus/iio/devices/" + device;
      std::vector<std::string> channels;
      for (const std::string& file : files_.names(folder, "in_"))
        if (file.ends_with("_raw") || file.ends_with("_input")) channels.push_back(file);
      FoundDevice& found = add("iio", folder,
                               text(folder + "/name") + ", " + std::to_string(channels.size()) + " channels", R_OK);
      std::size_t count = 0;
      for (const std::string& channel : channels) {
        if (!channel.starts_with("in_voltage") || !channel.ends_with("_raw")) continue;
        line(found, "sensors",
             R"({"name": "adc)" + std::to_string(adc_count_ + count++) +
                 R"(", "type": "analog", "rate": "10 Hz", "file": )" + json_text(folder + "/" + channel) +
                 R"(, "scale": 3.3, "unit": "V"})");
      }
      adc_count_ += count;
    }
  }

  void hwmon_chips() {
    for (const std::string& chip : files_.names("/sys/class/hwmon", "hwmon")) {
      const std::string folder = "/sys/class/hwmon/" + chip;
      std::vector<std::string> inputs;
      for (const std::string& file : files_.names(folder))
        if (file.ends_with("_input")) inputs.push_back(file);
      if (inputs.empty()) continue;
      FoundDevice& found = add("hwmon", folder,
                               text(folder + "/name") + ", " + std::to_string(inputs.size()) + " values", R_OK);
      for (const std::string& input : inputs) {
        if (!input.starts_with("temp")) continue;
        const std::string which = chip + "/" + input.substr(0, input.find('_'));
        line(found, "sensors",
             R"({"name": )" + json_text(which) + R"(, "type": "host", "quantity": "temperature", "device": )" +
                 json_text(which) + R"(, "rate": "1 Hz"})");
      }
    }
  }

  void one_wire() {
    for (const std::string& device : files_.names("/sys/bus/w1/devices")) {
      if (device.starts_with("w1_bus_master")) continue;
      const std::string folder = "/sys/bus/w1/devices/" + device;
      const bool is_thermometer = files_.exists(folder + "/temperature");
      FoundDevice& found = add("1-wire", folder,
                               device.starts_with("28-")   ? "DS18B20"
                               : device.starts_with("10-") ? "DS18S20"
                               : is_thermometer            ? "a thermometer"
                                                           : "family " + device.substr(0, 2),
                               R_OK);
      if (is_thermometer)
        line(
            found, "sensors",
            R"({"name": )" + json_text(device) + R"(, "type": "analog", "rate": "0.5 Hz", "file": )" +
                json_text(folder + "/temperature") +  // in thousandths of a degree
                R"(, "signed_adc": true, "quantization_bits": 20, "scale": 1048.576, "unit": "Cel", "timeout": "2 s"})");
    }
  }

  void of_class(const char* kind, const std::string& folder, const char* what) {
    for (const std::string& name : files_.names(folder)) {
      const std::string known = text(folder + "/" + name + "/name");
      const std::string device = "/dev/" + name;
      add(kind, files_.exists(device) ? device : folder + "/" + name, known.empty() ? what : known, R_OK);
    }
  }

  void gpsd() {
    if (!files_.is_this_machine()) return;
    const int fd = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (fd < 0) return;
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(2947);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    int status = ::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address);
    if (status != 0 && errno == EINPROGRESS) {
      pollfd wait{fd, POLLOUT, 0};
      socklen_t size = sizeof status;
      if (::poll(&wait, 1, 500) != 1 || ::getsockopt(fd, SOL_SOCKET, SO_ERROR, &status, &size) != 0) status = -1;
    }
    ::close(fd);
    if (status != 0) return;
    scan_.devices.push_back({"gpsd", "localhost:2947", "a GPS service"});
    line(scan_.devices.back(), "sensors", R"({"name": "gps", "type": "gps"})");
  }

  const MachineFiles& files_;
  const Registry& registry_;
  const Probing probing_;
  Scan scan_;
  std::size_t adc_count_ = 0;
};

}  // namespace

Scan scan_machine(const MachineFiles& files, const Registry& registry, Probing probing) {
  return Scanner(files, registry, probing).all();
}

}  // namespace rtdata::app
