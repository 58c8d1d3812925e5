// The monotonic clock read through the processor's own counter, which costs less: between two reads of the kernel's
// clock the time is interpolated. For times of one after another of thousands of sensors.
#pragma once

#if defined(__x86_64__)
#include <x86intrin.h>
#endif

#include <ctime>

#include "rtdata/data/time.hpp"

namespace rtdata::detail {

/// Agrees with the kernel's clock within about 100 ns. If the kernel's clock does not use a readable counter, each call
/// reads the kernel's clock. If the counters of two processors differ, it is wrong by at most 100 us, and may go back
/// by that when the thread moves. One thread.
class CycleClock {
 public:
  CycleClock();

  MonotonicTime now() noexcept {
    if (!is_usable_) [[unlikely]]
      return kernel_time();
    const std::uint64_t since = cycles() - base_cycles_;
    if (since >= longest_) [[unlikely]]
      return read();
    return base_ + interpolated(since);
  }
  /// Reads the kernel's clock, and follows it from here on.
  MonotonicTime read() noexcept;

  static MonotonicTime kernel_time() noexcept {
    timespec spec;
    ::clock_gettime(CLOCK_MONOTONIC, &spec);
    return MonotonicTime{std::chrono::seconds{spec.tv_sec} + Duration{spec.tv_nsec}};
  }

 private:
  static constexpr int scale_bits = 32;
  static std::uint64_t cycles() noexcept {
#if defined(__x86_64__)
    return __rdtsc();
#elif defined(__aarch64__)
    std::uint64_t count;
    asm volatile("mrs %0, cntvct_el0" : "=r"(count));
    return count;
#else
    return 0;
#endif
  }
  Duration interpolated(std::uint64_t since) const noexcept {
    return Duration{static_cast<Duration::rep>((since * scale_) >> scale_bits)};
  }
  bool is_usable_;
  MonotonicTime base_{};
  std::uint64_t base_cycles_ = 0;
  std::uint64_t longest_ = 0;  // longest interpolation in cycles; 0: the rate is uncertain
  std::uint64_t scale_ = 0;    // ns per cycle, times 2^scale_bits
  // An earlier read, compared with later ones to get the rate.
  MonotonicTime compared_{};
  std::uint64_t compared_cycles_ = 0;
};

}  // namespace rtdata::detail
