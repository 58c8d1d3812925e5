// Finds problems of this machine that cost timing or data, with advice. Private to the program.
#pragma once

#include <string>
#include <vector>

#include "app/machine/machine_files.hpp"
#include "rtdata/config/system.hpp"

namespace rtdata::app {

enum class Severity {
  good,
  note,     ///< could be better, but nothing fails
  warning,  ///< costs timing or data
  fault,    ///< something in the configuration cannot work
};

struct Finding {
  Severity severity = Severity::good;
  std::string subject;      ///< "clock", "sensor air"
  std::string what;         ///< the state found
  std::string cost = {};    ///< its consequence
  std::string advice = {};  ///< what to do
};

/// Kernel, limits of real-time policies, processors, power. `plan`: of the configuration for this machine; null: none,
/// then needs of only some configurations are notes.
std::vector<Finding> examine_timing(const MachineFiles& files, const SystemPlan* plan);
/// The kernel's time and its synchronisation.
std::vector<Finding> examine_clock(const MachineFiles& files);
/// The disks of the sinks' files; without a plan, or without such sinks, that of the working folder. A small file is
/// written and synced on each, on this machine.
std::vector<Finding> examine_disks(const MachineFiles& files, const SystemPlan* plan);
/// Checks the devices of the plan's parts: they exist and may be opened, no kernel driver has the chip, and no other
/// program has the port open.
std::vector<Finding> examine_devices(const MachineFiles& files, const SystemPlan& plan);
/// Checks that the GPIO lines and PWM channels of the plan's parts exist and are free.
std::vector<Finding> examine_lines(const MachineFiles& files, const SystemPlan& plan);
/// The groups of ports and buses that this user is not a member of; on a copy of a machine's files, groups without
/// members.
std::vector<Finding> examine_groups(const MachineFiles& files);

}  // namespace rtdata::app
