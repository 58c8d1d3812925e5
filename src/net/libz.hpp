// zlib, loaded when it is first needed: loaded_library.hpp.
#pragma once

#include <zlib.h>

#include "rtdata/detail/io/loaded_library.hpp"

// clang-format off
#define RTDATA_LIBZ(of) \
  of(deflate) of(deflateBound) of(deflateEnd) of(deflateInit2_) of(deflateReset)
// clang-format on

RTDATA_LOADED_LIBRARY(libz, RTDATA_LIBZ, "`compression`", "zlib", "zlib1g", "libz.so.1")
