// Sets of processors.
#pragma once

#include <sched.h>

#include <string>

namespace rtdata::detail {

/// "0, 2-5"
inline std::string list_of(const cpu_set_t& set) {
  std::string list;
  for (std::size_t cpu = 0; cpu < CPU_SETSIZE; ++cpu) {
    if (!CPU_ISSET(cpu, &set)) continue;
    const std::size_t first = cpu;
    while (cpu + 1 < CPU_SETSIZE && CPU_ISSET(cpu + 1, &set)) ++cpu;
    list += (list.empty() ? "" : ", ") + std::to_string(first);
    if (cpu > first) list += (cpu > first + 1 ? "-" : ", ") + std::to_string(cpu);
  }
  return list;
}

/// The processors that a thread of this process may be bound to. These may be more than it runs on: those kept free by
/// `isolcpus`, or by `taskset`.
inline cpu_set_t bindable_processors() noexcept {
  cpu_set_t own, all;
  CPU_ZERO(&own);
  CPU_ZERO(&all);
  for (std::size_t cpu = 0; cpu < CPU_SETSIZE; ++cpu) CPU_SET(cpu, &all);
  if (::sched_getaffinity(0, sizeof own, &own) != 0) return own;
  cpu_set_t bindable = own;
  if (::sched_setaffinity(0, sizeof all, &all) == 0) ::sched_getaffinity(0, sizeof bindable, &bindable);
  ::sched_setaffinity(0, sizeof own, &own);
  return bindable;
}

}  // namespace rtdata::detail
