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

RTDATA_LOADED_LIBRARY(libmicrohttpd, RTDATA_LIBMICROHTTPD, "the page", "libmicrohttpd", "libmicrohttpd12",
                      "libmicrohttpd.so.12")
