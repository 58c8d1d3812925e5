/// PwmActuator: a channel of a PWM chip of the kernel (/sys/class/pwm) as the device of an output. Its value is the
/// duty cycle, from 0 to 1.
///
///     rtdata::Output fan(loop, {.name = "fan"}, [] {
///       return std::make_unique<rtdata::PwmActuator>(rtdata::PwmConfig{.frequency = 25_kHz});
///     });
///
/// Opening exports the channel if needed, sets period and duty cycle, and then enables it, so that no other signal
/// appears. With `keep`, an enabled channel does not change; a disabled one starts with a duty cycle of 0. After it is
/// released, the channel keeps its duty cycle and stays exported, so another process can continue with it.
///
/// Owner: its output, or the guard. Thread: a lane's, or the guard's. Interface: the kernel's
/// Documentation/ABI/testing/sysfs-class-pwm; times in ns. Errors: not-found (no such chip or channel), not-permitted,
/// out-of-range (a value that is not 0 to 1; a frequency that the chip does not support), io-failed.
#pragma once

#include <cstdint>
#include <string>

#include "rtdata/outputs/output.hpp"

namespace rtdata {

struct PwmConfig {
  std::uint32_t chip = 0;  ///< of /sys/class/pwm/pwmchip0
  std::uint32_t channel = 0;
  Rate frequency = Rate::hertz(1000);
  bool inverted = false;                ///< the duty cycle is the share of the time that the pin is low
  std::string root = "/sys/class/pwm";  ///< where the chips are

  friend constexpr auto parameters(type_tag<PwmConfig>) {
    return parameter_list(
        parameter("chip", &PwmConfig::chip, "the number of the chip: 0 is /sys/class/pwm/pwmchip0",
                  range(0, 4294967295.0)),
        parameter("channel", &PwmConfig::channel, "number of the channel of the chip", range(0, 4294967295.0)),
        parameter("frequency", &PwmConfig::frequency, "frequency of the pulses"),
        parameter("inverted", &PwmConfig::inverted, "true: the duty cycle is the share of time at the low level"),
        parameter("root", &PwmConfig::root, "folder of the chips", TextIs::recorded));
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
