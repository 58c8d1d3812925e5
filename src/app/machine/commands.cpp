// The output of `rtdata scan` and `rtdata doctor`.
#include <unistd.h>

#include <algorithm>
#include <iostream>
#include <nlohmann/json.hpp>

#include "app/core/configuration_commands.hpp"
#include "app/core/terminal_text.hpp"
#include "app/machine/doctor.hpp"
#include "app/machine/scan.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

/// The content of files need not be UTF-8.
std::string text_of(const Json& json) { return json.dump(2, ' ', false, Json::error_handler_t::replace); }

bool is_folder_there(const std::string& root) {
  if (root.empty() || ::access((root + "/.").c_str(), R_OK | X_OK) == 0) return true;
  const Error why = system_error(errno, "cannot read the copy of the machine", root);
  print_error(std::cerr, why);
  return false;
}

Json json_of(const Scan& scan) {
  Json devices = Json::array(), hints = Json::array();
  for (const FoundDevice& device : scan.devices) {
    Json one{{"kind", device.kind}, {"path", device.path}, {"what", device.what}};
    if (!device.obstacle.empty()) one["obstacle"] = device.obstacle;
    if (!device.advice.empty()) one["advice"] = device.advice;
    for (const FoundDevice::Line& line : device.lines) one[line.list].push_back(line.text);
    devices.push_back(std::move(one));
  }
  for (const ScanHint& hint : scan.hints) hints.push_back({{"kind", hint.kind}, {"text", hint.text}});
  return {{"devices", std::move(devices)}, {"hints", std::move(hints)}};
}

void print(const Scan& scan) {
  std::string kind;
  for (const FoundDevice& device : scan.devices) {
    if (device.kind != kind) std::cout << (kind.empty() ? "" : "\n") << device.kind << "\n";
    kind = device.kind;
    std::cout << "  " << printable(device.path) << (device.what.empty() ? "" : "  ") << printable(device.what) << "\n";
    if (!device.obstacle.empty())
      std::cout << "    cannot be used: " << printable(device.obstacle) << (device.advice.empty() ? "" : "; ")
                << printable(device.advice) << "\n";
    for (const FoundDevice::Line& line : device.lines) std::cout << "    " << line.list << ": " << line.text << "\n";
  }
  if (scan.devices.empty()) std::cout << "no device for measuring was found\n";
  if (!scan.hints.empty()) std::cout << "\n";
  for (const ScanHint& hint : scan.hints) std::cout << hint.kind << ": " << hint.text << "\n";
  const bool has_lines = std::any_of(scan.devices.begin(), scan.devices.end(),
                                     [](const FoundDevice& device) { return !device.lines.empty(); });
  if (has_lines)
    std::cout
        << "\nput each line into the list of the configuration that it names; where an I2C address has several lines, "
           "take the one of your chip; `rtdata check` tells what a line lacks\n";
  std::cout << std::flush;
}

const char* name_of(Severity severity) {
  constexpr const char* names[] = {"ok", "note", "warning", "fault"};
  return names[static_cast<std::size_t>(severity)];
}

/// The worst first. `plan`: of the configuration for this machine; null: none.
std::vector<Finding> examine(const MachineFiles& files, const SystemPlan* plan) {
  std::vector<Finding> all;
  const auto append = [&](std::vector<Finding> more) {
    for (Finding& one : more) all.push_back(std::move(one));
  };
  if (plan != nullptr) append(examine_devices(files, *plan));
  if (plan != nullptr) append(examine_lines(files, *plan));
  append(examine_groups(files));
  append(examine_timing(files, plan));
  append(examine_clock(files));
  append(examine_disks(files, plan));
  std::stable_sort(all.begin(), all.end(), [](const Finding& a, const Finding& b) { return a.severity > b.severity; });
  return all;
}

void print(const std::vector<Finding>& found) {
  for (const Finding& one : found) {
    std::cout << name_of(one.severity) << ": " << printable(one.subject) << ": " << printable(one.what) << "\n";
    if (!one.cost.empty()) std::cout << "    cost: " << one.cost << "\n";
    if (!one.advice.empty()) std::cout << "    do:   " << printable(one.advice) << "\n";
  }
  std::cout << std::flush;
}

Json json_of(const std::vector<Finding>& found) {
  Json findings = Json::array();
  for (const Finding& one : found) {
    Json json{{"severity", name_of(one.severity)}, {"subject", one.subject}, {"what", one.what}};
    if (!one.cost.empty()) json["cost"] = one.cost;
    if (!one.advice.empty()) json["advice"] = one.advice;
    findings.push_back(std::move(json));
  }
  return {{"worst", name_of(found.front().severity)}, {"findings", std::move(findings)}};
}

}  // namespace

int scan(const Registry& registry, const ScanOptions& options) {
  if (!is_folder_there(options.root)) return exit_other;
  const Scan found = scan_machine(MachineFiles(options.root), registry, options.probe ? Probing::yes : Probing::no);
  if (options.show_as == ShowAs::json) {
    std::cout << text_of(json_of(found)) << std::endl;
  } else {
    print(found);
  }
  return exit_good;
}

int doctor(const Registry& registry, const DoctorOptions& options) {
  if (!is_folder_there(options.root)) return exit_other;
  const bool is_text = options.show_as == ShowAs::text;
  std::optional<SystemPlan> plan;
  if (!options.file.empty()) plan = plan_system(registry, load_config(options.file));
  std::vector<Finding> found;
  if (plan && !plan->good()) {
    if (is_text) {
      std::cerr << plan->report();
      print_error(std::cerr, options.file + " has mistakes; see rtdata check", "bad-configuration");
      return exit_configuration;
    }
    for (const Problem& problem : plan->problems) found.push_back({Severity::fault, options.file, problem.text()});
  } else {
    found = examine(MachineFiles(options.root), plan ? &*plan : nullptr);
  }
  if (is_text) {
    print(found);
  } else {
    std::cout << text_of(json_of(found)) << std::endl;
  }
  const Severity worst = found.front().severity;
  return worst == Severity::fault ? exit_configuration : worst == Severity::warning ? exit_loss : exit_good;
}

}  // namespace rtdata::app
