// Programs of tests that are killed.
#pragma once

#include <doctest/doctest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <functional>

namespace sinks {

/// How a process ends that does this, as waitpid tells it.
inline int status_of(const std::function<void()>& work) {
  const pid_t child = ::fork();
  if (child == 0) {
    work();
    ::_exit(1);
  }
  int status = 0;
  REQUIRE(::waitpid(child, &status, 0) == child);
  return status;
}

/// Does this in a process that it kills.
inline void killed_in(const std::function<void()>& work) { REQUIRE(WIFSIGNALED(status_of(work))); }

}  // namespace sinks
