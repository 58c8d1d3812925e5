// The parts of `standard_registry`, one file each. The drivers have one file for each kind of bus: a chip is one
// line in it. Private to the program.
#pragma once

#include "rtdata/config/registry.hpp"

namespace rtdata::app {

void add_register_drivers(Registry& registry);  ///< on I2C or SPI
void add_i2c_drivers(Registry& registry);
void add_gas_drivers(Registry& registry);  ///< on I2C, too: air and gases
void add_spi_drivers(Registry& registry);
void add_serial_drivers(Registry& registry);
void add_device_sensors(Registry& registry);
void add_topic_sensors(Registry& registry);  ///< made of other topics
void add_line_sensors(Registry& registry);
void add_recordings(Registry& registry);  ///< their sink, and their replay
void add_shipped_sinks(Registry& registry);
void add_shipped_outputs(Registry& registry);

}  // namespace rtdata::app
