/// CommandSensor: a program of one's own whose lines are events: a Python script for a HAT, a tool of a manufacturer.
///
///     rtdata::CommandSensor weight(loop, {.name = "weight"},
///                                  {.run = {"python3", "hx711.py"},
///                                   .lines = {.fields = {{.name = "mass", .unit = "g"}},
///                                             .first_line = rtdata::FirstLine::keep}});
///
/// Each line that the program prints becomes one event; lines.hpp says how lines are read.
///
/// - `run` is the program and its arguments, without a shell; a program without "/" is looked for in PATH. It begins in
///   the current directory, with the environment of this program, without its descriptors and priorities; its standard
///   input is empty.
/// - It prints to a raw pseudo terminal, so that it holds no lines back in its buffers; with `pty` false to a pipe.
/// - What it writes to its standard error goes to the log, and the last line of it into the reason of its fault.
/// - If it ends, or closes its output, or cannot be started, the sensor is faulted and starts it again after
///   `retry_first`, doubling to `retry_longest`. The time without it is a gap (disconnected).
/// - It is a session of its own. When the sensor stops, its process group gets SIGTERM, and SIGKILL if the
///   program has not ended after 2 s. If this program is killed, it gets SIGHUP from its terminal.
/// - SIGCHLD is not used. Needs Linux 5.3 (pidfd_open).
///
/// Programs are started on a lane, not on the loop.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <string>
#include <vector>

#include "rtdata/sensors/lines.hpp"

namespace rtdata {

struct CommandConfig {
  std::vector<std::string> run = {};  ///< the program and its arguments
  bool pty = true;                    ///< it prints to a terminal, not a pipe
  LineConfig lines = {.first_line = FirstLine::keep, .retry_first = std::chrono::seconds{1}};

  friend constexpr auto parameters(type_tag<CommandConfig>) {
    return parameter_list(
        parameter("run", &CommandConfig::run, "the program and its arguments, such as [\"python3\", \"hx711.py\"]",
                  rtdata::required),
        parameter("pty", &CommandConfig::pty,
                  "true: the program prints to a terminal, so that it does not hold lines back"),
        include_member(&CommandConfig::lines));
  }
};

void check_config(const CommandConfig& config, const ConfigItem& item, Problems& problems);
ReadTime read_time(const CommandConfig& config);

class CommandSensor : public AnySensor {
 public:
  CommandSensor() noexcept = default;
  /// SetupError: as `Feed`; bad-argument for a configuration that cannot work.
  CommandSensor(Loop& loop, FeedConfig feed, CommandConfig config);

 private:
  explicit CommandSensor(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
