/// RegisterBus, RegisterDevice: chips that have registers of 8 bits, on I2C or on SPI, and one driver for both.
///
///     rtdata::I2cBus i2c({.device = "/dev/i2c-1"});
///     rtdata::DriverSensor<rtdata::Imu> imu(loop, {.name = "imu", .rate = 50_Hz}, i2c, {.address = 0x6a}, config);
///     rtdata::SpiBus spi({.device = "/dev/spidev0"});
///     rtdata::DriverSensor<rtdata::Imu> fast(loop, {.name = "fast", .rate = 50_Hz}, spi, {.chip_select = 1}, config);
///
/// On SPI the chip select is the place, and the first byte is the register's number with a bit for reading. What
/// differs between chips is the driver's `static RegisterAddressing addressing(const Config&)`.
///
/// Errors: those of i2c.hpp and spi.hpp; bad-argument for a place on the other kind of bus.
///
/// Thread: RegisterDevice: one at a time, on the bus's lane.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>

#include "rtdata/data/config_value.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/io/bus.hpp"

namespace rtdata {

/// An address of 7 bits. In configurations 118 or "0x76".
struct I2cAddress {
  static constexpr unsigned first = 0x08;  ///< lower ones, and those above `last`, are reserved
  static constexpr unsigned last = 0x77;
  unsigned number = 0;
  constexpr I2cAddress() = default;
  constexpr I2cAddress(unsigned number_) : number(number_) {}
  constexpr bool operator==(const I2cAddress&) const = default;
};
/// "0x76"
std::string to_string(I2cAddress address);
/// Why the address is invalid; suggests the right one if it has 8 bits. Empty: it is valid.
std::string mistake_in(I2cAddress address);

template <>
struct ConfigValue<I2cAddress> {
  static constexpr TextOrNumber accepts{
      I2cAddress::first, I2cAddress::last,
      "^(0[xX]0*([89a-fA-F]|[1-6][0-9a-fA-F]|7[0-7])|0*([89]|[1-9][0-9]|1[01][0-9]))$"};
  static bool read(const ConfigItem& item, I2cAddress& out, Problems& problems);
  static void write(I2cAddress value, ConfigItem& item) { item.set(to_string(value)); }
};

/// Where a chip with registers is: on SPI if it has a chip select, else on I2C.
struct RegisterPlace {
  I2cAddress address = {};
  std::optional<unsigned> chip_select{};
  unsigned mode = 3;           ///< of SPI: clock polarity times 2, plus phase
  unsigned clock = 1'000'000;  ///< Hz, of SPI; controllers take the next lower one that they have
  friend constexpr auto parameters(type_tag<RegisterPlace>) {
    return parameter_list(
        parameter("address", &RegisterPlace::address, "I2C: 7-bit address of the chip, such as \"0x76\""),
        parameter("chip_select", &RegisterPlace::chip_select, "SPI: chip select of the chip, the 1 of /dev/spidev0.1",
                  range(0, 255)),
        parameter("mode", &RegisterPlace::mode, "SPI: mode, clock polarity times 2 plus phase", range(0, 3)),
        parameter("clock", &RegisterPlace::clock, "SPI: highest clock frequency; long wires need a lower one",
                  unit("Hz"), range(1'000, 100'000'000)));
  }
  friend void check_config(const RegisterPlace& place, const ConfigItem& item, Problems& problems);
};

/// How the number of a register is sent.
struct RegisterAddressing {
  std::uint8_t i2c_burst_bit = 0;    ///< on I2C, when several registers are read
  std::uint8_t spi_read_bit = 0x80;  ///< cleared when a register is written
  std::uint8_t spi_burst_bit = 0;    ///< when several registers are read
  std::size_t spi_dummy_bytes = 0;   ///< extra bytes before the data, up to 3
  std::string_view without_spi{};    ///< name of a chip without SPI; empty: it has SPI
};

namespace detail {
/// The bus's own device under a RegisterDevice.
class RegisterWires {
 public:
  virtual ~RegisterWires() = default;
  virtual Result<void> write_read(std::span<const std::uint8_t> write, std::span<std::uint8_t> read) = 0;
  virtual Result<void> look_at() = 0;
  virtual Error error(Errc code, std::string what, std::string why, std::string advice) const = 0;
};
}  // namespace detail

class RegisterBus;

class RegisterDevice : public BusDevice {
 public:
  using Bus = RegisterBus;
  using Place = RegisterPlace;

  bool is_on_spi() const noexcept { return is_on_spi_; }
  /// Before the first transfer.
  void set_addressing(const RegisterAddressing& addressing) noexcept { addressing_ = addressing; }

  Result<void> read_registers(std::uint8_t first, std::span<std::uint8_t> bytes);
  Result<std::uint8_t> read_register(std::uint8_t number);
  /// Two registers, the high byte first.
  Result<std::uint16_t> read_word(std::uint8_t number);
  Result<void> write_register(std::uint8_t number, std::uint8_t value);
  /// A command: the byte alone, as it is.
  Result<void> command(std::uint8_t code) { return wires_->write_read({&code, 1}, {}); }
  /// Checks that the chip can be used, for example that no kernel driver has it.
  Result<void> look_at() { return wires_->look_at(); }

  /// An error of this chip, for drivers: "cannot read the BMP280: bus i2c1, 0x76: ...".
  Error error(Errc code, std::string what, std::string why, std::string advice = {}) const {
    return wires_->error(code, std::move(what), std::move(why), std::move(advice));
  }

 private:
  friend class I2cBus;
  friend class SpiBus;
  /// `base`: the device of the bus; this object shares its counts and its abandoned flag.
  RegisterDevice(const BusDevice& base, std::shared_ptr<detail::RegisterWires> wires, bool is_on_spi)
      : BusDevice(base), wires_(std::move(wires)), is_on_spi_(is_on_spi) {}
  std::shared_ptr<detail::RegisterWires> wires_;
  RegisterAddressing addressing_;
  bool is_on_spi_;
};

/// The common base of I2cBus and SpiBus for such drivers.
class RegisterBus : public Bus {
 public:
  static constexpr std::array<std::string_view, 2> types{"i2c", "spi"};
  /// SetupError (bad-argument): no such place on this bus.
  RegisterDevice device(const RegisterPlace& place) const { return register_device(place); }
  /// Sensors read on their loop, not on the bus's lane.
  virtual bool reads_on_loop() const noexcept { return false; }
  static std::string text_of(const RegisterPlace& place) {
    return place.chip_select ? "chip select " + std::to_string(*place.chip_select)
                             : "address " + to_string(place.address);
  }
  /// The type of bus for this place, and the advice for the other type.
  static std::string_view type_of(const RegisterPlace& place) { return types[place.chip_select ? 1 : 0]; }
  static std::string_view advice_on_other(const RegisterPlace& place) {
    return place.chip_select ? "on I2C, set the chip's `address`, and remove `chip_select`"
                             : "on SPI, set the chip's `chip_select`";
  }

 protected:
  using Bus::Bus;
  ~RegisterBus() = default;
  /// Refuses a place that is on the other kind of bus.
  void expect(const RegisterPlace& place, std::string_view type) const;

 private:
  virtual RegisterDevice register_device(const RegisterPlace& place) const = 0;
};

}  // namespace rtdata
