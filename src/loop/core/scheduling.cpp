#include "rtdata/loop/runtime.hpp"

#include <sched.h>

#include <cerrno>
#include <string>

#include "data/name_in.hpp"

namespace rtdata {
namespace {

int kernel_policy(SchedulingPolicy policy) noexcept {
  switch (policy) {
    case SchedulingPolicy::other:
      return SCHED_OTHER;
    case SchedulingPolicy::fifo:
      return SCHED_FIFO;
    case SchedulingPolicy::round_robin:
      return SCHED_RR;
  }
  return SCHED_OTHER;
}

}  // namespace

std::string_view name_of(SchedulingPolicy policy) noexcept {
  constexpr std::string_view names[] = {"other", "fifo", "rr"};
  return detail::name_in(names, policy);
}

PriorityRange priority_range(SchedulingPolicy policy) noexcept {
  const int kernel = kernel_policy(policy);
  return {::sched_get_priority_min(kernel), ::sched_get_priority_max(kernel)};
}

Scheduling current_scheduling() noexcept {
  sched_param parameters{};
  const int policy = ::sched_getscheduler(0) & ~SCHED_RESET_ON_FORK;
  ::sched_getparam(0, &parameters);
  switch (policy) {
    case SCHED_FIFO:
      return {SchedulingPolicy::fifo, parameters.sched_priority};
    case SCHED_RR:
      return {SchedulingPolicy::round_robin, parameters.sched_priority};
    default:
      return {SchedulingPolicy::other, 0};
  }
}

Result<void> set_scheduling(Scheduling scheduling) noexcept {
  const std::string wanted = std::string(name_of(scheduling.policy)) + " " + std::to_string(scheduling.priority);
  const PriorityRange range = priority_range(scheduling.policy);
  if (scheduling.priority < range.lowest || scheduling.priority > range.highest) {
    return Error{Errc::bad_argument, "cannot schedule as", wanted, "the priority is out of range",
                 "use " + std::to_string(range.lowest) + " to " + std::to_string(range.highest)};
  }
  sched_param parameters{};
  parameters.sched_priority = scheduling.priority;
  if (::sched_setscheduler(0, kernel_policy(scheduling.policy) | SCHED_RESET_ON_FORK, &parameters) == 0) return {};
  if (errno != EPERM) return system_error(errno, "cannot schedule as", wanted);
  return Error{Errc::not_permitted, "cannot schedule as", wanted, "the system does not permit it",
               "run `setcap cap_sys_nice,cap_ipc_lock+ep` on the program, or set `rtprio " +
                   std::to_string(scheduling.priority) + "` in /etc/security/limits.conf, or `LimitRTPRIO=" +
                   std::to_string(scheduling.priority) + "` in the systemd unit"};
}

}  // namespace rtdata
