#include "loop/core/cycle_clock.hpp"

#include <algorithm>
#include <cmath>

#include "data/first_line.hpp"

namespace rtdata::detail {
namespace {

constexpr Duration longest_interpolation = std::chrono::microseconds{100};
// Between two reads this far apart the rate is exact enough, and follows the kernel's corrections of its clock.
constexpr Duration shortest_comparison = std::chrono::milliseconds{10};
constexpr Duration longest_comparison = std::chrono::seconds{10};
constexpr Duration longest_read = std::chrono::microseconds{1};  // more: the thread was interrupted in it
constexpr int most_attempts = 3;
constexpr double largest_scale = 0x1p62;
constexpr double largest_change = 1e-3;  // of the rate; more: the machine slept, or the counter is another one now

}  // namespace

CycleClock::CycleClock() {
  const std::string source = first_line("/sys/devices/system/clocksource/clocksource0/current_clocksource");
#if defined(__x86_64__)
  is_usable_ = source == "tsc";
#elif defined(__aarch64__)
  is_usable_ = source == "arch_sys_counter";
#else
  is_usable_ = false;
#endif
}

MonotonicTime CycleClock::read() noexcept {
  if (!is_usable_) return kernel_time();
  std::uint64_t before = 0;
  std::uint64_t after = 0;
  MonotonicTime time;
  bool was_interrupted = true;
  const int attempts = longest_ != 0 ? most_attempts : 1;  // one attempt while the rate is uncertain
  for (int attempt = 0; attempt < attempts && was_interrupted; ++attempt) {
    before = cycles();
    time = kernel_time();
    after = cycles();
    was_interrupted = interpolated(after - before) > longest_read;
  }
  const MonotonicTime latest = base_ + interpolated(std::min(before - base_cycles_, longest_));
  base_ = std::max(time, latest);
  base_cycles_ = after;

  const Duration elapsed = time - compared_;
  if (was_interrupted) {
    longest_ = 0;
    if (elapsed > longest_comparison) scale_ = 0;  // the rate may be wrong
    return base_;
  }
  if (elapsed < shortest_comparison) return base_;
  bool is_steady = false;
  if (elapsed <= longest_comparison && after != compared_cycles_) {
    const double scale = std::ldexp(static_cast<double>(elapsed.count()), scale_bits) /
                         static_cast<double>(after - compared_cycles_);
    const double known = static_cast<double>(scale_);
    is_steady = std::abs(scale - known) <= largest_change * known;
    scale_ = scale < largest_scale ? static_cast<std::uint64_t>(scale) : 0;
  }
  longest_ = is_steady && scale_ != 0
                 ? (static_cast<std::uint64_t>(longest_interpolation.count()) << scale_bits) / scale_
                 : 0;
  compared_ = time;
  compared_cycles_ = after;
  return base_;
}

}  // namespace rtdata::detail
