/// Scheduling: the policy and priority of threads, as the kernel keeps them (sched(7)).
///
///     rtdata::PriorityRange range = rtdata::priority_range(rtdata::SchedulingPolicy::fifo);   // 1 to 99
///     if (auto set = rtdata::set_scheduling({rtdata::SchedulingPolicy::fifo, 80}); !set)
///       std::cerr << set.error().text();
///
/// Real-time policies need permission: run as root, or with CAP_SYS_NICE (`setcap cap_sys_nice,cap_ipc_lock+ep
/// PROGRAM`), or with `rtprio` in /etc/security/limits.conf, or `LimitRTPRIO=` in a systemd unit.
///
/// Values and free functions; each acts on the thread that calls it.
#pragma once

#include <cstdint>
#include <string_view>

#include "rtdata/data/error.hpp"

namespace rtdata {

enum class SchedulingPolicy : std::uint8_t {
  other,        ///< SCHED_OTHER: shares the processor fairly
  fifo,         ///< SCHED_FIFO: runs until it waits, before all of lower priority
  round_robin,  ///< SCHED_RR: as fifo, taking turns with those of its priority
};
std::string_view name_of(SchedulingPolicy policy) noexcept;

struct Scheduling {
  SchedulingPolicy policy = SchedulingPolicy::other;
  int priority = 0;  ///< 0 for `other`, else within `priority_range`
};

struct PriorityRange {
  int lowest = 0;
  int highest = 0;
};
PriorityRange priority_range(SchedulingPolicy policy) noexcept;

/// The scheduling of the calling thread.
Scheduling current_scheduling() noexcept;

/// Sets that of the calling thread. Threads that it makes afterwards begin as SCHED_OTHER (SCHED_RESET_ON_FORK).
/// Errors: not-permitted, which says what to set; bad-argument for a priority out of range.
Result<void> set_scheduling(Scheduling scheduling) noexcept;

}  // namespace rtdata
