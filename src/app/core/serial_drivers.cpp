#include "app/core/standard_drivers.hpp"
#include "rtdata/chips/mhz19.hpp"
#include "rtdata/sensors/query.hpp"

namespace rtdata::app {

void add_serial_drivers(Registry& registry) {
  registry.add_driver<MhZ19>();
  registry.add_driver<Query>();
}

}  // namespace rtdata::app
