// Sums and differences of times and durations that saturate at the limits.
#pragma once

#include <chrono>
#include <cstdint>

#include "rtdata/data/time.hpp"

namespace rtdata::detail {

/// `at` plus `span`, saturated.
template <class Clock>
constexpr std::chrono::time_point<Clock, Duration> later(std::chrono::time_point<Clock, Duration> at,
                                                         Duration span) noexcept {
  using Point = std::chrono::time_point<Clock, Duration>;
  std::int64_t sum = 0;
  if (__builtin_add_overflow(at.time_since_epoch().count(), span.count(), &sum)) [[unlikely]]
    return span.count() > 0 ? Point::max() : Point::min();
  return Point{Duration{sum}};
}

/// `to` minus `from`, saturated.
constexpr Duration difference(Duration from, Duration to) noexcept {
  std::int64_t span = 0;
  if (__builtin_sub_overflow(to.count(), from.count(), &span)) [[unlikely]]
    return to > from ? Duration::max() : Duration::min();
  return Duration{span};
}

/// The duration from one time to another, saturated.
template <class Clock>
constexpr Duration span_between(std::chrono::time_point<Clock, Duration> from,
                                std::chrono::time_point<Clock, Duration> to) noexcept {
  return difference(from.time_since_epoch(), to.time_since_epoch());
}

/// `count` times a duration that is not negative, saturated.
constexpr Duration multiple(std::int64_t count, Duration span) noexcept {
  std::int64_t product = 0;
  return __builtin_mul_overflow(span.count(), count, &product) ? Duration::max() : Duration{product};
}

/// True if `due` has come; the largest time never comes.
constexpr bool has_come(MonotonicTime due, MonotonicTime now) noexcept {
  return due <= now && due != MonotonicTime::max();
}

}  // namespace rtdata::detail
