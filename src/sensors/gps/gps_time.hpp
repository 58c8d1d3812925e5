// Whether the time of a receiver may be taken for the time of day.
#pragma once

#include <optional>

#include "rtdata/data/time.hpp"

namespace rtdata::detail {

/// One receiver's. Times in their logs jump both ways: by leap seconds that it has not heard of, by the 1024 weeks
/// after which GPS counts anew, by whatever it believes before it has heard a satellite.
class GpsTimeCheck {
 public:
  /// What the program's clock says now, and how far that may be from UTC; no accuracy: nobody keeps it right.
  struct SystemTime {
    Time time{};
    std::optional<Duration> accuracy = {};
  };
  /// Of each report of a fix with a time: it came at that instant, at most `delay` after the fix.
  bool accepts(MonotonicTime at, Time time, Duration delay, const SystemTime& system) noexcept;
  /// As if nothing had come.
  void reset() noexcept { agreeing_ = 0; }

 private:
  MonotonicTime last_at_{};
  Time last_time_{};
  int agreeing_ = 0;  // reports in a row that differ by no more than their delays explain
};

}  // namespace rtdata::detail
