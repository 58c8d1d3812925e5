// Inputs of the kernel's hwmon chips (Documentation/hwmon/sysfs-interface.rst), found by the chip's name and the
// input's label. All functions block while they list directories.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/error.hpp"

namespace rtdata::detail {

struct HwmonInput {
  std::string device;                    ///< "coretemp/temp2": as HostConfig names it
  std::string name;                      ///< for display: "coretemp Core 0"
  std::string value;                     ///< the file
  std::string fault = {};                ///< the file; empty: there is none
  std::vector<std::string> alarms = {};  ///< the files
};

/// Those that begin with `prefix`, such as "temp", in the order of their numbers.
std::vector<HwmonInput> hwmon_inputs(const std::string& root, std::string_view prefix);
/// The input named `device`: CHIP/INPUT, or CHIP if it has only one. CHIP is the chip's name, its device ("1-0048") or
/// its folder ("hwmon0"); INPUT is its label or file name ("temp1"). Empty: the only one. Errors: not-found,
/// bad-argument (several), with a list.
Result<HwmonInput> find_hwmon(const std::string& root, std::string_view prefix, const std::string& device);

}  // namespace rtdata::detail
