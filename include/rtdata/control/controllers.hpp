/// Hysteresis, Pid: controllers, for the keys `hysteresis` and `pid` of an output.
///
/// Values without a loop; one thread at a time. They allocate no memory and throw nothing.
#pragma once

#include <algorithm>
#include <chrono>
#include <cmath>
#include <optional>

#include "rtdata/data/config_item.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata {

struct HysteresisConfig {
  double on = 0;   ///< switches on here: when rising if `on` > `off`, when falling if `on` < `off`
  double off = 0;  ///< switches off here, in the other direction

  friend constexpr auto parameters(type_tag<HysteresisConfig>) {
    return parameter_list(
        parameter("on", &HysteresisConfig::on,
                  "switch on at this value: when rising if `on` > `off`, when falling if `on` < `off`", required),
        parameter("off", &HysteresisConfig::off, "switch off at this value, in the other direction", required));
  }
  friend void check_config(const HysteresisConfig& config, const ConfigItem& item, Problems& problems) {
    if (config.on == config.off)
      problems.add(item.problem("bad-value", "`on` and `off` are the same: any noise would switch the output"));
  }
};

/// On-off control (bang-bang) with two thresholds, so that noise around one does not switch back and forth.
///
///     rtdata::Hysteresis fan({.on = 28, .off = 26});   // cools: on from 28 up, off from 26 down
///     rtdata::Hysteresis heater({.on = 18, .off = 20});  // heats: on from 18 down, off from 20 up
///     output.set(fan.update(temperature));
///
/// Between the thresholds it keeps its state; at first it is off. A value that is not finite changes nothing.
class Hysteresis {
 public:
  using Config = HysteresisConfig;
  explicit Hysteresis(const Config& config) noexcept : config_(config) {}

  /// Takes the next value; returns true if it is on.
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

struct PidConfig {
  double setpoint = 0;
  double kp = 0;  ///< output for each unit of difference
  double ki = 0;  ///< the same, a second
  double kd = 0;  ///< output per unit a second
  double least = 0;
  double most = 1;
  Duration derivative_filter{0};  ///< time constant; 0: none

  friend constexpr auto parameters(type_tag<PidConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("setpoint", &PidConfig::setpoint, "value that the measured value should reach", required),
        parameter(
            "kp", &PidConfig::kp,
            "proportional gain: output for each unit of difference; negative if more output lowers the measured value"),
        parameter("ki", &PidConfig::ki, "integral gain: change of the output per second, for each unit of difference"),
        parameter("kd", &PidConfig::kd,
                  "derivative gain: output for a measured value that changes by one unit per second"),
        parameter("least", &PidConfig::least, "least output"), parameter("most", &PidConfig::most, "largest output"),
        parameter("derivative_filter", &PidConfig::derivative_filter,
                  "time constant of the low-pass filter before the derivative; 0: no filter",
                  range(Duration{0}, Duration{1h})));
  }
  friend void check_config(const PidConfig& config, const ConfigItem& item, Problems& problems) {
    if (!(config.least < config.most))
      problems.add(item.problem("bad-value", "`least` is not below `most`: the output would have no range"));
    if (config.kp == 0 && config.ki == 0 && config.kd == 0)
      problems.add(item.problem("bad-value", "all gains are 0: give `kp`, `ki` or `kd`"));
  }
};

/// A proportional-integral-derivative controller, in the parallel form.
///
///     rtdata::Pid pid({.setpoint = 60, .kp = 0.04, .ki = 0.002, .kd = 0.1, .least = 0, .most = 1});
///     output.set(pid.update(temperature, event.time()));
///
/// output = kp * error + integral of (ki * error) - kd * rate of the measured value, with error = setpoint - measured,
/// held between `least` and `most`. Gains are negative if more output lowers the measured value.
///
///   - The derivative is that of the measured value, so that a change of the set point causes no jump. Before it is a
///     first-order low-pass filter with the time constant `derivative_filter`.
///   - Anti-windup: while the output is at a limit, the integral does not grow further in this direction.
///   - Bumpless, if there is an integral (`ki` is not 0): `change` changes nothing at that moment; `follow` gives the
///     real value of the actuator (set by hand, or its safe value), and the first `update` after it continues from
///     there. The integral absorbs the difference. A controller without an integral would keep the difference for ever:
///     its output always follows the formula.
///
/// `time` gives the time between two updates, whatever the rate. A `time` not later than the last counts as no time
/// passed; of updates closer than `one_instant`, the last one counts. The first update has no integral and no
/// derivative. A measured value that is not finite changes nothing: the last output is returned. The same holds for a
/// value so large that the arithmetic overflows; the next update then continues as after `follow`.
///
/// Form and anti-windup by clamping: K. J. Astrom,
/// T. Hagglund, "Advanced PID Control", sections 3.2 to 3.5.
class Pid {
 public:
  using Config = PidConfig;
  explicit Pid(const Config& config) noexcept : config_(config), output_(clamped(0)) {}

  double update(double measured, Time time) noexcept {
    if (!std::isfinite(measured)) return output_;
    if (before_ && time >= before_->instant && time - before_->instant < one_instant) {
      time = before_->instant;
      take_back();
    } else {
      before_ = Before{time, output_, integral_, rate_, last_time_, last_measured_, has_last_, is_following_};
    }
    const double error = config_.setpoint - measured;
    double seconds = 0;
    if (has_last_) seconds = std::max(std::chrono::duration<double>(time - last_time_).count(), 0.0);
    if (seconds > 0) {
      const double filter = std::chrono::duration<double>(config_.derivative_filter).count();
      rate_ += ((measured - last_measured_) / seconds - rate_) * seconds / (filter + seconds);
    }
    const double fast = fast_part(measured);
    if (!std::isfinite(fast) || !std::isfinite(rate_) || !std::isfinite(config_.ki * error * seconds)) {
      follow(output_);
      return output_;
    }
    if (config_.ki == 0) {
      integral_ = 0;
      is_following_ = false;
    } else if (is_following_) {
      integral_ = output_ - fast;
      is_following_ = false;
    } else {
      const double step = config_.ki * error * seconds;
      const double wanted = fast + integral_ + step;
      const bool pushes_further = (wanted > config_.most && step > 0) || (wanted < config_.least && step < 0);
      if (!pushes_further) integral_ += step;
    }
    last_time_ = time;
    last_measured_ = measured;
    has_last_ = true;
    return output_ = clamped(fast + integral_);
  }
  double output() const noexcept { return output_; }
  const Config& config() const noexcept { return config_; }

  double setpoint() const noexcept { return config_.setpoint; }
  /// Takes effect at the next update, without smoothing, so that the proportional part can follow a ramp or a profile.
  void set_setpoint(double setpoint) noexcept { config_.setpoint = setpoint; }
  /// Changes any settings, including the set point, at the next update, without a jump of the output. An output at a
  /// limit leaves it as soon as the formula gives another value: the integral does not store the difference there.
  void change(const Config& next) noexcept {
    const double was = integral_;
    const bool is_held = output_ <= config_.least || output_ >= config_.most;
    if (has_last_ && !is_following_ && !is_held) integral_ += fast_part(last_measured_);
    config_ = next;
    if (has_last_ && !is_following_ && !is_held) integral_ -= fast_part(last_measured_);
    if (!std::isfinite(integral_)) integral_ = was;
    output_ = clamped(output_);
    before_.reset();
  }
  /// Tells the controller the actuator's real value: with an integral, the next update returns the same value and
  /// continues from there.
  void follow(double output) noexcept {
    output_ = clamped(output);
    is_following_ = true;
    has_last_ = false;
    rate_ = 0;
    before_.reset();
  }

 private:
  /// The state at the start of an instant: a later value in the same instant replaces the earlier one.
  struct Before {
    Time instant{};
    double output = 0, integral = 0, rate = 0;
    Time last_time{};
    double last_measured = 0;
    bool has_last = false, is_following = false;
  };
  void take_back() noexcept {
    output_ = before_->output;
    integral_ = before_->integral;
    rate_ = before_->rate;
    last_time_ = before_->last_time;
    last_measured_ = before_->last_measured;
    has_last_ = before_->has_last;
    is_following_ = before_->is_following;
  }
  double fast_part(double measured) const noexcept {
    return config_.kp * (config_.setpoint - measured) - config_.kd * rate_;
  }
  double clamped(double output) const noexcept { return std::clamp(output, config_.least, config_.most); }

  Config config_;
  double output_;
  double integral_ = 0;  // as a part of the output, so that a change of `ki` makes no jump
  double rate_ = 0;      // of the measured value, a second
  Time last_time_{};
  double last_measured_ = 0;
  bool has_last_ = false;
  bool is_following_ = false;  // with an integral the next update gives `output_`
  std::optional<Before> before_ = {};
};

}  // namespace rtdata
