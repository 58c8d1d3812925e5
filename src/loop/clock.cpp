#include "rtdata/loop/clock.hpp"

#include <ctime>
#include <fstream>

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

std::string SystemClock::boot_id() {
  std::ifstream file("/proc/sys/kernel/random/boot_id");
  std::string id;
  std::getline(file, id);
  return id;
}

}  // namespace rtdata
