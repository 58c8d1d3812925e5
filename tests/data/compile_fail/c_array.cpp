// expect: a field has a type that cannot be described
#include "rtdata/data/describe.hpp"

struct Imu {
  double accel[3] = {};
  RTDATA_FIELDS(Imu, (accel, "m/s2"))
};

const auto& description = rtdata::description_of<Imu>();
