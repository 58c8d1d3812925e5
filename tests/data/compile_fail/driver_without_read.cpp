// expect: a driver has a public `read(Device&)` or `read(Device&, Samples<Value>&)`
#include "rtdata/io/i2c.hpp"
#include "rtdata/sensors/driver.hpp"

struct Climate {
  double temperature = 0;
  RTDATA_FIELDS(Climate, (temperature, "Cel"))
};
class Thermometer {
 public:
  struct Config {};
  using Value = Climate;
  using Device = rtdata::I2cDevice;
  explicit Thermometer(const Config&) {}
};

void make(rtdata::Loop& loop, rtdata::I2cBus& bus) {
  rtdata::DriverSensor<Thermometer> room(loop, {.name = "room"}, bus, {.address = 0x48});
}
