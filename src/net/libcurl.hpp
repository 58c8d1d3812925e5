// libcurl, loaded when it is first needed: loaded_library.hpp.
#pragma once

#include <curl/curl.h>

#include "rtdata/detail/io/loaded_library.hpp"

// clang-format off
#define RTDATA_LIBCURL(of) \
  of(curl_easy_cleanup) of(curl_easy_getinfo) of(curl_easy_init) of(curl_easy_perform) of(curl_easy_setopt) \
  of(curl_easy_strerror) of(curl_free) of(curl_global_init) of(curl_multi_add_handle) of(curl_multi_cleanup) \
  of(curl_multi_info_read) of(curl_multi_init) of(curl_multi_remove_handle) of(curl_multi_setopt) \
  of(curl_multi_socket_action) of(curl_multi_timeout) of(curl_slist_append) of(curl_slist_free_all) of(curl_url) \
  of(curl_url_cleanup) of(curl_url_get) of(curl_url_set) of(curl_version_info)
// clang-format on

RTDATA_LOADED_LIBRARY(libcurl, RTDATA_LIBCURL, "type http", "libcurl", "libcurl4", "libcurl.so.4",
                      "libcurl-gnutls.so.4")
