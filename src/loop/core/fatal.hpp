// Ends the program for mistakes that no exception can report.
#pragma once

#include <cstdio>
#include <cstdlib>

#include "rtdata/data/error.hpp"

namespace rtdata::detail {

/// Writes the error to standard error and aborts, because continuing would use destroyed objects.
[[noreturn, gnu::cold]] inline void end_program(const Error& error) noexcept {
  std::fprintf(stderr, "rtdata: fatal: %s\n", error.text_with_id().c_str());
  std::abort();
}

}  // namespace rtdata::detail
