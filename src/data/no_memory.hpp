// What is done when a library in C has got no memory.
#pragma once

#include <new>

namespace rtdata::detail {

/// As `operator new` does: asks the new handler, with which the program `rtdata` ends; without one it throws.
[[noreturn, gnu::cold]] inline void no_memory() {
  if (const std::new_handler handler = std::get_new_handler()) handler();
  throw std::bad_alloc();
}

}  // namespace rtdata::detail
