// Sets up the thread of a tier: name, processors, locked memory, policy, and a processor that stays awake.
#include <alloca.h>
#include <fcntl.h>
#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/tier/processors.hpp"
#include "loop/tier/tier_core.hpp"

namespace rtdata::detail {
namespace {

/// Touches this much of the stack, so that no page fault on it comes later.
[[gnu::noinline]] void touch_stack(std::size_t bytes) {
  auto* memory = static_cast<volatile char*>(alloca(bytes));
  for (std::size_t i = 0; i < bytes; i += 1024) memory[i] = 0;
}

/// How much of this thread's stack may still be touched.
std::size_t stack_left() {
  constexpr std::size_t reserve = 32 * 1024;  // for what is called before and after
  pthread_attr_t attributes;
  void* lowest = nullptr;
  std::size_t size = 0;
  if (::pthread_getattr_np(::pthread_self(), &attributes) != 0) return 0;
  ::pthread_attr_getstack(&attributes, &lowest, &size);
  ::pthread_attr_destroy(&attributes);
  const auto left = static_cast<std::size_t>(reinterpret_cast<char*>(&attributes) - static_cast<char*>(lowest));
  return left > reserve ? left - reserve : 0;
}

}  // namespace

void TierCore::set_up_thread() {
  ::pthread_setname_np(::pthread_self(), config.name.substr(0, 15).c_str());
  if (!config.cpus.empty()) {
    cpu_set_t asked;
    CPU_ZERO(&asked);
    for (const int cpu : config.cpus) CPU_SET(static_cast<std::size_t>(cpu), &asked);
    cpu_set_t granted, refused;
    if (::sched_setaffinity(0, sizeof asked, &asked) != 0) {
      warn({Errc::bad_argument, "cannot bind to processors", list_of(asked), std::strerror(errno),
            "name processors that this machine has and the process may use; until then the tier runs on any of those"});
    } else if (::sched_getaffinity(0, sizeof granted, &granted) == 0 && !CPU_EQUAL(&asked, &granted)) {
      CPU_XOR(&refused, &asked, &granted);  // those granted are among those asked for
      warn({Errc::bad_argument, "cannot bind to processors", list_of(refused),
            "this machine does not have them, or the process may not use them",
            "use processors that there are; the tier runs on " + list_of(granted)});
    }
  }
  const bool is_real_time = config.policy != SchedulingPolicy::other;
  if (is_real_time) {
    // Locks present pages, and later ones when they are first used. Without MCL_ONFAULT each new thread would get its
    // whole stack at once, which delays all other threads.
    if (config.lock_memory && ::mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) != 0) {
      warn({Errc::not_permitted, "cannot lock memory", "mlockall", std::strerror(errno),
            "set `memlock unlimited` in /etc/security/limits.conf or `LimitMEMLOCK=infinity` in the systemd unit; the "
            "tier runs with memory that is not locked"});
    }
    touch_stack(std::min(config.stack, stack_left()));
    if (auto set = set_scheduling({config.policy, config.priority}); !set) warn(set.error());
  }
  if (config.keep_cpu_awake) {
    latency_fd_ = ::open("/dev/cpu_dma_latency", O_WRONLY | O_CLOEXEC);
    const std::int32_t microseconds = 0;
    if (latency_fd_ < 0 || ::write(latency_fd_, &microseconds, sizeof microseconds) != sizeof microseconds) {
      warn({Errc::not_permitted, "cannot keep the processor awake", "/dev/cpu_dma_latency", std::strerror(errno),
            "give the user write access to it, by a udev rule; the tier runs with deeper idle states"});
    }
  }
  scheduling = current_scheduling();
}

void TierCore::warn(const Error& error) {
  warnings.push_back(error.text());
  if (std::find(told_.begin(), told_.end(), warnings.back()) != told_.end()) return;  // at an earlier start
  told_.push_back(warnings.back());
  main.core().post([&hub = main.core().runtime, name = "tier " + config.name, text = error.text(),
                    id = std::string(error.id())] { hub.log(LogLevel::warning, name, text, id); });
}

}  // namespace rtdata::detail
