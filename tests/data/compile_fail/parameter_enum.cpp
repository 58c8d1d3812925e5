// expect: rtdata: a parameter is an enumeration without names: give it a `describe`, or the parameter `choices`
#include "rtdata/config/read.hpp"

enum class Colour { red, blue };
struct Config {
  Colour colour = Colour::red;
  friend constexpr auto parameters(rtdata::type_tag<Config>) {
    return rtdata::parameter_list(rtdata::parameter("colour", &Config::colour, "of the lamp"));
  }
};

Config read(const rtdata::ConfigItem& item) { return rtdata::read_config<Config>(item); }
