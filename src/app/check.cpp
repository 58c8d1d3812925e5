#include <iostream>

#include "app/log_file.hpp"
#include "app/subcommands.hpp"
#include "rtdata/config/system.hpp"

namespace rtdata::app {

int check(const Registry& registry, const std::string& file) {
  SystemPlan plan = plan_system(registry, load_config(file));
  check_log_file(log_file_of(plan, ""), plan);
  if (!plan.good()) {
    std::cout << plan.report() << plan.problems.size() << (plan.problems.size() == 1 ? " problem" : " problems")
              << std::endl;
    return exit_configuration;
  }
  for (const Problem& warning : plan.warnings) {
    std::cout << "warning: " << warning.text() << "\n" << plan.document.excerpt(warning);
  }
  for (const LoopLoad& load : plan.loads()) {
    std::cout << load.text() << "\n";
    for (const LaneLoad& lane : load.lanes) std::cout << "  " << lane.text() << "\n";
  }
  const auto counted = [](std::size_t count, const char* what) {
    return std::to_string(count) + " " + what + (count == 1 ? "" : "s");
  };
  std::cout << "ok: " << counted(plan.sensors.size(), "sensor") << ", " << counted(plan.sinks.size(), "sink")
            << std::endl;
  return exit_good;
}

}  // namespace rtdata::app
