#include "app/core/standard_drivers.hpp"
#include "rtdata/sensors/mcp3x08.hpp"

namespace rtdata::app {

void add_spi_drivers(Registry& registry) { registry.add_driver<Mcp3x08>(); }

}  // namespace rtdata::app
