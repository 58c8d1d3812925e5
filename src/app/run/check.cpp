#include <iostream>

#include "app/core/configuration_commands.hpp"
#include "app/run/growth.hpp"
#include "app/run/log_file.hpp"
#include "rtdata/config/secret.hpp"
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
  warn_of_growth(plan, growth_span);
  plan.hide_secrets();
  std::cout << plan.document.report(plan.warnings, "warning: ");
  const std::vector<LoopLoad> loads = plan.loads();
  if (!loads.empty()) std::cout << "how long readings may hold each loop, at worst, of its shortest period:\n";
  for (const LoopLoad& load : loads) {
    std::cout << "  " << load.text() << "\n";
    for (const LaneLoad& lane : load.lanes) std::cout << "    " << lane.text() << "\n";
  }
  for (const Growth& growth : growth_of(plan)) {
    if (!growth.is_limited) std::cout << hide_secrets(growth.text(), plan.secrets) << "\n";
  }
  const auto counted = [](std::size_t count, const char* what) {
    return std::to_string(count) + " " + what + (count == 1 ? "" : "s");
  };
  std::cout << (plan.warnings.empty() ? "ok: " : "ok, with " + counted(plan.warnings.size(), "warning") + ": ")
            << counted(plan.of_kind("sensor").size(), "sensor") << ", " << counted(plan.of_kind("sink").size(), "sink")
            << std::endl;
  return exit_good;
}

}  // namespace rtdata::app
