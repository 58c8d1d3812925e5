// expect: a driver has `using Device`, how it talks to its chip
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
  explicit Thermometer(const Config&) {}
  rtdata::Reading<Climate> read(rtdata::I2cDevice& chip);
};

void make(rtdata::Loop& loop, rtdata::I2cBus& bus) {
  rtdata::DriverSensor<Thermometer> room(loop, {.name = "room"}, bus);
}
