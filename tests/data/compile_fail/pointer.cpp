// expect: a field has a type that cannot be described
#include "rtdata/data/describe.hpp"

struct Station {
  const char* name = nullptr;
  RTDATA_FIELDS(Station, (name))
};

const auto& description = rtdata::description_of<Station>();
