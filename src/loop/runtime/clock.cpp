#include "rtdata/loop/clock.hpp"

#include <sys/timex.h>

#include <algorithm>
#include <ctime>

#include "data/first_line.hpp"
#include "data/saturating.hpp"
#include "loop/core/virtual_threads.hpp"

namespace rtdata {
namespace {

Duration read_clock(clockid_t id) noexcept {
  timespec spec;
  ::clock_gettime(id, &spec);
  return std::chrono::seconds{spec.tv_sec} + Duration{spec.tv_nsec};
}

}  // namespace

MonotonicTime SystemClock::monotonic() noexcept { return MonotonicTime{read_clock(CLOCK_MONOTONIC)}; }
Time SystemClock::realtime() noexcept { return Time{read_clock(CLOCK_REALTIME)}; }

std::string SystemClock::boot_id() { return detail::first_line("/proc/sys/kernel/random/boot_id"); }

std::optional<Duration> SystemClock::accuracy() noexcept {
  constexpr Duration least = std::chrono::milliseconds{1};  // some tell the kernel 0 and mean "set just now"
  timex now{};                                              // modes 0: only reads
  if (::adjtimex(&now) < 0 || (now.status & STA_UNSYNC) != 0) return std::nullopt;
  return std::max<Duration>(least, std::chrono::microseconds{std::max(now.maxerror, now.esterror)});
}

std::string ManualClock::boot_id() {
  if (boot_id_.empty()) boot_id_ = "manual " + detail::first_line("/proc/sys/kernel/random/uuid");
  return boot_id_;
}

Duration SystemClock::suspended() noexcept {
  // Again if the thread was interrupted in between, which would look like a suspension.
  constexpr Duration close_enough = std::chrono::microseconds{100};
  Duration best{0}, narrowest = Duration::max();
  for (int tries = 0; tries < 10 && narrowest > close_enough; ++tries) {
    const Duration before = read_clock(CLOCK_MONOTONIC), with = read_clock(CLOCK_BOOTTIME);
    const Duration width = read_clock(CLOCK_MONOTONIC) - before;
    if (width >= narrowest) continue;
    narrowest = width;
    best = with - before - width / 2;
  }
  return best;
}

void ManualClock::pass(Duration duration) noexcept {
  if (duration.count() <= 0) return;
  if (threads_ != nullptr) return threads_->sleep(duration);
  move(duration);
}

void ManualClock::suspend(Duration duration) noexcept {
  if (duration.count() <= 0) return;
  realtime_ = detail::later(realtime_, duration);
  suspended_ = detail::later(Time{suspended_}, duration).time_since_epoch();
}

void ManualClock::move(Duration duration) noexcept {
  monotonic_ = detail::later(monotonic_, duration);
  realtime_ = detail::later(realtime_, duration);
}

}  // namespace rtdata
