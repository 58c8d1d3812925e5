// rtdata graph: draws the machines of a configuration.
#include "app/core/terminal_text.hpp"
#include "rtdata/fsm/machine.hpp"

#include <iostream>
#include <vector>

#include "app/core/configuration_commands.hpp"
#include "fsm/configured.hpp"
#include "rtdata/config/system.hpp"

namespace rtdata::app {

int graph(const Registry& registry, const GraphOptions& options) {
  const SystemPlan plan = plan_system(registry, load_config(options.file));
  if (!plan.good()) {
    std::cerr << plan.report() << plan.problems.size() << (plan.problems.size() == 1 ? " problem" : " problems")
              << std::endl;
    return exit_configuration;
  }
  std::vector<fsm::Graph> graphs;
  std::string names;
  for (const PartPlan* part : plan.of_kind("machine")) {
    names += (names.empty() ? "" : ", ") + part->name;
    if (part->type != "machine" || (!options.machine.empty() && part->name != options.machine)) continue;
    fsm::MachineSettings settings;
    Problems ignored;  // there are none, or it would not be planned
    (void)read_config(part->item, settings, ignored, UnknownKeys::ignore);
    graphs.push_back(graph_of(settings));
  }
  if (graphs.empty()) {
    print_error(std::cerr,
                options.file + (options.machine.empty() ? " has no machines"
                                                        : " has no machine \"" + options.machine + "\"" +
                                                              (names.empty() ? "" : "; available: " + names)),
                "not-found");
    return exit_other;
  }
  for (const fsm::Graph& one : graphs) {
    if (options.draw_as == DrawAs::dot) {
      std::cout << dot(one);
    } else {
      if (graphs.size() > 1) std::cout << "%% " << one.name << "\n";
      std::cout << mermaid(one);
    }
  }
  std::cout << std::flush;
  return exit_good;
}

}  // namespace rtdata::app
