// A chip of the fake I2C bus, put on the fake SPI bus: the registers are the same, the first byte of a transfer is not.
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "rtdata/io/registers.hpp"
#include "rtdata/testing/fake_i2c.hpp"
#include "rtdata/testing/fake_spi.hpp"

namespace rtdata {

/// `above`: what the chip's registers have in bit 7 on I2C, which SPI needs for reading (BMP280: 0x80). `i2c` outlives
/// `spi`.
inline void bridge(FakeSpi& spi, unsigned chip_select, FakeI2c& i2c, unsigned address, RegisterAddressing addressing,
                   std::uint8_t above = 0) {
  const auto asked = std::make_shared<std::vector<std::uint8_t>>();
  spi.on_transfer(chip_select, [=, &i2c](std::span<const std::uint8_t> write, std::span<std::uint8_t> read) {
    if (!write.empty()) {
      asked->assign(write.begin(), write.end());
      const bool is_reading = addressing.spi_read_bit != 0 ? (write[0] & addressing.spi_read_bit) != 0
                                                           : write.size() == 1 && (write[0] == 0 || write[0] >= 0xa0);
      if (is_reading) return;
      std::vector<std::uint8_t> written = *asked;
      if (addressing.spi_read_bit != 0) written[0] = static_cast<std::uint8_t>(written[0] | above);
      i2c.transfer(address, written, {});
      return;
    }
    std::uint8_t number = static_cast<std::uint8_t>((*asked)[0] & ~addressing.spi_read_bit);
    const bool is_burst = addressing.spi_burst_bit != 0 && (number & addressing.spi_burst_bit) != 0;
    // A chip that needs these and does not get them gives something else.
    const bool is_right = asked->size() == 1 + addressing.spi_dummy_bytes &&
                          (read.size() == 1 || addressing.spi_burst_bit == 0 || is_burst);
    number = static_cast<std::uint8_t>((number & ~addressing.spi_burst_bit) | above |
                                       (is_burst ? addressing.i2c_burst_bit : 0));
    if (is_right) {
      i2c.transfer(address, {&number, 1}, read);
    } else {
      std::fill(read.begin(), read.end(), std::uint8_t{0xaa});
    }
  });
}

}  // namespace rtdata
