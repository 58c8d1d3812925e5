// GPIO lines and PWM channels that a configuration names: are they there, and free?
#include <unistd.h>

#include <charconv>
#include <optional>

#include "app/machine/doctor.hpp"
#include "io/gpio_lookup.hpp"

namespace rtdata::app {
namespace {

/// A part that cannot take its line or channel does not start, and so `rtdata run` does not.
constexpr const char* cost = "the run does not start";

std::string text_at(const ConfigItem& item, std::string_view key) {
  const ConfigItem* found = item.find(key);
  const std::string* text = found != nullptr ? found->as_string() : nullptr;
  return text != nullptr ? *text : std::string();
}
std::int64_t number_at(const ConfigItem& item, std::string_view key, std::int64_t otherwise) {
  const ConfigItem* found = item.find(key);
  std::int64_t number = otherwise;
  Problems ignored;
  return found != nullptr && ConfigValue<std::int64_t>::read(*found, number, ignored) ? number : otherwise;
}

/// None: on a copy of another machine's files, where nobody says which lines its chips have.
std::optional<Finding> examine_line(const MachineFiles& files, const PartPlan& part,
                                    [[maybe_unused]] const ConfigItem& item) {
  if (files.names("/dev", "gpiochip").empty())
    return Finding{Severity::fault, part.object(), "this machine has no GPIO chip", cost,
                   "`ls /dev/gpiochip*` shows them"};
#ifdef RTDATA_WITH_GPIO
  GpioLineName line;
  Problems ignored;
  const ConfigItem* name = item.find("line");
  if (!files.is_this_machine() || name == nullptr || !ConfigValue<GpioLineName>::read(*name, line, ignored)) return {};
  const auto found = detail::find_gpio_line(make_kernel_gpio()->chips(), line, text_at(item, "chip"));
  if (!found) {
    const Error& error = found.error();
    return Finding{Severity::fault, part.object(), error.where + ": " + error.why, cost, error.advice};
  }
  if (!found->line.is_used) return Finding{Severity::good, part.object(), found->text + " is free"};
  const std::string& who = found->line.consumer;
  return Finding{Severity::warning, part.object(),
                 found->text + ": " + (who.empty() ? "somebody has it, who gives no name" : "\"" + who + "\" has it"),
                 cost, "end that, or use another line; a driver of the kernel is named in the device tree"};
#else
  return {};
#endif
}

Finding examine_pwm(const MachineFiles& files, const PartPlan& part) {
  const std::string root = text_at(part.item, "root");
  const std::string chip = (root.empty() ? "/sys/class/pwm" : root) + "/pwmchip" +
                           std::to_string(number_at(part.item, "chip", 0));
  const std::int64_t channel = number_at(part.item, "channel", 0);
  const auto count = files.text(chip + "/npwm");
  if (!count)
    return {Severity::fault, part.object(), "there is no PWM chip " + chip, cost,
            "on a Raspberry Pi a line `dtoverlay=pwm-2chan` in /boot/firmware/config.txt, then start it again"};
  std::int64_t channels = 0;
  std::from_chars(count->data(), count->data() + count->size(), channels);
  if (channel >= channels)
    return {Severity::fault, part.object(), chip + " has " + *count + " channels, from 0 on", cost,
            "set `channel` to one of them"};
  const std::string folder = chip + "/pwm" + std::to_string(channel);
  const std::string file = files.exists(folder) ? folder + "/duty_cycle" : chip + "/export";
  const Access access = access_to(files, file, W_OK);
  if (!access.is_granted) return {Severity::fault, part.object(), file + ": " + access.why, cost, access.advice};
  return {Severity::good, part.object(), folder + " can be used"};
}

}  // namespace

std::vector<Finding> examine_lines(const MachineFiles& files, const SystemPlan& plan) {
  std::vector<Finding> found;
  for (const PartPlan& part : plan.parts) {
    if (part.kind == "output" && part.type == "pwm") found.push_back(examine_pwm(files, part));
    const bool has_line = (part.kind == "output" && part.type == "gpio") ||
                          (part.kind == "sensor" && (part.type == "edge" || part.type == "counter"));
    if (has_line)
      if (std::optional<Finding> one = examine_line(files, part, part.item)) found.push_back(*std::move(one));
    const ConfigItem* lines = part.kind == "sensor" && part.type == "gpio" ? part.item.find("lines") : nullptr;
    for (std::size_t i = 0; lines != nullptr && lines->is_array() && lines->find(i) != nullptr; ++i)
      if (std::optional<Finding> one = examine_line(files, part, *lines->find(i))) found.push_back(*std::move(one));
  }
  return found;
}

}  // namespace rtdata::app
