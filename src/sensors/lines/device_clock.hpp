// The clock of a device, by a field of its lines.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "rtdata/data/description.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/sensors/lines.hpp"

namespace rtdata::detail {

/// Finds our time of each line from the device's: the two differ by an offset, found from the line with the shortest
/// delay so far, and the offset drifts. The offset is the least difference within a window of 1 s at first and 64 s
/// later; the drift is its change from window to window, at most 1 %. A clock that differs by more cannot be used: from
/// then on the times are those of the reads.
class DeviceClock {
 public:
  /// SetupError (bad-argument): no such field, or a field that cannot be a counter.
  DeviceClock(const DeviceTime& config, const Description& description);

  /// Our time of a line that was read at `arrival`; never later than `arrival`.
  MonotonicTime time_of(const std::byte* payload, MonotonicTime arrival) noexcept;
  /// Starts again with the next line.
  void forget() noexcept { is_known_ = is_useless_ = is_useless_told_ = false; }
  /// By how much the device's clock is faster than ours, in millionths, once a window of 64 s has ended; set once for
  /// each `forget`.
  std::optional<double> take_drift() noexcept;
  /// True once after the clock turned out to be unusable.
  bool take_useless() noexcept;
  /// True once after the clock went back or jumped too far ahead.
  bool take_restart() noexcept;

 private:
  struct Point {
    double device = 0;  // ns since the first line
    double offset = 0;  // ns to our time since the first line
  };
  double expected(double device) const noexcept { return anchor_.offset + slope_ * (device - anchor_.device); }
  double step_to(std::uint64_t count, double elapsed) const noexcept;
  void begin(std::uint64_t count, MonotonicTime arrival) noexcept;
  void end_window(double elapsed) noexcept;

  const Leaf* leaf_;
  double step_;          // ns
  double wraps_at_ = 0;  // ns; 0: it does not
  bool is_useless_ = false, is_useless_told_ = false;
  bool is_known_ = false, has_restarted_ = false, has_drift_ = false, is_drift_told_ = false;
  std::uint64_t last_ = 0;  // the bits of the field
  MonotonicTime first_{}, last_arrival_{};
  double device_ = 0;
  Point anchor_, least_;             // of the line that gives the offset; of this window
  std::optional<Point> last_least_;  // of the window before
  double slope_ = 0;
  int strange_ = 0;                       // in which direction the offset has changed too much; 0: it has not
  double window_ = 0, window_begin_ = 0;  // ns of ours, since the first line
};

}  // namespace rtdata::detail
