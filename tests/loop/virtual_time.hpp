// Virtual time for tests of several loops, whose interleaving a seed chooses: RTDATA_TEST_SEED, or 1.
#pragma once

#include <cstdint>
#include <cstdlib>

#include "rtdata/loop/loop.hpp"

inline rtdata::Loop::Manual virtual_time() {
  const char* const wanted = std::getenv("RTDATA_TEST_SEED");
  return {.seed = wanted != nullptr ? std::strtoull(wanted, nullptr, 10) : 1};
}
