#include "app/core/standard_drivers.hpp"
#include "rtdata/chips/accelerometer.hpp"
#include "rtdata/chips/barometer.hpp"
#include "rtdata/chips/imu.hpp"
#include "rtdata/chips/magnetometer.hpp"

namespace rtdata::app {

void add_register_drivers(Registry& registry) {
  registry.add_driver<Barometer>();
  registry.add_driver<Accelerometer>();
  registry.add_driver<Imu>();
  registry.add_driver<Magnetometer>();
}

}  // namespace rtdata::app
