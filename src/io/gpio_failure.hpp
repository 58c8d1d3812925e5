// Converts the kernel's answer for a GPIO line to an error.
#pragma once

#include <cerrno>
#include <string>

#include "rtdata/data/error.hpp"

namespace rtdata::detail {

inline Error gpio_failure(int error_number, const char* what, const std::string& place) {
  if (error_number == ENODEV || error_number == ENXIO || error_number == EIO)
    return {Errc::disconnected, what, place, "its chip is gone",
            "check the chip's plug or driver; it is opened again when it is back"};
  return system_error(error_number, what, place);
}

}  // namespace rtdata::detail
