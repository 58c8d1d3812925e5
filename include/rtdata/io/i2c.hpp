/// I2cBus, I2cDevice: chips on an I2C adapter of the kernel (/dev/i2c-1), or on another transport.
///
///     rtdata::I2cBus bus({.device = "/dev/i2c-1"});
///     rtdata::I2cDevice chip = bus.device({.address = 0x76});
///     const auto id = chip.read_register(0xd0).or_throw();
///
/// All transfers block the thread that calls them: a program that has a loop gives the bus to sensors (DriverSensor,
/// driver.hpp), which use it on its lane. `write_read` is one transfer, with a repeated start and without a stop
/// between; on an adapter with SMBus only, the library uses the SMBus commands, where there is one for the transfer.
///
/// Addresses have 7 bits, as on Linux: 0x08 to 0x77. If a data sheet gives 8 bits (0xec to write, 0xed to read), divide
/// by two.
///
/// Errors: disconnected (no chip acknowledges), timed-out (the adapter could not get the bus: a line is held), busy (a
/// driver of the kernel has the chip; or arbitration was lost), not-found, not-permitted (of the adapter), bad-argument
/// (a transfer that the adapter does not support), closed (of a job that was given up), io-failed.
///
/// Owner: the program, or the System; the I2cBus must outlive the sensors on it. Thread: I2cBus: any.
/// I2cDevice: one at a time.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/parameter.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/io/bus.hpp"
#include "rtdata/io/registers.hpp"

namespace rtdata {

/// The transport: the kernel's adapter, the fake for tests (fake_i2c.hpp), or your own. Thread: the bus's lane; after a
/// job was given up, a second thread may call it while the first still hangs in a call.
class I2cTransport {
 public:
  virtual ~I2cTransport() = default;
  /// Writes, then reads; either may be empty. 0, or the errno of what went wrong: ENXIO when nothing acknowledges.
  virtual int transfer(unsigned address, std::span<const std::uint8_t> write,
                       std::span<std::uint8_t> read) noexcept = 0;
  /// Before the first transfer of a sensor with this chip. 0, or an errno: EBUSY when another driver has it.
  virtual int look_at(unsigned) noexcept { return 0; }
};

struct I2cConfig {
  std::string device = {};                     ///< the adapter, "/dev/i2c-1"
  unsigned retries = 0;                        ///< of failed transfers; 0 if a repeated read loses data, as with FIFOs
  Duration timeout = std::chrono::seconds{1};  ///< limit of each job of a sensor on the bus

  friend constexpr auto parameters(type_tag<I2cConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("device", &I2cConfig::device, "the adapter, such as /dev/i2c-1", required, TextIs::device),
        parameter("retries", &I2cConfig::retries, "how often a failed transfer is tried again", range(0, 10)),
        parameter("timeout", &I2cConfig::timeout, "a reading that takes the bus for longer than this is given up",
                  range(Duration{1ms}, Duration{1h})));
  }
  friend Duration give_up_after(const I2cConfig& config) { return config.timeout; }
};

class I2cBus;

class I2cDevice : public BusDevice {
 public:
  using Bus = I2cBus;
  struct Place {
    I2cAddress address = {};
    friend constexpr auto parameters(type_tag<Place>) {
      return parameter_list(
          parameter("address", &Place::address, "7-bit address of the chip on the bus, such as \"0x76\""));
    }
  };

  I2cAddress address() const noexcept { return address_; }
  Result<void> write(std::span<const std::uint8_t> bytes) { return write_read(bytes, {}); }
  Result<void> read(std::span<std::uint8_t> bytes) { return write_read({}, bytes); }
  /// Writes, then reads without a stop between.
  Result<void> write_read(std::span<const std::uint8_t> write, std::span<std::uint8_t> read);

  /// From a register of 8 bits on.
  Result<void> read_registers(std::uint8_t first, std::span<std::uint8_t> bytes) {
    return write_read({&first, 1}, bytes);
  }
  Result<std::uint8_t> read_register(std::uint8_t number);
  Result<void> write_register(std::uint8_t number, std::uint8_t value);
  /// Registers of 16 bits, the high byte first.
  Result<std::uint16_t> read_word(std::uint8_t number);
  Result<void> write_word(std::uint8_t number, std::uint16_t value);
  /// Checks that the chip can be used, for example that no kernel driver has it.
  Result<void> look_at();

  /// An error of this chip, for drivers: "cannot read the BMP280: bus i2c1, 0x76: ...".
  Error error(Errc code, std::string what, std::string why, std::string advice = {}) const;

 private:
  friend class I2cBus;
  struct Core;
  I2cDevice(std::shared_ptr<Core> core, I2cAddress address, std::shared_ptr<TransferCounter> counter)
      : BusDevice(std::move(counter)), core_(std::move(core)), address_(address) {}
  Error failure(int errno_value) const;
  std::shared_ptr<Core> core_;
  I2cAddress address_;
};

class I2cBus : public RegisterBus {
 public:
  static constexpr std::string_view type = "i2c";
  /// Its name is its device. The first transfer opens the adapter; after the adapter was gone, the next one opens it
  /// again.
  explicit I2cBus(I2cConfig config);
  I2cBus(std::string name, I2cConfig config);
  /// With another transport; `device` is not used.
  I2cBus(std::string name, std::shared_ptr<I2cTransport> transport, I2cConfig config = {});

  /// SetupError (bad-argument): not an address of 7 bits.
  I2cDevice device(const I2cDevice::Place& place) const;
  static std::string text_of(const I2cDevice::Place& place) { return "address " + to_string(place.address); }
  /// Any thread.
  TransferCounts counts(I2cAddress address) const { return counts_of(text_of({address})); }

 private:
  RegisterDevice register_device(const RegisterPlace& place) const override;
  std::shared_ptr<I2cDevice::Core> core_;
};

/// The kernel's adapter.
std::shared_ptr<I2cTransport> make_kernel_i2c(std::string device);

}  // namespace rtdata
