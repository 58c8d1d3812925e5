#include "app/core/standard_drivers.hpp"
#include "rtdata/chips/max31855.hpp"
#include "rtdata/chips/max31856.hpp"
#include "rtdata/chips/max31865.hpp"
#include "rtdata/chips/mcp3x08.hpp"

namespace rtdata::app {

void add_spi_drivers(Registry& registry) {
  registry.add_driver<Mcp3x08>();
  registry.add_driver<Max31855>();
  registry.add_driver<Max31856>();
  registry.add_driver<Max31865>();
}

}  // namespace rtdata::app
