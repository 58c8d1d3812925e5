// expect: a driver has `using Value`, what it publishes
#include "rtdata/io/i2c.hpp"
#include "rtdata/sensors/driver.hpp"

struct Climate {
  double temperature = 0;
  RTDATA_FIELDS(Climate, (temperature, "Cel"))
};
class Thermometer {
 public:
  struct Config {};
  using Device = rtdata::I2cDevice;
  explicit Thermometer(const Config&) {}
  rtdata::Reading<Climate> read(rtdata::I2cDevice& chip);
};

void make(rtdata::Loop& loop, rtdata::I2cBus& bus) {
  rtdata::DriverSensor<Thermometer> room(loop, {.name = "room"}, bus, {.address = 0x48});
}
