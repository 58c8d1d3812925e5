// I2C adapters, and the probable chip at an address, from the address and the chip's identity, if it has one.
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <optional>
#include <span>
#include <string_view>

#include "app/machine/scanner.hpp"
#include "io/enabling.hpp"
#include "rtdata/io/i2c.hpp"

namespace rtdata::app {
namespace {

/// A sensor type that reads the chip; types that this program lacks are left out.
struct Driven {
  std::string_view type, members = "";  ///< in JSON
};

/// Chips with an identity in a register, from their data sheets.
struct Identity {
  std::array<std::uint8_t, 2> addresses;
  std::uint8_t register_number, value;
  std::string_view chip;
  std::array<Driven, 2> drivers = {};
};
constexpr Identity identities[] = {
    {{0x76, 0x77}, 0xd0, 0x58, "BMP280", {{{"barometer", R"("model": "bmp280")"}}}},
    {{0x76, 0x77}, 0xd0, 0x60, "BME280", {{{"barometer", R"("model": "bme280")"}}}},
    {{0x76, 0x77}, 0x00, 0x50, "BMP388", {{{"barometer", R"("model": "bmp388")"}}}},
    {{0x76, 0x77}, 0x00, 0x60, "BMP390", {{{"barometer", R"("model": "bmp390")"}}}},
    {{0x68, 0x69}, 0x75, 0x68, "MPU-6050", {{{"imu", R"("model": "mpu6050")"}}}},
    {{0x68, 0x69}, 0x75, 0x70, "MPU-6500", {{{"imu", R"("model": "mpu6500")"}}}},
    {{0x68, 0x69}, 0x75, 0x71, "MPU-9250", {{{"imu", R"("model": "mpu9250")"}}}},
    {{0x6a, 0x6b}, 0x0f, 0x6c, "LSM6DSO or LSM6DSOX", {{{"imu", R"("model": "lsm6dso")"}}}},
    {{0x6a, 0x6b}, 0x0f, 0x69, "LSM6DS3", {{{"imu", R"("model": "lsm6ds3")"}}}},
    {{0x6a, 0x6b}, 0x0f, 0x6a, "LSM6DS3TR-C", {{{"imu", R"("model": "lsm6ds3trc")"}}}},
    {{0x6a, 0x6b}, 0x0f, 0x68, "LSM9DS1, accelerometer and gyroscope", {{{"imu", R"("model": "lsm9ds1")"}}}},
    {{0x1c, 0x1e},
     0x0f,
     0x3d,
     "LIS3MDL, or the magnetometer of an LSM9DS1",
     {{{"magnetometer", R"("model": "lis3mdl")"}, {"magnetometer", R"("model": "lsm9ds1")"}}}},
    {{0x1e, 0x1e}, 0x0a, 0x48, "HMC5883L", {{{"magnetometer", R"("model": "hmc5883l")"}}}},
    {{0x0c, 0x0c}, 0x00, 0x48, "AK8963", {{{"magnetometer", R"("model": "ak8963")"}}}},
    {{0x1d, 0x53}, 0x00, 0xe5, "ADXL345 or ADXL375", {{{"accelerometer", R"("model": "adxl345")"}}}},
    {{0x28, 0x29}, 0x00, 0xa0, "BNO055", {{{"bno055"}}}},
};

/// Common chips without an identity, by address.
struct Usual {
  std::uint8_t first, last;
  std::string_view chips;
  std::array<Driven, 3> drivers = {};
};
constexpr Usual usual[] = {
    {0x0d, 0x0d, "QMC5883L", {{{"magnetometer", R"("model": "qmc5883l")"}}}},
    {0x20, 0x22, "a port expander (PCF8574, MCP23017)"},
    {0x23, 0x23, "BH1750, or a port expander", {{{"bh1750"}}}},
    {0x24, 0x27, "a port expander (PCF8574, MCP23017), or a display behind one"},
    {0x29, 0x29, "VL53L0X, TSL2591"},
    {0x2a, 0x2a, "NAU7802", {{{"nau7802"}}}},
    {0x38, 0x38, "AHT20, or a PCF8574A"},
    {0x3c, 0x3d, "a display (SSD1306)"},
    {0x40,
     0x43,
     "INA219, INA226, HDC1080, PCA9685",
     {{{"ina", R"("model": "ina219")"}, {"ina", R"("model": "ina226")"}}}},
    {0x44, 0x45, "SHT3x, SHT4x, INA219", {{{"sht", R"("model": "sht3x")"}, {"sht", R"("model": "sht4x")"}}}},
    {0x46, 0x47, "INA219, INA226", {{{"ina", R"("model": "ina219")"}, {"ina", R"("model": "ina226")"}}}},
    {0x48, 0x4b, "ADS1115, ADS1015, LM75, TMP102", {{{"lm75"}, {"ads1x15"}}}},
    {0x4c, 0x4f, "LM75, TMP75", {{{"lm75"}}}},
    {0x50, 0x57, "an EEPROM (24Cxx)"},
    {0x5c, 0x5c, "BH1750, LPS25H", {{{"bh1750"}}}},
    {0x60, 0x60, "MCP4725, MPL3115A2"},
    {0x68, 0x69, "a clock (DS3231, DS1307), MPU-6050"},
    {0x70, 0x71, "a multiplexer (TCA9548A)"},
    {0x76, 0x77, "MS5611", {{{"barometer", R"("model": "ms5611")"}}}},
};

/// The probable chip at an address.
struct Likely {
  std::string what;
  std::span<const Driven> drivers;
};

Likely likely_chip(I2cDevice& chip) {
  const unsigned address = chip.address().number;
  for (const Identity& known : identities) {
    if (std::find(known.addresses.begin(), known.addresses.end(), address) == known.addresses.end()) continue;
    const Result<std::uint8_t> found = chip.read_register(known.register_number);
    if (found && *found == known.value) return {std::string(known.chip), known.drivers};
  }
  for (const Usual& known : usual)
    if (known.first <= address && address <= known.last) return {"perhaps " + std::string(known.chips), known.drivers};
  return {"a chip that is not known here", {}};
}

/// Adds the chips that answer. Addresses with a kernel driver are in the list already, and are not probed.
void probe(Scanner& scanner, const std::string& adapter, const std::string& bus_name, const std::string& bus_line) {
  const std::string path = "/dev/" + adapter;
  const I2cBus bus({.device = scanner.files.path(path)});
  unsigned timeouts = 0;
  for (unsigned address = I2cAddress::first; address <= I2cAddress::last; ++address) {
    if (scanner.files.exists("/sys/bus/i2c/devices/" + adapter.substr(4) + "-00" +
                             to_string(I2cAddress(address)).substr(2)))
      continue;
    I2cDevice chip = bus.device({address});
    std::array<std::uint8_t, 1> byte{};
    if (const Result<void> answered = chip.read(byte); !answered) {
      if (answered.error().code == Errc::disconnected) continue;
      // If a line of the bus is stuck, every address takes the adapter's timeout.
      if (answered.error().code == Errc::timed_out && ++timeouts < 3) continue;
      scanner.add({"i2c", path, "cannot be probed", answered.error().why,
                   "check its wires and pull-up resistors: SDA and SCL are high on a bus at rest"});
      return;
    }
    const std::string text = to_string(I2cAddress(address));
    const Likely likely = likely_chip(chip);
    scanner.add({"i2c", path, "address " + text + ": " + likely.what});
    for (const Driven& one : likely.drivers) {
      if (one.type.empty()) continue;
      const std::string type(one.type), members(one.members);
      scanner.sensor(scanner.scan.devices.back(), type, type,
                     R"("bus": )" + json_text(bus_name) + R"(, "address": )" + json_text(text) +
                         (members.empty() ? "" : ", ") + members + R"(, "rate": "1 Hz")",
                     bus_line);
    }
  }
}

void i2c_adapter(Scanner& scanner, const std::string& adapter) {
  const std::string number = adapter.substr(4), path = "/dev/" + adapter;
  FoundDevice& found = scanner.add("i2c", path, scanner.text("/sys/bus/i2c/devices/" + adapter + "/name"), R_OK | W_OK);
  const bool is_open = found.obstacle.empty();
  if (!scanner.files.exists(path)) found.advice = "sudo modprobe i2c-dev; for good: a line `i2c-dev` in /etc/modules";
  const std::string bus = json_text("i2c" + number) + R"(: {"type": "i2c", "device": )" + json_text(path) + "}";
  scanner.line(found, "buses", bus);
  for (const std::string& chip : scanner.files.names("/sys/bus/i2c/devices", number + "-")) {
    const std::string folder = "/sys/bus/i2c/devices/" + chip;
    const std::string driver = scanner.files.link_name(folder + "/driver");
    const auto address = static_cast<unsigned>(std::strtoul(chip.c_str() + chip.rfind('-') + 1, nullptr, 16));
    scanner.add(
        {"i2c", path,
         "address " + to_string(I2cAddress(address)) + ": " + scanner.text(folder + "/name") +
             (driver.empty() ? ", known to the kernel, without a driver" : ", used by the kernel's driver " + driver)});
  }
  if (scanner.probing == Probing::yes && is_open && scanner.files.is_this_machine())
    probe(scanner, adapter, "i2c" + number, bus);
}

}  // namespace

void scan_i2c(Scanner& scanner) {
  std::size_t count = 0;
  for (const std::string& adapter : scanner.files.names("/sys/bus/i2c/devices", "i2c-")) {
    if (adapter.size() < 5 || adapter.find_first_not_of("0123456789", 4) != std::string::npos) continue;
    ++count;
    i2c_adapter(scanner, adapter);
  }
  if (count == 0) scanner.hint("i2c", "no I2C adapter: " + detail::how_to_enable("/dev/i2c-"));
  if (count > 0 && scanner.probing == Probing::no && scanner.files.is_this_machine())
    scanner.hint("i2c", "which chips answer: rtdata scan --probe (reads a byte from every free address)");
}

}  // namespace rtdata::app
