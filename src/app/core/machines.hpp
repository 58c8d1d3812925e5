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

}  // namespace rtdata::app
