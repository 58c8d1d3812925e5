// Which chip is likely at an address of an I2C bus, by its address and, where it has one, its identity.
#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>

#include "app/machine/scan.hpp"
#include "rtdata/io/i2c.hpp"

namespace rtdata::app {
namespace {

/// Chips with an identity in a register, from their data sheets.
struct Identity {
  std::array<std::uint8_t, 2> addresses;
  std::uint8_t register_number, value;
  std::string_view chip;
};
constexpr Identity identities[] = {
    {{0x76, 0x77}, 0xd0, 0x58, "BMP280"},
    {{0x76, 0x77}, 0xd0, 0x60, "BME280"},
    {{0x76, 0x77}, 0x00, 0x50, "BMP388"},
    {{0x76, 0x77}, 0x00, 0x60, "BMP390"},
    {{0x68, 0x69}, 0x75, 0x68, "MPU-6050"},
    {{0x68, 0x69}, 0x75, 0x70, "MPU-6500"},
    {{0x68, 0x69}, 0x75, 0x71, "MPU-9250"},
    {{0x6a, 0x6b}, 0x0f, 0x6c, "LSM6DSO or LSM6DSOX"},
    {{0x6a, 0x6b}, 0x0f, 0x69, "LSM6DS3"},
    {{0x6a, 0x6b}, 0x0f, 0x6a, "LSM6DS3TR-C"},
    {{0x6a, 0x6b}, 0x0f, 0x68, "LSM9DS1, accelerometer and gyroscope"},
    {{0x1c, 0x1e}, 0x0f, 0x3d, "LSM9DS1, magnetometer"},
    {{0x1d, 0x53}, 0x00, 0xe5, "ADXL345 or ADXL375"},
    {{0x28, 0x29}, 0x00, 0xa0, "BNO055"},
};

/// Chips that are often at an address and say nothing of themselves.
struct Usual {
  std::uint8_t first, last;
  std::string_view chips;
};
constexpr Usual usual[] = {
    {0x1e, 0x1e, "HMC5883L"},
    {0x20, 0x22, "a port expander (PCF8574, MCP23017)"},
    {0x23, 0x23, "BH1750, or a port expander"},
    {0x24, 0x27, "a port expander (PCF8574, MCP23017), or a display behind one"},
    {0x29, 0x29, "VL53L0X, TSL2591"},
    {0x2a, 0x2a, "NAU7802"},
    {0x38, 0x38, "AHT20, or a PCF8574A"},
    {0x3c, 0x3d, "a display (SSD1306)"},
    {0x40, 0x43, "INA219, INA226, HDC1080, PCA9685"},
    {0x44, 0x45, "SHT3x, SHT4x, INA219"},
    {0x46, 0x47, "INA219, INA226"},
    {0x48, 0x4b, "ADS1115, ADS1015, LM75, TMP102"},
    {0x4c, 0x4f, "LM75, TMP75"},
    {0x50, 0x57, "an EEPROM (24Cxx)"},
    {0x5c, 0x5c, "BH1750, LPS25H"},
    {0x60, 0x60, "MCP4725, MPL3115A2"},
    {0x68, 0x69, "a clock (DS3231, DS1307), MPU-6050"},
    {0x70, 0x71, "a multiplexer (TCA9548A)"},
    {0x76, 0x77, "MS5611"},
};

std::string likely_chip(I2cDevice& chip) {
  const unsigned address = chip.address().number;
  for (const Identity& known : identities) {
    if (std::find(known.addresses.begin(), known.addresses.end(), address) == known.addresses.end()) continue;
    const Result<std::uint8_t> found = chip.read_register(known.register_number);
    if (found && *found == known.value) return std::string(known.chip);
  }
  for (const Usual& known : usual)
    if (known.first <= address && address <= known.last) return "perhaps " + std::string(known.chips);
  return "a chip that is not known here";
}

/// Two digits, as the kernel names a chip: "1-0076".
std::string kernel_name(std::string_view adapter, unsigned address) {
  constexpr std::string_view digits = "0123456789abcdef";
  std::string name(adapter.substr(adapter.rfind('-') + 1));
  name += "-00";
  name += digits[address >> 4];
  name += digits[address & 15];
  return name;
}

}  // namespace

void probe_i2c(const MachineFiles& files, const std::string& adapter, std::vector<FoundDevice>& found) {
  const I2cBus bus({.device = files.path("/dev/" + adapter)});
  unsigned timeouts = 0;
  for (unsigned address = I2cAddress::first; address <= I2cAddress::last; ++address) {
    if (files.exists("/sys/bus/i2c/devices/" + kernel_name(adapter, address))) continue;  // told already
    I2cDevice chip = bus.device({address});
    std::array<std::uint8_t, 1> byte{};
    if (const Result<void> answered = chip.read(byte); !answered) {
      if (answered.error().code == Errc::disconnected) continue;
      // On a bus of which a line is held every address costs the adapter's time-out.
      if (answered.error().code == Errc::timed_out && ++timeouts < 3) continue;
      found.push_back({"i2c", "/dev/" + adapter, "cannot be probed", answered.error().why,
                       "look at its wires and pull-up resistors: SDA and SCL are high on a bus at rest"});
      return;
    }
    const std::string text = to_string(I2cAddress(address));
    found.push_back({"i2c", "/dev/" + adapter, "address " + text + ": " + likely_chip(chip)});
  }
}

}  // namespace rtdata::app
