/// Hysteresis: on-off control (bang-bang) with two thresholds, so that noise around one does not switch back and forth.
///
///     rtdata::Hysteresis fan({.on = 28, .off = 26});   // cools: on from 28 up, off from 26 down
///     rtdata::Hysteresis heater({.on = 18, .off = 20});  // heats: on from 18 down, off from 20 up
///     output.set(fan.update(temperature));
///
/// Between the thresholds it stays as it is; at first off. What is not finite changes nothing.
///
/// A value; one thread at a time. Takes no memory, throws nothing.
#pragma once

#include <cmath>

#include "rtdata/data/config_item.hpp"
#include "rtdata/data/parameter.hpp"

namespace rtdata {

struct HysteresisConfig {
  double on = 0;   ///< above `off`: on from here up; below it: on from here down
  double off = 0;  ///< off from here, the other way

  friend constexpr auto parameters(type_tag<HysteresisConfig>) {
    return parameter_list(
        parameter("on", &HysteresisConfig::on, "above `off`: on from here up; below it: on from here down", required),
        parameter("off", &HysteresisConfig::off, "off from here, the other way", required));
  }
  friend void check_config(const HysteresisConfig& config, const ConfigItem& item, Problems& problems) {
    if (config.on == config.off)
      problems.add(item.problem("bad-value", "`on` and `off` are the same, so that any noise would switch it"));
  }
};

class Hysteresis {
 public:
  using Config = HysteresisConfig;
  explicit Hysteresis(const Config& config) noexcept : config_(config) {}

  /// Whether it is on, with this value.
  bool update(double value) noexcept {
    if (!std::isfinite(value)) return is_on_;
    const bool is_rising = config_.on > config_.off;
    if (is_rising ? value >= config_.on : value <= config_.on)
      is_on_ = true;
    else if (is_rising ? value <= config_.off : value >= config_.off)
      is_on_ = false;
    return is_on_;
  }
  bool is_on() const noexcept { return is_on_; }
  /// Off, as at first.
  void reset() noexcept { is_on_ = false; }

 private:
  Config config_;
  bool is_on_ = false;
};

}  // namespace rtdata
