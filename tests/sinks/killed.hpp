// Programs of tests that are killed.
#pragma once

#include <doctest/doctest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <functional>
#include <iterator>
#include <utility>

#include "sanitized.hpp"

namespace sinks {

/// A child that may start threads. The thread sanitizer ends one whose parent had threads, such as one of a loop that
/// has just gone, and with the address sanitizer it waits for ever for the allocator that such a thread was using when
/// it was forked: those are waited for, if they end at all.
inline pid_t fork_without_threads() {
  static std::ptrdiff_t lasting = rtdata::test::thread_sanitized ? 2 : 1;  // this one, and the thread sanitizer's
  std::ptrdiff_t before = 0;
  for (int i = 0;; ++i) {
    const auto threads = std::distance(std::filesystem::directory_iterator("/proc/self/task"), {});
    if (threads <= lasting) break;
    if (std::exchange(before, threads) > threads) i = 0;
    if (i == 500) {  // such as those of libuv's pool: another time they are not waited for
      lasting = threads;
      break;
    }
    ::usleep(1000);
  }
  return ::fork();
}

/// How a process ends that does this, as waitpid tells it.
inline int status_of(const std::function<void()>& work) {
  const pid_t child = fork_without_threads();
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
