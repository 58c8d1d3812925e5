// The error for a thread that the system refuses to create.
#pragma once

#include <string>
#include <utility>

#include "rtdata/data/error.hpp"

namespace rtdata::detail {

inline Error no_thread(std::string what, std::string where) {
  return {Errc::io_failed, std::move(what), std::move(where), "the system gives no thread",
          "raise the thread limit (in a shell `ulimit -u`, of a service `TasksMax=`) or the memory limit (`ulimit -v`, "
          "`MemoryMax=`)"};
}

}  // namespace rtdata::detail
