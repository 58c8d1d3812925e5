// What both sensors of IIO devices need.
#pragma once

#include <string>
#include <vector>

#include "io/kernel_file.hpp"

namespace rtdata::detail {

/// The lane of a device, by what the configuration calls it.
std::string iio_lane(const std::string& device, const std::string& root);
/// SetupError: no device, or channels that are none.
void check_iio(const std::string& device, const std::vector<std::string>& channels, const std::string& name);

}  // namespace rtdata::detail
