/// Time: points, spans, rates, and their text.
///
/// Everything is std::chrono with a resolution of one nanosecond. `Time` is the time of an event, counted from the
/// Unix epoch (UTC, leap seconds not counted); `MonotonicTime` is the line on which sampling is scheduled, which never
/// jumps. Comparison, sum and difference are those of std::chrono; convert with `std::chrono::duration_cast`.
///
///     rtdata::Time landed = rtdata::parse_iso8601("2024-05-04T10:20:30Z").or_throw();
///     rtdata::Duration flight = landed - launched;            // std::chrono::nanoseconds
///     rtdata::to_string(rtdata::Rate::hertz(50).period());    // "20 ms"
///
/// Values; any thread.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <string_view>

#include "rtdata/data/error.hpp"

namespace rtdata {

using Duration = std::chrono::nanoseconds;
/// ns since the Unix epoch.
using Time = std::chrono::time_point<std::chrono::system_clock, Duration>;
/// CLOCK_MONOTONIC: ns since an unspecified start (of the machine).
using MonotonicTime = std::chrono::time_point<std::chrono::steady_clock, Duration>;

constexpr std::int64_t to_nanoseconds(Time time) noexcept { return time.time_since_epoch().count(); }
constexpr Time from_nanoseconds(std::int64_t since_epoch) noexcept { return Time{Duration{since_epoch}}; }

/// The time of day by the machine's real-time clock. It may jump: events use their loop's clock instead.
Time wall_clock_now() noexcept;

/// "2026-03-01T12:00:00.123456789Z". Nine decimals; years before 0000 or after 9999 do not occur in 64-bit ns.
std::string to_iso8601(Time time);
/// Reads what `to_iso8601` writes, with any number of decimals up to nine, also without seconds, "Z" or an offset such
/// as "+02:00".
Result<Time> parse_iso8601(std::string_view text);

/// A positive number of events a second: `100_Hz`, `Rate::from_period(10ms)`. Or no rate: then it converts to false,
/// and code that needs a rate refuses it.
class Rate {
 public:
  constexpr Rate() = default;
  /// No rate if `value` is not greater than 0, not a number, or above 2 GHz. The longest period is 292 years.
  static constexpr Rate hertz(double value) {
    if (!(value > 0)) return Rate{};
    const double period = 1e9 / value + 0.5;
    constexpr double too_long = 9223372036854775808.0;  // 2^63
    return Rate{period < too_long ? Duration{static_cast<std::int64_t>(period)} : Duration::max()};
  }
  static constexpr Rate from_period(Duration period) { return Rate{period}; }
  /// ns between two events; 0 means "no rate".
  constexpr Duration period() const noexcept { return period_; }
  constexpr double hertz() const noexcept {
    return period_.count() == 0 ? 0.0 : 1e9 / static_cast<double>(period_.count());
  }
  constexpr explicit operator bool() const noexcept { return period_.count() > 0; }
  constexpr bool operator==(const Rate&) const = default;

 private:
  constexpr explicit Rate(Duration period) : period_(period) {}
  Duration period_{0};
};

/// Times closer than this count as one instant, of which the last value is used. Everything that divides by a time
/// needs it: lines from one USB packet get times 1 ns apart, although they were not sent so fast.
constexpr Duration one_instant = std::chrono::microseconds{1};

/// "10 ms", "1.5s", "250us", "2 min", "1 h", "3 d"; units ns, us (or µs), ms, s, min, h, d. Exact to the nanosecond; a
/// bare number, a negative one, or more than 292 years is an error that says what is allowed.
Result<Duration> parse_duration(std::string_view text);
/// The shortest exact text that `parse_duration` reads back: "10 ms", "1.5 s".
std::string to_string(Duration duration);
/// "100 Hz", "2.5 kHz", "1 MHz", "0.1 Hz", "6 /min", or a period such as "10 ms".
Result<Rate> parse_rate(std::string_view text);
/// "100 Hz", "0.1 Hz"; a period that is not a round rate is written as a period ("every 16.7 ms").
std::string to_string(Rate rate);

namespace literals {
using namespace std::chrono_literals;
constexpr Rate operator""_Hz(unsigned long long value) { return Rate::hertz(static_cast<double>(value)); }
constexpr Rate operator""_Hz(long double value) { return Rate::hertz(static_cast<double>(value)); }
constexpr Rate operator""_kHz(unsigned long long value) { return Rate::hertz(1e3 * static_cast<double>(value)); }
}  // namespace literals

}  // namespace rtdata
