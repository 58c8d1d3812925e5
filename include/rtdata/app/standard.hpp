/// The sensor and sink types that come with the library. Target: rtdata::program.
#pragma once

#include "rtdata/config/registry.hpp"

namespace rtdata {

Registry standard_registry();

}  // namespace rtdata
