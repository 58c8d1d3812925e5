#include "rtdata/loop/clock.hpp"

#include <ctime>

#include "loop/first_line.hpp"

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

}  // namespace rtdata
