#include "rtdata/io/registers.hpp"

#include <algorithm>

#include "rtdata/data/config_item.hpp"

namespace rtdata {

void check_config(const RegisterPlace& place, const ConfigItem& item, Problems& problems) {
  const ConfigItem* address = item.find("address");
  if (place.chip_select && address != nullptr)
    problems.add(
        address->problem("bad-value", "a chip on SPI has a `chip_select` and no `address`: remove one of them"));
  if (place.chip_select) return;
  for (const std::string_view key : {"mode", "clock"}) {
    if (const ConfigItem* at = item.find(key))
      problems.add(at->problem("bad-value", "this works only on SPI, where the chip has a `chip_select`"));
  }
}

Result<void> RegisterDevice::read_registers(std::uint8_t first, std::span<std::uint8_t> bytes) {
  constexpr std::size_t most_dummy_bytes = 3;
  const bool is_burst = bytes.size() > 1;
  std::array<std::uint8_t, 1 + most_dummy_bytes> sent{};
  sent[0] = first;
  if (!is_on_spi_) {
    if (is_burst) sent[0] |= addressing_.i2c_burst_bit;
    return wires_->write_read(std::span(sent).first(1), bytes);
  }
  sent[0] |= addressing_.spi_read_bit;
  if (is_burst) sent[0] |= addressing_.spi_burst_bit;
  return wires_->write_read(std::span(sent).first(1 + std::min(addressing_.spi_dummy_bytes, most_dummy_bytes)), bytes);
}

Result<std::uint8_t> RegisterDevice::read_register(std::uint8_t number) {
  std::uint8_t value = 0;
  if (auto done = read_registers(number, {&value, 1}); !done) return std::move(done).error();
  return value;
}

Result<std::uint16_t> RegisterDevice::read_word(std::uint8_t number) {
  std::array<std::uint8_t, 2> bytes{};
  if (auto done = read_registers(number, bytes); !done) return std::move(done).error();
  return static_cast<std::uint16_t>(bytes[0] << 8 | bytes[1]);
}

Result<void> RegisterDevice::write_register(std::uint8_t number, std::uint8_t value) {
  const unsigned read_bit = is_on_spi_ ? addressing_.spi_read_bit : 0u;
  const std::array<std::uint8_t, 2> bytes{static_cast<std::uint8_t>(number & ~read_bit), value};
  return wires_->write_read(bytes, {});
}

void RegisterBus::expect(const RegisterPlace& place, std::string_view type) const {
  if (type_of(place) == type) return;
  throw SetupError({Errc::bad_argument, "cannot use this chip", "bus " + name() + ", " + text_of(place),
                    "this bus is of type " + std::string(type), std::string(advice_on_other(place))});
}

}  // namespace rtdata
