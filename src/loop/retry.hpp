// When to try again.
#pragma once

#include <cstdint>
#include <functional>
#include <string_view>

#include "rtdata/data/time.hpp"

namespace rtdata::detail {

/// The next delay after this one: twice as long, to the longest. One that is negative stays none.
inline Duration doubled(Duration delay, Duration longest) noexcept {
  const Duration now = delay.count() > 0 ? delay : Duration{0};
  return now > longest / 2 ? longest : 2 * now;
}

/// The delay less up to a quarter of it, which depends on who waits and how often that failed: many that fail together
/// do not come back in step.
inline Duration with_jitter(Duration delay, std::string_view who, std::uint64_t failures) noexcept {
  if (delay.count() <= 0) return Duration{0};
  const std::uint64_t hash = std::hash<std::string_view>{}(who) + failures * 2654435761u;
  const auto part = static_cast<std::int64_t>(hash % 1024);
  const Duration quarter = delay / 4;
  return delay - (quarter > Duration::max() / 1024 ? quarter / 1024 * part : quarter * part / 1024);
}

}  // namespace rtdata::detail
