// What both sensors of IIO devices need.
#pragma once

#include <string>
#include <vector>

#include "io/kernel_file.hpp"

namespace rtdata::detail {

/// The lane of a device, found by its name in the configuration.
std::string iio_lane(const std::string& device, const std::string& root);
/// SetupError: no device, or invalid channels.
void check_iio(const std::string& device, const std::vector<std::string>& channels, const std::string& name);

}  // namespace rtdata::detail
