// Called when a C library gets no memory.
#pragma once

#include <new>

namespace rtdata::detail {

/// As `operator new` does: calls the new handler, which ends the program `rtdata`; without a handler it throws.
[[noreturn, gnu::cold]] inline void no_memory() {
  if (const std::new_handler handler = std::get_new_handler()) handler();
  throw std::bad_alloc();
}

}  // namespace rtdata::detail
