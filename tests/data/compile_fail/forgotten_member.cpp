// expect: `describe` leaves out a member of the struct
#include "rtdata/data/describe.hpp"

struct Climate {
  double temperature = 0;
  double humidity = 0;
  RTDATA_FIELDS(Climate, (temperature, "Cel"))
};

const auto& description = rtdata::description_of<Climate>();
