// expect: this type has no `describe`
#include "rtdata/data/describe.hpp"

struct Climate {
  double temperature = 0;
};

const auto& description = rtdata::description_of<Climate>();
