// libmosquitto, loaded when it is first needed: loaded_library.hpp.
#pragma once

#include <mosquitto.h>

#include "rtdata/detail/io/loaded_library.hpp"

// clang-format off
#define RTDATA_LIBMOSQUITTO(of) \
  of(mosquitto_connack_string) of(mosquitto_connect) of(mosquitto_connect_bind_v5) \
  of(mosquitto_connect_v5_callback_set) of(mosquitto_destroy) of(mosquitto_disconnect_v5) \
  of(mosquitto_disconnect_v5_callback_set) of(mosquitto_int_option) of(mosquitto_lib_init) \
  of(mosquitto_log_callback_set) of(mosquitto_loop_misc) of(mosquitto_loop_read) \
  of(mosquitto_loop_write) of(mosquitto_message_v5_callback_set) of(mosquitto_new) \
  of(mosquitto_property_add_int32) of(mosquitto_property_free_all) of(mosquitto_publish_v5) \
  of(mosquitto_publish_v5_callback_set) of(mosquitto_reason_string) of(mosquitto_socket) of(mosquitto_ssl_get) \
  of(mosquitto_strerror) of(mosquitto_sub_topic_check) of(mosquitto_subscribe_multiple) \
  of(mosquitto_subscribe_v5_callback_set) of(mosquitto_threaded_set) of(mosquitto_tls_opts_set) \
  of(mosquitto_tls_set) of(mosquitto_userdata) of(mosquitto_username_pw_set) of(mosquitto_want_write) \
  of(mosquitto_will_set)
// clang-format on

RTDATA_LOADED_LIBRARY(libmosquitto, RTDATA_LIBMOSQUITTO, "type mqtt", "libmosquitto", "libmosquitto1",
                      "libmosquitto.so.1")
