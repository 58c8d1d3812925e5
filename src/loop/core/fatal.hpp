// The end of the program, for mistakes that no exception can report.
#pragma once

#include <cstdio>
#include <cstdlib>

#include "rtdata/data/error.hpp"

namespace rtdata::detail {

/// Says what is wrong on standard error, and aborts: going on would use what is gone.
[[noreturn, gnu::cold]] inline void end_program(const Error& error) noexcept {
  std::fprintf(stderr, "rtdata: fatal: %s\n", error.text().c_str());
  std::abort();
}

}  // namespace rtdata::detail
