// expect: `describe` has two fields of one name
#include "rtdata/data/describe.hpp"

struct Climate {
  double temperature = 0;
  double humidity = 0;
  friend constexpr auto describe(rtdata::type_tag<Climate>) {
    return rtdata::record("climate", rtdata::field("temperature", &Climate::temperature, "Cel"),
                          rtdata::field("Temperature", &Climate::humidity, "%RH"));
  }
};

const auto& description = rtdata::description_of<Climate>();
