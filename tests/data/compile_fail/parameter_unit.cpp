// expect: rtdata: a unit is for a number; durations and rates are written with theirs
#include "rtdata/config/read.hpp"

struct Config {
  rtdata::Duration wait{};
  friend constexpr auto parameters(rtdata::type_tag<Config>) {
    return rtdata::parameter_list(rtdata::parameter("wait", &Config::wait, "how long", rtdata::unit("s")));
  }
};

Config read(const rtdata::ConfigItem& item) { return rtdata::read_config<Config>(item); }
