#include <array>
#include <iostream>
#include <vector>

#include "app/core/calibration_text.hpp"
#include "app/core/configuration_commands.hpp"
#include "app/page/page_setup.hpp"
#include "app/run/data_at_risk.hpp"
#include "app/run/growth.hpp"
#include "app/run/left_backlogs.hpp"
#include "app/run/log_file.hpp"
#include "app/run/new_files.hpp"
#include "app/run/reload.hpp"
#include "rtdata/config/change.hpp"
#include "rtdata/config/read.hpp"
#include "rtdata/config/system.hpp"

namespace rtdata::app {

namespace {

/// The exit status.
int compare(const Registry& registry, const SystemPlan& plan, const std::string& against) {
  const SystemPlan now = plan_system(registry, load_config(against));
  if (!now.good()) {
    std::cout << now.report() << "the configuration cannot be compared with " << against << ", which has mistakes"
              << std::endl;
    return exit_configuration;
  }
  PlanChange change = plan_change(now, plan);
  // As in a reload: the process that sets outputs safe must start before there are threads.
  if (now.of_kind("output").empty()) {
    for (PartChange& part : change.all)
      if (part.object.starts_with("output ")) part = {part.object, Fate::refused, std::string(no_guard)};
  }
  std::vector<const PartPlan*> parts;
  for (const PartPlan& part : now.parts) parts.push_back(&part);
  for (const NewFile& written : new_files(parts, plan, change)) {
    const std::string why = obstacle_to_write(written);
    if (why.empty()) continue;
    for (PartChange& part : change.all)
      if (part.object == written.object) part = {part.object, Fate::refused, why};
  }
  std::cout << "in place of " << against << ", in a running system:\n"
            << (change.is_empty() ? "nothing changes\n" : hide_secrets(change.text(), plan.secrets)) << std::flush;
  for (const std::string& line : recordings_left(parts, plan))
    std::cout << "warning: " << hide_secrets(line, plan.secrets) << std::endl;
  if (change.refused() == 0) return exit_good;
  std::cout << "the running system cannot change to this configuration: restart the system" << std::endl;
  return exit_other;
}

}  // namespace

std::string counts_text(const Registry& registry, const SystemPlan& plan) {
  std::string text;
  std::string more;  // of kinds that not every configuration has
  for (const PartKind* kind : registry.kinds_to_show()) {
    if (kind->does == PartKind::Does::nothing_known) continue;
    const std::size_t count = plan.of_kind(kind->name).size();
    if (count == 0 && kind->name != "sensor" && kind->name != "sink") continue;
    text += (text.empty() ? "" : ", ") + std::to_string(count) + " " + (count == 1 ? kind->name : kind->key);
  }
  return text;
}

namespace {

/// "sensor tank, value: 0.1962 * raw - 24.2111 through 2 points", one line each.
std::vector<std::string> calibration_lines(const SystemPlan& plan) {
  std::vector<std::string> lines;
  for (const PartPlan* sensor : plan.of_kind("sensor")) {
    const ConfigItem* const process = sensor->item.find("process");
    if (process == nullptr) continue;
    for (const auto& [field, item] : process->children()) {
      const ConfigItem* const given = item.find("calibration.points");
      if (given == nullptr) continue;
      const auto points = given->get<std::vector<std::array<double, 2>>>();
      const CalibrationLine line = line_through(points);
      std::string text = sensor->object() + ", " + field + ": " + line_text(line) + " through " +
                         std::to_string(points.size()) + " points";
      if (points.size() > 2)
        text += "; largest residual " + number_text(line.largest) + " at [" +
                number_text(points[line.farthest][0], 10) + ", " + number_text(points[line.farthest][1], 10) + "]";
      lines.push_back(std::move(text));
    }
  }
  return lines;
}

}  // namespace

int check(const Registry& registry, const CheckOptions& options) {
  SystemPlan plan = plan_system(registry, load_config(options.file));
  check_log_file(log_file_of(plan, ""), plan);
  check_page(plan);
  if (!plan.good()) {
    std::cout << plan.report() << plan.document.report(plan.warnings, "warning: ") << plan.problems.size()
              << (plan.problems.size() == 1 ? " problem" : " problems") << std::endl;
    return exit_configuration;
  }
  warn_of_growth(plan, growth_span);
  warn_of_losses(plan);
  warn_of_left_backlogs(plan);
  plan.hide_secrets();
  std::cout << plan.document.report(plan.warnings, "warning: ");
  const std::vector<LoopLoad> loads = plan.loads();
  if (!loads.empty()) std::cout << "how long readings may hold each loop at worst, as a part of its shortest period:\n";
  for (const LoopLoad& load : loads) {
    std::cout << "  " << load.text() << "\n";
    for (const LaneLoad& lane : load.lanes) std::cout << "    " << lane.text() << "\n";
  }
  for (const std::string& line : calibration_lines(plan)) std::cout << line << "\n";
  for (const Growth& growth : growth_of(plan)) {
    if (!growth.is_limited) std::cout << hide_secrets(growth.text(), plan.secrets) << "\n";
  }
  for (const std::string& line : latencies(plan)) std::cout << hide_secrets(line, plan.secrets) << "\n";
  if (const std::string waiting = only_in_memory(plan); !waiting.empty())
    std::cout << "note: " << hide_secrets(waiting, plan.secrets) << "\n";
  if (const std::string quiet = unnoticed_silence(registry, plan); !quiet.empty())
    std::cout << "note: " << quiet << "\n";
  std::cout << "note: devices, the disk and the clock are not looked at here: `rtdata doctor` does that\n";
  const auto counted = [](std::size_t count, const char* what) {
    return std::to_string(count) + " " + what + (count == 1 ? "" : "s");
  };
  std::cout << (plan.warnings.empty() ? "ok: " : "ok, with " + counted(plan.warnings.size(), "warning") + ": ")
            << counts_text(registry, plan) << std::endl;
  return options.against.empty() ? exit_good : compare(registry, plan, options.against);
}

}  // namespace rtdata::app
