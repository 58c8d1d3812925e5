// libmodbus, loaded when it is first needed: loaded_library.hpp.
#pragma once

#include <modbus.h>

#include "rtdata/detail/io/loaded_library.hpp"

#define RTDATA_LIBMODBUS(of) of(modbus_strerror)

namespace rtdata {

RTDATA_LIBMODBUS(RTDATA_LOADED_FUNCTION)

namespace detail {

inline constexpr const char* libmodbus_sonames[] = {"libmodbus.so.5"};
inline constexpr LoadedLibrary::Function libmodbus_functions[] = {RTDATA_LIBMODBUS(RTDATA_LOADED_NAME)};
inline constinit LoadedLibrary libmodbus{"type modbus", "libmodbus", "libmodbus5", libmodbus_sonames,
                                         libmodbus_functions};

}  // namespace detail
}  // namespace rtdata
