#include "rtdata/outputs/gpio.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_set_gpio = "cannot set the GPIO line";

}  // namespace

Result<void> GpioActuator::open(std::optional<double> value) {
  if (const std::string why = range().refusal(value.value_or(0)); !why.empty())
    return Error{Errc::out_of_range, cannot_set_gpio, "", why, ""};
  GpioOutput settings;
  settings.line = config_.line;
  settings.chip = config_.chip;
  settings.drive = config_.drive;
  settings.active_low = config_.active_low;
  settings.initial = value == 1;
  settings.keep = !value;
  try {
    line_ = GpioLine::output(settings, backend_);
  } catch (const SetupError& error) {
    return error.error();
  }
  return {};
}

Result<void> GpioActuator::set(double value) {
  if (const std::string why = range().refusal(value); !why.empty())
    return Error{Errc::out_of_range, cannot_set_gpio, "", why, ""};
  return line_.set(value == 1);
}

Result<void> GpioActuator::check() {
  if (line_.is_there()) return {};
  return Error{Errc::disconnected, cannot_set_gpio, line_.place(), "the chip is gone", "plug it in again"};
}

}  // namespace rtdata
