/// CommandActuator: an output that is set by a program of the user's own, such as that of a smart plug or a USB hub.
///
///     rtdata::CommandActuator plug({.run = {"kasa", "--host", "192.168.1.40", "{value}"},
///                                   .words = {{"0", "off"}, {"1", "on"}}});
///
/// The program runs once for each value, with the value in place of `{value}` in its arguments. The value is set when
/// the program has ended with status 0 within `timeout`; else the last line that it wrote to its standard error says
/// why. It runs in a session of its own, and ends with all that it has started.
///
/// Owner: its output, or the guard. Thread: a lane's, or the guard's. Errors: those of starting a program; timed-out;
/// disconnected (another status, a signal: as a device that is away,
/// an output tries again).
#pragma once

#include <map>
#include <string>
#include <vector>

#include "rtdata/outputs/output.hpp"

namespace rtdata {

struct CommandActuatorConfig {
  std::vector<std::string> run = {};              ///< the program and its arguments, with `{value}` in one of these
  std::map<std::string, std::string> words = {};  ///< texts in place of the value: {"0": "off", "1": "on"}
  Duration timeout = std::chrono::seconds{1};     ///< from the start of the program to its end

  friend constexpr auto parameters(type_tag<CommandActuatorConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("run", &CommandActuatorConfig::run,
                  "the program and its arguments, such as [\"plug\", \"{value}\"]; {value} stands for the value",
                  required),
        parameter("words", &CommandActuatorConfig::words,
                  "text that replaces {value}, for each value: {\"0\": \"off\", \"1\": \"on\"}"),
        parameter("timeout", &CommandActuatorConfig::timeout, "time limit for the program to end",
                  range(Duration{10ms}, Duration{1500ms})));
  }
};
void check_config(const CommandActuatorConfig& config, const ConfigItem& item, Problems& problems);

class CommandActuator : public Actuator {
 public:
  explicit CommandActuator(CommandActuatorConfig config) : config_(std::move(config)) {}
  Result<void> open(std::optional<double> value) override;
  Result<void> set(double value) override;

 private:
  const CommandActuatorConfig config_;
};

}  // namespace rtdata
