#include "app/core/standard_drivers.hpp"
#include "rtdata/sensors/bmp280.hpp"
#include "rtdata/sensors/imu.hpp"
#include "rtdata/sensors/ina.hpp"
#include "rtdata/sensors/lm75.hpp"
#include "rtdata/sensors/sht.hpp"

namespace rtdata::app {

void add_i2c_drivers(Registry& registry) {
  registry.add_driver<Bmp280>();
  registry.add_driver<Mpu6050>();
  registry.add_driver<Lm75>();
  registry.add_driver<Sht>();
  registry.add_driver<Ina>();
}

}  // namespace rtdata::app
