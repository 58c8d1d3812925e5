// When to try again.
#pragma once

#include <cstdint>
#include <functional>
#include <string_view>

#include "rtdata/data/time.hpp"

namespace rtdata::detail {

/// The next delay: twice as long, up to the longest. A negative delay is not changed.
inline Duration doubled(Duration delay, Duration longest) noexcept {
  const Duration now = delay.count() > 0 ? delay : Duration{0};
  return now > longest / 2 ? longest : 2 * now;
}

/// The delay minus up to a quarter, depending on the name of the object and the number of failures, so that objects
/// that fail together do not retry together.
inline Duration with_jitter(Duration delay, std::string_view who, std::uint64_t failures) noexcept {
  if (delay.count() <= 0) return Duration{0};
  const std::uint64_t hash = std::hash<std::string_view>{}(who) + failures * 2654435761u;
  const auto part = static_cast<std::int64_t>(hash % 1024);
  const Duration quarter = delay / 4;
  return delay - (quarter > Duration::max() / 1024 ? quarter / 1024 * part : quarter * part / 1024);
}

/// The retry delays of one object: the first, then twice as long each time, up to the longest, with jitter.
class Backoff {
 public:
  /// `name`: of the object.
  Duration next(Duration first, Duration longest, std::string_view name) noexcept {
    delay_ = delay_.count() == 0 ? first : doubled(delay_, longest);
    return with_jitter(delay_, name, ++failures_);
  }
  /// The last delay, without jitter; 0: no failure since the last success.
  Duration last() const noexcept { return delay_; }
  /// After a success: the next delay is the first again.
  void reset() noexcept { delay_ = Duration{0}; }

 private:
  Duration delay_{0};
  std::uint64_t failures_ = 0;
};

}  // namespace rtdata::detail
