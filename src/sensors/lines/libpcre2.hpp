// PCRE2, loaded when it is first needed: loaded_library.hpp.
#pragma once

#define PCRE2_CODE_UNIT_WIDTH 8
#include <pcre2.h>

#include "rtdata/detail/io/loaded_library.hpp"

// clang-format off
#define RTDATA_LIBPCRE2(of) \
  of(pcre2_code_free_8) of(pcre2_compile_8) of(pcre2_get_error_message_8) of(pcre2_get_ovector_pointer_8) \
  of(pcre2_match_8) of(pcre2_match_context_create_8) of(pcre2_match_context_free_8) \
  of(pcre2_match_data_create_from_pattern_8) of(pcre2_match_data_free_8) of(pcre2_pattern_info_8) \
  of(pcre2_set_callout_8) of(pcre2_set_heap_limit_8) of(pcre2_set_match_limit_8)
// clang-format on

RTDATA_LOADED_LIBRARY(libpcre2, RTDATA_LIBPCRE2, "`pattern`", "PCRE2", "libpcre2-8-0", "libpcre2-8.so.0")
