// libmodbus, loaded when it is first needed: loaded_library.hpp.
#pragma once

#include <modbus.h>

#include "rtdata/detail/io/loaded_library.hpp"

#define RTDATA_LIBMODBUS(of) of(modbus_strerror)

RTDATA_LOADED_LIBRARY(libmodbus, RTDATA_LIBMODBUS, "type modbus", "libmodbus", "libmodbus5", "libmodbus.so.5")
