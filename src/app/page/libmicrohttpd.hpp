// libmicrohttpd, loaded when it is first needed: loaded_library.hpp.
#pragma once

#include <microhttpd.h>

#include "rtdata/detail/io/loaded_library.hpp"

// clang-format off
#define RTDATA_LIBMICROHTTPD(of) \
  of(MHD_add_response_header) of(MHD_create_response_from_buffer) of(MHD_create_response_from_callback) \
  of(MHD_destroy_response) of(MHD_get_connection_info) of(MHD_get_daemon_info) of(MHD_get_timeout) \
  of(MHD_is_feature_supported) of(MHD_lookup_connection_value) of(MHD_queue_response) of(MHD_resume_connection) \
  of(MHD_run) of(MHD_set_connection_option) of(MHD_start_daemon) of(MHD_stop_daemon) of(MHD_suspend_connection)
// clang-format on

namespace rtdata {

RTDATA_LIBMICROHTTPD(RTDATA_LOADED_FUNCTION)

namespace detail {

inline constexpr const char* libmicrohttpd_sonames[] = {"libmicrohttpd.so.12"};
inline constexpr LoadedLibrary::Function libmicrohttpd_functions[] = {RTDATA_LIBMICROHTTPD(RTDATA_LOADED_NAME)};
inline constinit LoadedLibrary libmicrohttpd{"the page", "libmicrohttpd", "libmicrohttpd12", libmicrohttpd_sonames,
                                             libmicrohttpd_functions};

}  // namespace detail
}  // namespace rtdata
