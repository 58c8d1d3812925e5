/// GpioActuator: a GPIO line as the device of an output. 0 is inactive, 1 active; it takes no other value.
///
///     rtdata::Output valve(loop, {.name = "valve"}, [] {
///       return std::make_unique<rtdata::GpioActuator>(rtdata::GpioActuatorConfig{.line = 17});
///     });
///
/// Opening makes the line an output and sets its level in one step, without a pulse in between. With `keep`, the line
/// keeps its present level. After it is released, the chip decides the level of the line; most chips keep the last one.
///
/// Owner: its output, or the guard. Thread: a lane's, or the guard's. Errors: those of a GPIO line (io/gpio.hpp);
/// out-of-range.
#pragma once

#include <memory>
#include <utility>

#include "rtdata/io/gpio.hpp"
#include "rtdata/outputs/output.hpp"

namespace rtdata {

struct GpioActuatorConfig {
  GpioLineName line = {};
  std::string chip = {};  ///< empty: the one that has the line
  GpioDrive drive = GpioDrive::push_pull;
  bool active_low = false;

  friend constexpr auto parameters(type_tag<GpioActuatorConfig>) {
    return parameter_list(
        parameter(
            "line", &GpioActuatorConfig::line,
            "name of the line (\"GPIO17\"), its number on the chip (17), or both chip and number (\"gpiochip0:17\")",
            required),
        parameter("chip", &GpioActuatorConfig::chip,
                  "chip of the line, such as gpiochip0; empty: the chip that has the line"),
        parameter("drive", &GpioActuatorConfig::drive, "how the line is driven"),
        parameter("active_low", &GpioActuatorConfig::active_low,
                  "the value 1 sets the line low (many relay boards need this)"));
  }
};

class GpioActuator : public CheckedActuator {
 public:
  explicit GpioActuator(GpioActuatorConfig config) : GpioActuator(std::move(config), make_kernel_gpio()) {}
  GpioActuator(GpioActuatorConfig config, std::shared_ptr<GpioBackend> backend)
      : config_(std::move(config)), backend_(std::move(backend)) {}
  OutputRange range() const override { return {0, 1, true}; }
  Result<void> open(std::optional<double> value) override;
  Result<void> set(double value) override;
  /// Checks that the chip is still there, for example one on USB.
  Result<void> check() override;

 private:
  GpioActuatorConfig config_;
  std::shared_ptr<GpioBackend> backend_;
  GpioLine line_;
};

}  // namespace rtdata
