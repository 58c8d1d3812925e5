#include "app/core/standard_drivers.hpp"
#include "rtdata/sensors/accelerometer.hpp"
#include "rtdata/sensors/barometer.hpp"
#include "rtdata/sensors/imu.hpp"
#include "rtdata/sensors/magnetometer.hpp"

namespace rtdata::app {

void add_register_drivers(Registry& registry) {
  registry.add_driver<Barometer>();
  registry.add_driver<Accelerometer>();
  registry.add_driver<Imu>();
  registry.add_driver<Magnetometer>();
}

}  // namespace rtdata::app
