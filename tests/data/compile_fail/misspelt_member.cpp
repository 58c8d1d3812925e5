// expect: 'humid'
// lines: 17
#include "rtdata/data/describe.hpp"

struct Climate {
  double temperature = 0;
  double humidity = 0;
  RTDATA_FIELDS(Climate, (temperature, "Cel"), (humid, "%RH"))
};

const auto& description = rtdata::description_of<Climate>();
