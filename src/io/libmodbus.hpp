// libmodbus, loaded when it is first needed: loaded_library.hpp.
#pragma once

#include <modbus.h>

#include "io/loaded_library.hpp"

// clang-format off
#define RTDATA_LIBMODBUS(of) \
  of(modbus_flush) of(modbus_free) of(modbus_new_rtu) of(modbus_read_bits) \
  of(modbus_read_input_bits) of(modbus_read_input_registers) of(modbus_read_registers) of(modbus_set_byte_timeout) \
  of(modbus_set_response_timeout) of(modbus_set_slave) of(modbus_set_socket) of(modbus_strerror) \
  of(modbus_write_bit) of(modbus_write_register) of(modbus_write_registers)
// clang-format on

namespace rtdata {

RTDATA_LIBMODBUS(RTDATA_LOADED_FUNCTION)

namespace detail {

inline constexpr const char* libmodbus_sonames[] = {"libmodbus.so.5"};
inline constexpr LoadedLibrary::Function libmodbus_functions[] = {RTDATA_LIBMODBUS(RTDATA_LOADED_NAME)};
inline constinit LoadedLibrary libmodbus{"type modbus", "libmodbus", "libmodbus5", libmodbus_sonames,
                                         libmodbus_functions};

}  // namespace detail
}  // namespace rtdata
