// Finds I2C adapters and names the chips at their addresses: chips that a driver supports, and other common ones.
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>
#include <vector>

#include "app/machine/scanner.hpp"
#include "io/enabling.hpp"
#include "rtdata/io/i2c.hpp"

namespace rtdata::app {
namespace {

/// Common chips without a driver here, by address.
struct Usual {
  std::uint8_t first, last;
  std::string_view chip;
};
constexpr Usual usual[] = {
    {0x20, 0x27, "a port expander (PCF8574, MCP23017)"},
    {0x23, 0x23, "BH1750"},
    {0x24, 0x27, "a display behind a port expander"},
    {0x29, 0x29, "VL53L0X"},
    {0x29, 0x29, "TSL2591"},
    {0x38, 0x38, "AHT20"},
    {0x38, 0x38, "a port expander (PCF8574A)"},
    {0x3c, 0x3d, "a display (SSD1306)"},
    {0x40, 0x43, "HDC1080"},
    {0x40, 0x43, "PCA9685"},
    {0x48, 0x4b, "TMP102"},
    {0x50, 0x57, "an EEPROM (24Cxx)"},
    {0x5c, 0x5c, "BH1750"},
    {0x5c, 0x5c, "LPS25H"},
    {0x60, 0x60, "MCP4725"},
    {0x60, 0x60, "MPL3115A2"},
    {0x68, 0x69, "a clock (DS3231, DS1307)"},
    {0x70, 0x71, "a multiplexer (TCA9548A)"},
};

/// How certain it is that a chip is the one that a driver knows.
enum class Match { no, perhaps, yes };
Match match_of(const KnownChip& known, I2cDevice& chip) {
  if (!known.is_at(chip.address().number)) return Match::no;
  if (!known.identity) return Match::perhaps;
  const Result<std::uint32_t> found = read_identity(chip, *known.identity);
  if (!found || !known.identity->is_of(*found)) return Match::no;
  return detail::is_all_ones(*known.identity, *found) ? Match::perhaps : Match::yes;
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
    const LikelyChip likely = likely_chip(chip, scanner.registry);
    scanner.add({"i2c", path, "address " + text + ": " + likely.what});
    for (const LikelyChip::Driver& driver : likely.drivers)
      scanner.sensor(scanner.scan.devices.back(), driver.type, driver.type,
                     R"("bus": )" + json_text(bus_name) + R"(, "address": )" + json_text(text) +
                         (driver.model.empty() ? "" : R"(, "model": )" + json_text(driver.model)) +
                         R"(, "rate": "1 Hz")",
                     bus_line);
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

LikelyChip likely_chip(I2cDevice& chip, const Registry& registry) {
  LikelyChip sure, perhaps;
  std::vector<std::string_view> named;  // a driver of the user's own may be for a chip that is in the table
  const auto name = [&](LikelyChip& likely, std::string_view between, std::string_view name_of_chip) {
    if (std::find(named.begin(), named.end(), name_of_chip) != named.end()) return;
    named.push_back(name_of_chip);
    likely.what.append(likely.what.empty() ? "" : between).append(name_of_chip);
  };
  const std::vector<TypeInfo> types = registry.sensors().types();
  for (const TypeInfo& type : types) {
    for (const KnownChip& known : type.page.chips) {
      const Match match = match_of(known, chip);
      if (match == Match::no) continue;
      LikelyChip& likely = match == Match::yes ? sure : perhaps;
      name(likely, match == Match::yes ? " or " : ", ", known.name);
      likely.drivers.push_back({type.name, std::string(known.model)});
    }
  }
  if (!sure.what.empty()) return sure;
  const unsigned address = chip.address().number;
  for (const Usual& one : usual)
    if (one.first <= address && address <= one.last) name(perhaps, ", ", one.chip);
  perhaps.what = perhaps.what.empty() ? "a chip that is not known here" : "perhaps " + perhaps.what;
  return perhaps;
}

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
