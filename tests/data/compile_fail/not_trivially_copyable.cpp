// expect: a payload must be trivially copyable
#include <string>

#include "rtdata/data/describe.hpp"

struct Station {
  std::string name;
  RTDATA_FIELDS(Station, (name))
};

const auto& description = rtdata::description_of<Station>();
