// What of this machine costs timing or data, and what to do about it. Private to the program.
#pragma once

#include <string>
#include <vector>

#include "app/machine/machine_files.hpp"
#include "rtdata/config/system.hpp"

namespace rtdata::app {

enum class Severity {
  good,
  note,     ///< can be better; nothing that was asked for fails for it
  warning,  ///< costs timing or data
  fault,    ///< what the configuration names cannot work
};

struct Finding {
  Severity severity = Severity::good;
  std::string subject;      ///< "clock", "sensor air"
  std::string what;         ///< as it is
  std::string cost = {};    ///< of that
  std::string advice = {};  ///< what to do
};

/// Kernel, limits of real-time policies, processors, power.
/// `plan`: of the configuration that is to run here; null: none, then what only some configurations need is a note.
std::vector<Finding> examine_timing(const MachineFiles& files, const SystemPlan* plan);
/// The kernel's time and its synchronisation.
std::vector<Finding> examine_clock(const MachineFiles& files);
/// The disks of the sinks' files; without a plan, or without such sinks, that of the working folder. A small file is
/// written and synced on each, on this machine.
std::vector<Finding> examine_disks(const MachineFiles& files, const SystemPlan* plan);
/// Devices of the plan's parts: are they there, and may they be opened?
/// Is a chip the kernel's, and has somebody else the port open?
std::vector<Finding> examine_devices(const MachineFiles& files, const SystemPlan& plan);
/// GPIO lines and PWM channels of the plan's parts: are they there, and free?
std::vector<Finding> examine_lines(const MachineFiles& files, const SystemPlan& plan);
/// The groups that own ports and buses and that this user is not in; on a copy of a machine's files, that nobody is in.
std::vector<Finding> examine_groups(const MachineFiles& files);

}  // namespace rtdata::app
