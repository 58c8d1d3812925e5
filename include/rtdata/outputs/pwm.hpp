/// PwmActuator: a channel of a PWM chip of the kernel (/sys/class/pwm) as the device of an output. Its value is the
/// duty cycle, from 0 to 1.
///
/// The channel is exported if it is not, and enabled once its period and duty cycle are set, so that it never shows
/// others. A channel that is kept stays as it is if it is enabled, and else begins with a duty cycle of 0. Given back,
/// it keeps its duty cycle and stays exported: another process can go on with it.
///
/// Interface: the kernel's Documentation/ABI/testing/sysfs-class-pwm; times in ns.
/// Errors: not-found (no such chip or channel), not-permitted, out-of-range (a value that is no duty cycle; a frequency
/// that the chip cannot do), io-failed.
#pragma once

#include <cstdint>
#include <string>

#include "rtdata/outputs/output.hpp"

namespace rtdata {

struct PwmConfig {
  std::uint32_t chip = 0;  ///< of /sys/class/pwm/pwmchip0
  std::uint32_t channel = 0;
  Rate frequency = Rate::hertz(1000);
  bool inverted = false;                ///< the duty cycle is the part of the time that it is low
  std::string root = "/sys/class/pwm";  ///< where the chips are

  friend constexpr auto parameters(type_tag<PwmConfig>) {
    return parameter_list(
        parameter("chip", &PwmConfig::chip, "the number of the chip: 0 is /sys/class/pwm/pwmchip0",
                  range(0, 4294967295.0)),
        parameter("channel", &PwmConfig::channel, "its channel", range(0, 4294967295.0)),
        parameter("frequency", &PwmConfig::frequency, "of the pulses"),
        parameter("inverted", &PwmConfig::inverted, "the duty cycle is the part of the time that it is low"),
        parameter("root", &PwmConfig::root, "where the chips are", TextIs::recorded));
  }
};

class PwmActuator : public Actuator {
 public:
  explicit PwmActuator(PwmConfig config) : config_(std::move(config)) {}
  OutputRange range() const override { return {0, 1}; }
  Result<void> open(std::optional<double> value) override;
  Result<void> set(double value) override;

 private:
  Result<void> write(const char* file, std::int64_t value) const;

  PwmConfig config_;
  std::string folder_ = {};  // of the channel
};

}  // namespace rtdata
