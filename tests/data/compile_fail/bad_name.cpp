// expect: the name of a record or field may have letters, digits and underscores
#include "rtdata/data/describe.hpp"

struct Climate {
  double temperature = 0;
  friend constexpr auto describe(rtdata::type_tag<Climate>) {
    return rtdata::record("climate", rtdata::field("air temperature", &Climate::temperature, "Cel"));
  }
};

const auto& description = rtdata::description_of<Climate>();
