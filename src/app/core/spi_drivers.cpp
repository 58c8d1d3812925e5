#include "app/core/standard_drivers.hpp"
#include "rtdata/sensors/max31855.hpp"
#include "rtdata/sensors/max31856.hpp"
#include "rtdata/sensors/max31865.hpp"
#include "rtdata/sensors/mcp3x08.hpp"

namespace rtdata::app {

void add_spi_drivers(Registry& registry) {
  registry.add_driver<Mcp3x08>();
  registry.add_driver<Max31855>();
  registry.add_driver<Max31856>();
  registry.add_driver<Max31865>();
}

}  // namespace rtdata::app
