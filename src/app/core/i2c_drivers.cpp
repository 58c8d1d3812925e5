#include "app/core/standard_drivers.hpp"
#include "rtdata/chips/ads1x15.hpp"
#include "rtdata/chips/bno055.hpp"
#include "rtdata/chips/ina.hpp"
#include "rtdata/chips/ina3221.hpp"
#include "rtdata/chips/lm75.hpp"
#include "rtdata/chips/nau7802.hpp"
#include "rtdata/chips/sht.hpp"

namespace rtdata::app {

void add_i2c_drivers(Registry& registry) {
  registry.add_driver<Bno055>();
  registry.add_driver<Lm75>();
  registry.add_driver<Sht>();
  registry.add_driver<Ina>();
  registry.add_driver<Ina3221>();
  registry.add_driver<Ads1x15>();
  registry.add_driver<Nau7802>();
}

}  // namespace rtdata::app
