#include "rtdata/outputs/pwm.hpp"

#include <unistd.h>

#include <charconv>
#include <cmath>
#include <string_view>

#include "io/kernel_file.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_use = "cannot use the PWM channel";

std::int64_t number_in(const std::string& path) {
  std::int64_t number = 0;
  if (const auto text = detail::read_kernel_file(path, cannot_use))
    std::from_chars(text->data(), text->data() + text->size(), number);
  return number;
}

}  // namespace

Result<void> PwmActuator::write(const char* file, std::int64_t value) const {
  return detail::write_kernel_file(folder_ + "/" + file, std::to_string(value), cannot_use);
}

Result<void> PwmActuator::open(std::optional<double> value) {
  if (const std::string why = range().refusal(value.value_or(0)); !why.empty())
    return Error{Errc::out_of_range, cannot_use, "", why, ""};
  const std::string chip = config_.root + "/pwmchip" + std::to_string(config_.chip);
  const auto channels = detail::read_kernel_file(chip + "/npwm", cannot_use);
  if (!channels) return channels.error();
  if (config_.channel >= number_in(chip + "/npwm"))
    return Error{Errc::not_found, cannot_use, chip, "it has " + *channels + " channels, counted from 0", ""};
  folder_ = chip + "/pwm" + std::to_string(config_.channel);
  if (::access(folder_.c_str(), F_OK) != 0) {
    const auto exported = detail::write_kernel_file(chip + "/export", std::to_string(config_.channel), cannot_use);
    if (!exported) return exported;
    // udev may need a moment to give its files to the group.
    for (int tries = 0; tries < 50 && ::access((folder_ + "/duty_cycle").c_str(), W_OK) != 0; ++tries) ::usleep(10'000);
  }
  const bool is_enabled = number_in(folder_ + "/enable") == 1;
  if (!value && is_enabled) return {};
  const std::int64_t period = config_.frequency.period().count();
  // A duty cycle is never longer than its period: the one that shrinks comes first.
  const std::int64_t duty = std::llround(value.value_or(0) * static_cast<double>(period));
  if (number_in(folder_ + "/duty_cycle") > period)
    if (const auto done = write("duty_cycle", duty); !done) return done;
  if (const auto done = write("period", period); !done) return done;
  if (const auto done = write("duty_cycle", duty); !done) return done;
  // The kernel refuses another polarity while it is enabled.
  const std::string_view polarity = config_.inverted ? "inversed" : "normal";
  const std::string file = folder_ + "/polarity";
  if (const auto now = detail::read_kernel_file(file, cannot_use); now && *now != polarity) {
    if (is_enabled)
      if (const auto done = write("enable", 0); !done) return done;
    if (const auto done = detail::write_kernel_file(file, polarity, cannot_use); !done) return done;
  }
  return write("enable", 1);
}

Result<void> PwmActuator::set(double value) {
  if (const std::string why = range().refusal(value); !why.empty())
    return Error{Errc::out_of_range, cannot_use, "", why, ""};
  const auto period = static_cast<double>(number_in(folder_ + "/period"));
  return write("duty_cycle", std::llround(value * period));
}

}  // namespace rtdata
