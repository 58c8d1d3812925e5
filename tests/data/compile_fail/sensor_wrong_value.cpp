// expect: a sensor of T is made of a function without parameters, or an object with `read()`, that returns
#include "rtdata/sensors/sensor.hpp"

struct Climate {
  double temperature = 0;
  RTDATA_FIELDS(Climate, (temperature, "Cel"))
};

void make(rtdata::Loop& loop) {
  rtdata::Sensor<Climate> room(loop, {.name = "room"}, [] { return "21.5"; });
}
