/// The sensor, sink and bus types that come with the library. Target: rtdata::program.
///
///     rtdata::Registry registry = rtdata::standard_registry();  // add types of your own to it
///     rtdata::System system(loop, registry, rtdata::load_config("bench.json"));
#pragma once

#include "rtdata/config/registry.hpp"

namespace rtdata {

Registry standard_registry();

}  // namespace rtdata
