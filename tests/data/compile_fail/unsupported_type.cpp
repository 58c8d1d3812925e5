// expect: a field has a type that cannot be described
#include "rtdata/data/describe.hpp"

struct Climate {
  long double temperature = 0;
  RTDATA_FIELDS(Climate, (temperature, "Cel"))
};

const auto& description = rtdata::description_of<Climate>();
