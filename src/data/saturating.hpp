// Sums and differences of instants and spans: what would not fit is the first or the last that does.
#pragma once

#include <chrono>
#include <cstdint>

#include "rtdata/data/time.hpp"

namespace rtdata::detail {

/// `span` after `at`, or as late, or as early, as can be said.
template <class Clock>
constexpr std::chrono::time_point<Clock, Duration> later(std::chrono::time_point<Clock, Duration> at,
                                                         Duration span) noexcept {
  using Point = std::chrono::time_point<Clock, Duration>;
  std::int64_t sum = 0;
  if (__builtin_add_overflow(at.time_since_epoch().count(), span.count(), &sum)) [[unlikely]]
    return span.count() > 0 ? Point::max() : Point::min();
  return Point{Duration{sum}};
}

/// What one span is longer than another, or as much as can be said.
constexpr Duration difference(Duration from, Duration to) noexcept {
  std::int64_t span = 0;
  if (__builtin_sub_overflow(to.count(), from.count(), &span)) [[unlikely]]
    return to > from ? Duration::max() : Duration::min();
  return Duration{span};
}

/// From one instant to another, or as long as can be said.
template <class Clock>
constexpr Duration span_between(std::chrono::time_point<Clock, Duration> from,
                                std::chrono::time_point<Clock, Duration> to) noexcept {
  return difference(from.time_since_epoch(), to.time_since_epoch());
}

/// So many times a span that is not negative, or as long as can be said.
constexpr Duration multiple(std::int64_t count, Duration span) noexcept {
  std::int64_t product = 0;
  return __builtin_mul_overflow(span.count(), count, &product) ? Duration::max() : Duration{product};
}

/// The end of time never comes: what is due then is never due.
constexpr bool has_come(MonotonicTime due, MonotonicTime now) noexcept {
  return due <= now && due != MonotonicTime::max();
}

}  // namespace rtdata::detail
