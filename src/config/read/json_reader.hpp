/// The JSON format. Private to src/config; users get it from ConfigFormats.
#pragma once

#include <memory>

#include "rtdata/config/format.hpp"

namespace rtdata {

std::unique_ptr<ConfigFormat> make_json_format();

}  // namespace rtdata
