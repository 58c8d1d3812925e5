// Machines of configurations: the type, and resuming after a pause. Private to the program.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "fsm/configured.hpp"
#include "rtdata/config/registry.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata::app {

void add_machines(Registry& registry);

/// The last recorded state of the machine, and its run.
struct Resumed {
  fsm::ConfiguredMachine::Beginning beginning;
  RunInfo run;
};
/// Empty: the machine begins in `start`. Logs the result. Reads the file.
std::optional<Resumed> resumed(Loop& loop, const fsm::MachineSettings& settings, const std::string& path);

/// True if an output was armed at the end of a recorded run, from that run or an earlier one. Reads the file. Errors:
/// those of reading it.
Result<bool> was_armed(const std::string& recording, std::int64_t run, const std::string& output,
                       const std::string& topic);

/// A machine that would arm the output again after a kill if it was armed in its recording.
struct ArmsAgain {
  std::string machine;
  const PartPlan* recording;  ///< valid until the system changes
  std::string topic;          ///< of the output
};
std::vector<ArmsAgain> who_arms_again(const Parts& parts, const std::string& output);

/// A machine whose present state forbids arming this output, with the state; empty: arming is allowed.
struct NotArmedIn {
  std::string machine, state, states;
};
std::optional<NotArmedIn> refuses_arming(const Parts& parts, const std::string& output);

}  // namespace rtdata::app
