#include "data/ucum.hpp"

#include <doctest/doctest.h>

using rtdata::detail::is_ucum;
using rtdata::detail::ucum_for;

TEST_SUITE("data") {
  TEST_CASE("units of UCUM are known, and others with what was probably meant") {
    for (const char* unit :
         {"",     "1",      "m",         "m/s",      "m/s2",  "m.s-2",   "/min",    "Cel",   "[degF]",   "bar",
          "mbar", "hPa",    "kPa",       "%",        "%{RH}", "{count}", "V",       "mV",    "uV",       "A",
          "mA",   "A.h",    "W.h",       "Ohm",      "kOhm",  "Hz",      "kHz",     "rad/s", "deg",      "deg/s",
          "uT",   "G",      "By",        "KiBy",     "ns",    "us",      "ms",      "s",     "min",      "h",
          "d",    "mm[Hg]", "[in_i]",    "[psi]",    "l/min", "10*3/ul", "10*-6.m", "lx",    "m2/(V.s)", "dB[SPL]",
          "g",    "[g]",    "umol/s/m2", "J/(kg.K)", "2.m",   "eV",      "m[H2O]",  "bit/s"}) {
      CAPTURE(unit);
      CHECK(is_ucum(unit));
    }
    const std::pair<const char*, const char*> mistakes[] = {{"degC", "Cel"},
                                                            {"\u00b0C", "Cel"},
                                                            {"celsius", "Cel"},
                                                            {"m/s^2", "m/s2"},
                                                            {"m/s\u00b2", "m/s2"},
                                                            {"volts", "V"},
                                                            {"Volt", "V"},
                                                            {"rpm", "/min"},
                                                            {"%RH", "%{RH}"},
                                                            {"\u00b5s", "us"},
                                                            {"sec", "s"},
                                                            {"psi", "[psi]"},
                                                            {"bytes", "By"},
                                                            {"counts", "{counts}"},
                                                            {"hz", "Hz"},
                                                            {"kWh", "kW.h"},
                                                            {"Nm", "N.m"},
                                                            {"m*s", "m.s"},
                                                            {"degC/min", "Cel/min"},
                                                            {"m / s", "m/s"},
                                                            {"ppm", "[ppm]"},
                                                            {"inch", "[in_i]"},
                                                            {"m/", ""},
                                                            {"m//s", ""},
                                                            {"(m", ""},
                                                            {"m)", ""},
                                                            {"{x", ""},
                                                            {"[]", ""}};
    for (const auto& mistake : mistakes) {
      const std::string unit = mistake.first;
      const std::string meant = mistake.second;
      CAPTURE(unit);
      CHECK_FALSE(is_ucum(unit));
      CHECK(ucum_for(unit) == meant);
      CHECK((meant.empty() || is_ucum(meant)));
    }
    CHECK_FALSE(is_ucum(std::string(100000, '(')));  // no stack runs out
  }
}
