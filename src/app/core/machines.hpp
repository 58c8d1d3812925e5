// Machines of configurations: the type, and where one of them goes on after a pause. Private to the program.
#pragma once

#include <optional>
#include <string>

#include "rtdata/config/registry.hpp"
#include "rtdata/fsm/configured.hpp"
#include "rtdata/loop/loop.hpp"

namespace rtdata::app {

void add_machines(Registry& registry);

/// The state in which the last run of a recording that knows the machine left it, as `resume` says; nothing: it begins
/// in `start`. What was found, and what follows from it, goes to the log. Reads the file.
std::optional<fsm::ConfiguredMachine::Beginning> resumed(Loop& loop, const fsm::MachineSettings& settings,
                                                         const std::string& path);

/// Whether an output was armed when the last run of a recording that knows it ended. Reads the file.
bool was_armed(const std::string& recording, const std::string& output, const std::string& topic);

/// The machine in whose present state this output cannot be armed, and that state; nothing: it can be.
struct NotArmedIn {
  std::string machine, state, states;
};
std::optional<NotArmedIn> refuses_arming(const Parts& parts, const std::string& output);

}  // namespace rtdata::app
