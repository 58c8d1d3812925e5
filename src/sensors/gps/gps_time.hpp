// Decides if the time of a receiver may be used as the time of day.
#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <optional>

#include "rtdata/data/time.hpp"

namespace rtdata::detail {

/// The date of this release, set with each release beside its version and CHANGELOG.md. A receiver with an earlier date
/// counts its weeks wrongly. Not __DATE__, because builds must be reproducible.
struct Release {
  const char* version;
  std::chrono::year_month_day date;
};
inline constexpr Release this_release{"0.1.0", std::chrono::year{2026} / 11 / 27};

/// The check of one receiver. Its time may jump in both directions: by unknown leap seconds, by 1024 weeks (the GPS
/// week rollover), and arbitrarily before it has received a satellite.
class GpsTimeCheck {
 public:
  enum class Verdict {
    open,  ///< fewer than five consecutive reports that agree, or a report with nothing new
    good,
    other_clock,  ///< the computer's clock is synchronised, and differs by more than both accuracies
    other_age,    ///< from before the release, or ten years after it
  };
  /// The program's clock now, and its largest error; no accuracy: the clock is not synchronised.
  struct SystemTime {
    Time time{};
    std::optional<Duration> accuracy = {};
  };
  /// Call it for each report of a fix with a time. It arrived at `at`, at most `delay` after the fix; its time is
  /// accurate within `accuracy`. Reports agree if their arrivals are as far apart as their times; delayed reports that
  /// arrive together do not agree.
  Verdict look_at(MonotonicTime at, Time time, Duration delay, Duration accuracy, const SystemTime& system) noexcept;
  /// As if nothing had come.
  void reset() noexcept { agreeing_ = 0; }

 private:
  struct Report {
    MonotonicTime at{};
    Time time{};
  };
  static constexpr std::size_t enough = 5;
  std::array<Report, enough> reports_{};  // the newest of those that agree, each at its number modulo `enough`
  std::size_t agreeing_ = 0;              // in a row that differ by no more than their delays explain
};

}  // namespace rtdata::detail
