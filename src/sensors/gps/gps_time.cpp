#include "sensors/gps/gps_time.hpp"

#include <algorithm>
#include <string_view>

#include "data/saturating.hpp"

namespace rtdata::detail {
namespace {

static_assert(std::string_view(this_release.version) == RTDATA_VERSION,
              "a new version: set the date of its release, too");
constexpr Time made{std::chrono::sys_days{this_release.date}};
constexpr Time latest{std::chrono::sys_days{this_release.date + std::chrono::years{10}}};

Duration size_of(Duration duration) noexcept { return duration < Duration{0} ? difference(duration, {}) : duration; }

}  // namespace

GpsTimeCheck::Verdict GpsTimeCheck::look_at(MonotonicTime at, Time time, Duration delay, Duration accuracy,
                                            const SystemTime& system) noexcept {
  /// By how much they are further apart in arrival than in time, or less.
  const auto differ = [&](const Report& before) {
    return size_of(difference(span_between(before.time, time), span_between(before.at, at)));
  };
  if (agreeing_ > 0) {
    const Report& last = reports_[(agreeing_ - 1) % enough];
    if (time == last.time) return Verdict::open;  // more of the same fix
    if (time < last.time || differ(last) > delay) agreeing_ = 0;
  }
  reports_[agreeing_++ % enough] = {at, time};
  if (agreeing_ < enough) return Verdict::open;
  const Report& first = reports_[agreeing_ % enough];
  if (differ(first) > std::min(delay, span_between(first.time, time) / 2)) return Verdict::open;
  if (system.accuracy) {
    const Duration apart = size_of(span_between(system.time, time));
    return apart > later(Time{*system.accuracy}, accuracy).time_since_epoch() ? Verdict::other_clock : Verdict::good;
  }
  return time < made || time >= latest ? Verdict::other_age : Verdict::good;
}

}  // namespace rtdata::detail
