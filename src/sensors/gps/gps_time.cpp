#include "sensors/gps/gps_time.hpp"

#include <chrono>

#include "loop/support/deadline.hpp"

namespace rtdata::detail {
namespace {

constexpr int enough = 5;
// The 1024 weeks in which this is taken to be used: a receiver that counts them wrongly is outside, whatever it is off
// by.
constexpr Time earliest{std::chrono::seconds{1'735'689'600}};  // 2025-01-01
constexpr Time latest = earliest + std::chrono::hours{24 * 7 * 1024};
// A clock that nobody keeps right, and that was set since then, may be off by so much: a board without a battery that
// was off.
constexpr Duration most_asleep = std::chrono::hours{24 * 365 * 5};
// A clock that is kept right is believed before a receiver that differs by more than this and what both admit.
constexpr Duration most_difference = std::chrono::milliseconds{500};

Duration size_of(Duration duration) noexcept { return duration < Duration{0} ? -duration : duration; }

}  // namespace

bool GpsTimeCheck::accepts(MonotonicTime at, Time time, Duration delay, const SystemTime& system) noexcept {
  const Duration apart = size_of(difference(time.time_since_epoch(), system.time.time_since_epoch()));
  const Duration most_apart = system.accuracy
                                  ? later(MonotonicTime{*system.accuracy}, delay + most_difference).time_since_epoch()
                              : system.time >= earliest ? most_asleep
                                                        : Duration::max();
  const bool is_plausible = time >= earliest && time < latest && apart <= most_apart;
  if (!is_plausible) {
    agreeing_ = 0;
    return false;
  }
  if (agreeing_ > 0 && time == last_time_) return agreeing_ >= enough;  // more of the same fix
  const bool agrees = agreeing_ > 0 && time > last_time_ && size_of((time - last_time_) - (at - last_at_)) <= delay;
  agreeing_ = agrees ? agreeing_ + 1 : 1;
  last_at_ = at;
  last_time_ = time;
  return agreeing_ >= enough;
}

}  // namespace rtdata::detail
