#include "rtdata/io/i2c.hpp"

#include <algorithm>
#include <cerrno>

#include "io/code_text.hpp"
#include "io/enabling.hpp"
#include "rtdata/detail/loop/lane.hpp"

namespace rtdata {

std::string to_string(I2cAddress address) {
  constexpr std::string_view digits = "0123456789abcdef";
  std::string text;
  for (unsigned left = address.number; left != 0 || text.size() < 2; left /= 16) text.insert(0, 1, digits[left % 16]);
  return "0x" + text;
}

std::string mistake_in(I2cAddress address) {
  const unsigned number = address.number;
  if (number >= I2cAddress::first && number <= I2cAddress::last) return "";
  if (number > 0x7f && number <= 0xff && number / 2 >= I2cAddress::first && number / 2 <= I2cAddress::last)
    return to_string(address) + " is an 8-bit address, with the read/write bit; the 7-bit address is " +
           to_string(I2cAddress(number / 2));
  if (number == 0) return "the address of the chip is missing, such as 0x76";
  return to_string(address) + " is not a 7-bit address of a chip (0x08 to 0x77)";
}

bool ConfigValue<I2cAddress>::read(const ConfigItem& item, I2cAddress& out, Problems& problems) {
  if (!detail::read_code(item, out.number, "an address: write it as \"0x76\"", problems)) return false;
  const std::string mistake = mistake_in(out);
  if (!mistake.empty()) problems.add(item.problem("bad-value", mistake));
  return mistake.empty();
}

/// Shared by the bus and its devices, which may hang and outlive it.
struct I2cDevice::Core {
  Core(std::string bus_, std::shared_ptr<I2cTransport> transport_, I2cConfig config_)
      : bus(std::move(bus_)), transport(std::move(transport_)), config(std::move(config_)) {}
  const std::string bus;
  const std::shared_ptr<I2cTransport> transport;
  const I2cConfig config;
};

Error I2cDevice::error(Errc code, std::string what, std::string why, std::string advice) const {
  return {code, std::move(what), "bus " + core_->bus + ", " + to_string(address_), std::move(why), std::move(advice)};
}

Error I2cDevice::failure(int errno_value) const {
  constexpr const char* what = "cannot talk to the chip";
  switch (errno_value) {
    case ENXIO:
    case EREMOTEIO:
      return error(Errc::disconnected, what, "nothing acknowledges this address",
                   "check its wires and its supply; `i2cdetect -y` shows who answers");
    case ETIMEDOUT:
      return error(Errc::timed_out, what, "the adapter could not get the bus",
                   "a chip may hold SCL or SDA: switch it off and on");
    case EAGAIN:
      return error(Errc::busy, what, "arbitration was lost", "another master is on the bus");
    case EBUSY:
      return error(Errc::busy, what, "a kernel driver uses the chip",
                   "read it through that driver (`analog`, `host`), or unbind the driver in /sys/bus/i2c/drivers");
    case EOPNOTSUPP:
      return error(Errc::bad_argument, what, "the adapter supports only SMBus, which has no such transfer",
                   "use an adapter with full I2C for this chip");
    default:
      break;
  }
  const std::string device = core_->config.device.empty() ? "bus " + core_->bus : core_->config.device;
  return system_error(errno_value, what, device + ", " + to_string(address_),
                      errno_value == ENOENT && !detail::how_to_enable(core_->config.device).empty()
                          ? detail::how_to_enable(core_->config.device)
                          : "`ls -l /dev/i2c-*` lists the adapters and who may use them");
}

Result<void> I2cDevice::look_at() {
  const MonotonicTime began = detail::lane_now();
  const int status = core_->transport->look_at(address_.number);
  if (status != 0) count(detail::lane_now() - began, false);
  return status == 0 ? Result<void>() : Result<void>(failure(status));
}

Result<void> I2cDevice::write_read(std::span<const std::uint8_t> write, std::span<std::uint8_t> read) {
  int status = 0;
  unsigned tries = 0;
  const MonotonicTime began = detail::lane_now();
  do {
    if (is_abandoned()) return error(Errc::closed, "cannot talk to the chip", "this reading was given up before");
    status = core_->transport->transfer(address_.number, write, read);
  } while (status != 0 && tries++ < core_->config.retries);
  count(detail::lane_now() - began, status == 0, status != 0 ? core_->config.retries : tries);
  return status == 0 ? Result<void>() : Result<void>(failure(status));
}

Result<std::uint8_t> I2cDevice::read_register(std::uint8_t number) {
  std::uint8_t value = 0;
  if (auto done = write_read({&number, 1}, {&value, 1}); !done) return std::move(done).error();
  return value;
}

Result<void> I2cDevice::write_register(std::uint8_t number, std::uint8_t value) {
  const std::array<std::uint8_t, 2> bytes{number, value};
  return write(bytes);
}

Result<std::uint16_t> I2cDevice::read_word(std::uint8_t number) {
  std::array<std::uint8_t, 2> bytes{};
  if (auto done = write_read({&number, 1}, bytes); !done) return std::move(done).error();
  return static_cast<std::uint16_t>(bytes[0] << 8 | bytes[1]);
}

Result<void> I2cDevice::write_word(std::uint8_t number, std::uint16_t value) {
  const std::array<std::uint8_t, 3> bytes{number, static_cast<std::uint8_t>(value >> 8),
                                          static_cast<std::uint8_t>(value & 0xff)};
  return write(bytes);
}

I2cBus::I2cBus(I2cConfig config) : I2cBus(std::string(config.device), config) {}

// Not moved, because the order of argument evaluation is unspecified.
I2cBus::I2cBus(std::string name, I2cConfig config) : I2cBus(std::move(name), make_kernel_i2c(config.device), config) {}

I2cBus::I2cBus(std::string name, std::shared_ptr<I2cTransport> transport, I2cConfig config)
    : RegisterBus(name, config.timeout),
      core_(std::make_shared<I2cDevice::Core>(std::move(name), std::move(transport), std::move(config))) {}

I2cDevice I2cBus::device(const I2cDevice::Place& place) const {
  if (std::string mistake = mistake_in(place.address); !mistake.empty())
    throw SetupError({Errc::bad_argument, "cannot use this address", "bus " + name(), std::move(mistake), ""});
  return {core_, place.address, counter_of(text_of(place))};
}

namespace {

class I2cRegisters final : public detail::RegisterWires {
 public:
  explicit I2cRegisters(I2cDevice device) : device_(std::move(device)) {}
  Result<void> write_read(std::span<const std::uint8_t> write, std::span<std::uint8_t> read) override {
    return device_.write_read(write, read);
  }
  Result<void> look_at() override { return device_.look_at(); }
  Error error(Errc code, std::string what, std::string why, std::string advice) const override {
    return device_.error(code, std::move(what), std::move(why), std::move(advice));
  }

 private:
  I2cDevice device_;
};

}  // namespace

RegisterDevice I2cBus::register_device(const RegisterPlace& place) const {
  expect(place, type);
  const I2cDevice chip = device({place.address});
  return {chip, std::make_shared<I2cRegisters>(chip), false};
}

}  // namespace rtdata
