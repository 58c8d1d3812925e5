/// Ranges in words. Private to src/config.
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "rtdata/detail/config/parameter_info.hpp"

namespace rtdata::config_detail {

/// "0 to 255", "at least 1 ms", "at most 10 kHz", "" without limits.
std::string range_text(std::optional<double> least, std::optional<double> most, ParameterType::Kind kind,
                       std::string_view unit);

}  // namespace rtdata::config_detail
