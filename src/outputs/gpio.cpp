#include "rtdata/outputs/gpio.hpp"

#include "rtdata/data/config_item.hpp"

namespace rtdata {
namespace {

Error no_level(double value) {
  return {Errc::out_of_range, "cannot set the GPIO line", "", std::to_string(value) + " is no level: it is 0 or 1", ""};
}

}  // namespace

void GpioActuatorConfig::check_level(const ConfigItem& item, Problems& problems) {
  const ConfigItem* const safe = item.find("safe");
  double value = 0;
  Problems ignored;
  if (safe == nullptr || !ConfigValue<double>::read(*safe, value, ignored) || value == 0 || value == 1) return;
  problems.add(safe->problem("bad-value", "the safe value of a line is 0 or 1"));
}

Result<void> GpioActuator::open(std::optional<double> value) {
  if (value && *value != 0 && *value != 1) return no_level(*value);
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
  if (value != 0 && value != 1) return no_level(value);
  return line_.set(value == 1);
}

}  // namespace rtdata
