#include "app/core/standard_drivers.hpp"
#include "rtdata/chips/ads1x15.hpp"
#include "rtdata/chips/bme680.hpp"
#include "rtdata/chips/bno055.hpp"
#include "rtdata/chips/ina.hpp"
#include "rtdata/chips/ina3221.hpp"
#include "rtdata/chips/lm75.hpp"
#include "rtdata/chips/nau7802.hpp"
#include "rtdata/chips/scd4x.hpp"
#include "rtdata/chips/sgp.hpp"
#include "rtdata/chips/sht.hpp"
#include "rtdata/chips/sps30.hpp"

namespace rtdata::app {

void add_i2c_drivers(Registry& registry) {
  registry.add_driver<Bno055>();
  registry.add_driver<Bme680>();
  registry.add_driver<Lm75>();
  registry.add_driver<Sht>();
  registry.add_driver<Ina>();
  registry.add_driver<Ina3221>();
  registry.add_driver<Scd4x>();
  registry.add_driver<Sgp30>();
  registry.add_driver<Sgp40>();
  registry.add_driver<Sps30>();
  registry.add_driver<Ads1x15>();
  registry.add_driver<Nau7802>();
}

}  // namespace rtdata::app
