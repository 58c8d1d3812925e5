// Machines of configurations: the type, and where one of them goes on after a pause. Private to the program.
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

/// The state in which the last run of a recording that knows the machine left it, as `resume` says, and that run.
struct Resumed {
  fsm::ConfiguredMachine::Beginning beginning;
  RunInfo run;
};
/// Nothing: it begins in `start`. What was found, and what follows from it, goes to the log. Reads the file.
std::optional<Resumed> resumed(Loop& loop, const fsm::MachineSettings& settings, const std::string& path);

/// Whether an output was armed at the end of a run of a recording, as far as that or one before it says. Reads the
/// file. Errors: those of reading it.
Result<bool> was_armed(const std::string& recording, std::int64_t run, const std::string& output,
                       const std::string& topic);

/// A machine that, after a kill, would arm the output again if its recording says that it was armed.
struct ArmsAgain {
  std::string machine;
  const PartPlan* recording;  ///< valid until the system changes
  std::string topic;          ///< of the output
};
std::vector<ArmsAgain> who_arms_again(const Parts& parts, const std::string& output);

/// The machine in whose present state this output cannot be armed, and that state; nothing: it can be.
struct NotArmedIn {
  std::string machine, state, states;
};
std::optional<NotArmedIn> refuses_arming(const Parts& parts, const std::string& output);

}  // namespace rtdata::app
