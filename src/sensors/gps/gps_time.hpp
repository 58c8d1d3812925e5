// Whether the time of a receiver may be taken for the time of day.
#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <optional>

#include "rtdata/data/time.hpp"

namespace rtdata::detail {

/// When this version was made: set with each release, beside its version and CHANGELOG.md. A receiver that says an
/// earlier date counts its weeks wrongly. No __DATE__, by which no two builds would be alike.
struct Release {
  const char* version;
  std::chrono::year_month_day date;
};
inline constexpr Release this_release{"0.1.0", std::chrono::year{2026} / 11 / 27};

/// One receiver's. Times in their logs jump both ways: by leap seconds that it has not heard of, by the 1024 weeks
/// after which GPS counts anew, by whatever it believes before it has heard a satellite.
class GpsTimeCheck {
 public:
  enum class Verdict {
    open,  ///< not five reports in a row that agree, or one that says nothing new
    good,
    other_clock,  ///< the computer's clock is kept right, and differs by more than both admit
    other_age,    ///< from before the release, or ten years after it
  };
  /// What the program's clock says now, and how far that may be from UTC; no accuracy: nobody keeps it right.
  struct SystemTime {
    Time time{};
    std::optional<Duration> accuracy = {};
  };
  /// Of each report of a fix with a time: it came at that instant, at most `delay` after the fix; the time is right to
  /// within `accuracy`. Reports agree that are as far apart in arrival as in time: what was held back and comes at once
  /// does not.
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
