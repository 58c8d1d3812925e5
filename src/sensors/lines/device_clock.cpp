#include "sensors/lines/device_clock.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "data/field_layout.hpp"
#include "sensors/lines/line_config.hpp"

namespace rtdata::detail {
namespace {

constexpr double ns_of_second = 1e9;
constexpr double first_window = ns_of_second, longest_window = 64 * ns_of_second;
constexpr double most_slope = 0.01;
// If a line is this much earlier or later than the fastest line before, the clock was set.
constexpr double most_early = ns_of_second, most_late = 5 * ns_of_second;
// The allowed difference between the fastest lines of two windows, whatever the drift: the first windows are short.
constexpr double most_change = 0.25 * ns_of_second;
constexpr double least_strange = 0.05 * ns_of_second;  // twice in one direction

}  // namespace

DeviceClock::DeviceClock(const DeviceTime& config, const Description& description)
    : leaf_(description.find(config.field)), step_(static_cast<double>(config.step.count())) {
  const auto refuse = [&](const char* why, const char* advice) {
    throw SetupError(refused_lines("device_time", "\"" + config.field + "\" " + why, advice));
  };
  if (leaf_ == nullptr) refuse("is not among the fields", "set `field` to the field with the device's clock");
  if (!is_integer_kind(leaf_->kind) && leaf_->kind != Kind::f64)
    refuse("cannot count", "set its `type` to an integer or double");
  if (leaf_->optional != nullptr)
    refuse("is optional", "remove its `optional` and `no_value`: each line must have a time");
  if (leaf_->kind != Kind::f64 && leaf_->size < 8) wraps_at_ = std::ldexp(step_, 8 * static_cast<int>(leaf_->size));
}

/// The time from the last line to this line, in ns. Negative: the clock went back.
double DeviceClock::step_to(std::uint64_t count, double elapsed) const noexcept {
  if (leaf_->kind == Kind::f64) {
    double now = 0, before = 0;
    std::memcpy(&now, &count, sizeof now);
    std::memcpy(&before, &last_, sizeof before);
    return (now - before) * step_;
  }
  const std::uint64_t forward = count - last_;
  if (wraps_at_ == 0) return static_cast<double>(static_cast<std::int64_t>(forward)) * step_;
  const std::uint64_t mask = (std::uint64_t{1} << (8 * leaf_->size)) - 1;
  const double steps = static_cast<double>(forward & mask) * step_;
  return steps + wraps_at_ * std::max(0.0, std::round((elapsed - steps) / wraps_at_));
}

void DeviceClock::begin(std::uint64_t count, MonotonicTime arrival) noexcept {
  is_known_ = true;
  has_drift_ = is_drift_told_ = false;
  last_ = count;
  first_ = last_arrival_ = arrival;
  device_ = slope_ = window_begin_ = 0;
  window_ = first_window;
  anchor_ = least_ = {};
  last_least_.reset();
  strange_ = 0;
}

/// The line through the fastest lines of two windows is the offset from now on.
void DeviceClock::end_window(double elapsed) noexcept {
  if (last_least_) {
    const double change = least_.offset - last_least_->offset;
    const bool is_strange = std::fabs(change) > least_strange &&
                            std::fabs(change) > 1.5 * most_slope * (least_.device - last_least_->device);
    const int sign = !is_strange ? 0 : change > 0 ? 1 : -1;
    is_useless_ = is_strange && (std::fabs(change) > most_change || sign == strange_);
    strange_ = sign;
  }
  // Two lines close together would show their delays rather than the clocks.
  if (last_least_ && least_.device - last_least_->device > window_ / 4) {
    const double slope = (least_.offset - last_least_->offset) / (least_.device - last_least_->device);
    slope_ = std::clamp(slope, -most_slope, most_slope);
    has_drift_ = has_drift_ || window_ >= longest_window;
  }
  anchor_ = least_;
  last_least_ = least_;
  window_begin_ = elapsed;
  window_ = std::min(2 * window_, longest_window);
}

MonotonicTime DeviceClock::time_of(const std::byte* payload, MonotonicTime arrival) noexcept {
  std::uint64_t count = 0;
  std::memcpy(&count, payload + leaf_->offset, leaf_->size);  // the machines we run on put the low byte first
  if (is_useless_) return arrival;
  if (!is_known_) {
    begin(count, arrival);
    return arrival;
  }
  const auto ns = [](Duration duration) { return static_cast<double>(duration.count()); };
  const double step = step_to(count, ns(arrival - last_arrival_));
  const double device = device_ + step;
  const double offset = ns(arrival - first_) - device;
  const double due = expected(device);
  if (!(step >= 0) || !(offset >= due - most_early) || !(offset <= due + most_late)) {
    has_restarted_ = true;
    begin(count, arrival);
    return arrival;
  }
  last_ = count;
  last_arrival_ = arrival;
  device_ = device;
  if (const double elapsed = ns(arrival - first_); elapsed - window_begin_ > window_) {
    end_window(elapsed);
    if (is_useless_) return arrival;
    least_ = {device, offset};
  } else if (offset - slope_ * device < least_.offset - slope_ * least_.device) {
    least_ = {device, offset};
  }
  if (offset < expected(device)) anchor_ = {device, offset};
  const double at = device + expected(device);
  return std::min(arrival, first_ + Duration{static_cast<std::int64_t>(at)});
}

std::optional<double> DeviceClock::take_drift() noexcept {
  if (!has_drift_ || std::exchange(is_drift_told_, true)) return std::nullopt;
  return -slope_ * 1e6;
}

bool DeviceClock::take_useless() noexcept { return is_useless_ && !std::exchange(is_useless_told_, true); }

bool DeviceClock::take_restart() noexcept { return std::exchange(has_restarted_, false); }

}  // namespace rtdata::detail
