// The shipped drivers, a file for each kind of bus: a chip is one line in it. Private to the program.
#pragma once

#include "rtdata/config/registry.hpp"

namespace rtdata::app {

void add_register_drivers(Registry& registry);  ///< on I2C or SPI
void add_i2c_drivers(Registry& registry);
void add_spi_drivers(Registry& registry);
void add_serial_drivers(Registry& registry);

}  // namespace rtdata::app
