/// What thermometers for thermocouples publish (max31855.hpp, max31856.hpp).
#pragma once

#include "rtdata/data/describe.hpp"

namespace rtdata {

struct ThermocoupleReading {
  double temperature = 0;    ///< of the thermocouple's tip, cold junction compensated by the chip
  double cold_junction = 0;  ///< of the chip, where the thermocouple is connected
  friend constexpr auto describe(type_tag<ThermocoupleReading>) {
    return record("thermocouple", field("temperature", &ThermocoupleReading::temperature, "Cel"),
                  field("cold_junction", &ThermocoupleReading::cold_junction, "Cel"));
  }
};

}  // namespace rtdata
