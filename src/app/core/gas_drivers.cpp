#include "app/core/standard_drivers.hpp"
#include "rtdata/chips/bme680.hpp"
#include "rtdata/chips/scd4x.hpp"
#include "rtdata/chips/sgp.hpp"
#include "rtdata/chips/sps30.hpp"

namespace rtdata::app {

void add_gas_drivers(Registry& registry) {
  registry.add_driver<Bme680>();
  registry.add_driver<Scd4x>();
  registry.add_driver<Sgp30>();
  registry.add_driver<Sgp40>();
  registry.add_driver<Sps30>();
}

}  // namespace rtdata::app
