/// What counts as one instant.
#pragma once

#include <chrono>

#include "rtdata/data/time.hpp"

namespace rtdata {

/// Times nearer than this are one instant, of which the last value counts, for whatever divides by a time: lines that
/// USB brings in one packet come 1 ns apart, and are not.
constexpr Duration one_instant = std::chrono::microseconds{1};

}  // namespace rtdata
