// zlib, loaded when it is first needed: loaded_library.hpp.
#pragma once

#include <zlib.h>

#include "rtdata/detail/io/loaded_library.hpp"

// clang-format off
#define RTDATA_LIBZ(of) \
  of(deflate) of(deflateBound) of(deflateEnd) of(deflateInit2_) of(deflateReset)
// clang-format on

namespace rtdata {

RTDATA_LIBZ(RTDATA_LOADED_FUNCTION)

namespace detail {

inline constexpr const char* libz_sonames[] = {"libz.so.1"};
inline constexpr LoadedLibrary::Function libz_functions[] = {RTDATA_LIBZ(RTDATA_LOADED_NAME)};
inline constinit LoadedLibrary libz{"`compression`", "zlib", "zlib1g", libz_sonames, libz_functions};

}  // namespace detail
}  // namespace rtdata
