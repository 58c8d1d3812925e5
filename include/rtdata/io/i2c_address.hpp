/// I2cAddress: the place of a chip on an I2C bus. Part of i2c.hpp and registers.hpp.
#pragma once

#include <string>

#include "rtdata/data/config_value.hpp"
#include "rtdata/data/text_or_number.hpp"

namespace rtdata {

/// An address of 7 bits. In configurations 118 or "0x76".
struct I2cAddress {
  static constexpr unsigned first = 0x08;  ///< those below, and above the last, are reserved
  static constexpr unsigned last = 0x77;
  unsigned number = 0;
  constexpr I2cAddress() = default;
  constexpr I2cAddress(unsigned number_) : number(number_) {}
  constexpr bool operator==(const I2cAddress&) const = default;
};
/// "0x76"
std::string to_string(I2cAddress address);
/// Why it is none, and what is meant when it has 8 bits; empty: it is one.
std::string mistake_in(I2cAddress address);

template <>
struct ConfigValue<I2cAddress> {
  static constexpr TextOrNumber accepts{
      I2cAddress::first, I2cAddress::last,
      "^(0[xX]0*([89a-fA-F]|[1-6][0-9a-fA-F]|7[0-7])|0*([89]|[1-9][0-9]|1[01][0-9]))$"};
  static bool read(const ConfigItem& item, I2cAddress& out, Problems& problems);
  static void write(I2cAddress value, ConfigItem& item) { item.set(to_string(value)); }
};

}  // namespace rtdata
