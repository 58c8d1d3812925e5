#include "app/control/instances.hpp"

#include <algorithm>
#include <functional>
#include <iostream>
#include <vector>

#include "app/core/configuration_commands.hpp"
#include "app/core/table.hpp"
#include "app/core/terminal_text.hpp"

namespace rtdata::app {
namespace {

using Found = FoundInstance;

constexpr Duration search_limit = std::chrono::milliseconds{500};  // once the wanted one has answered
constexpr Duration longest_search = std::chrono::seconds{3};       // if it has not

/// Asks all instances at once and waits for all answers together. `wanted`: see Found::matches.
std::vector<Found> find_instances(const std::string& wanted) {
  std::vector<Found> all;
  for (Instance& instance : running_instances()) {
    Found found{std::move(instance), {}, false, "", "does not answer"};
    if (auto client = ControlClient::connect(found.instance.path)) {
      client->send(status_request);
      found.client = std::move(*client);
    } else if (client.error().code != make_error_code(Errc::busy)) {
      continue;  // it has just ended
    }
    all.push_back(std::move(found));
  }
  const auto begun = std::chrono::steady_clock::now();
  const auto is_wanted = [&](const Found& one) { return !wanted.empty() && one.matches(wanted); };
  const auto is_silent = [](const Found& one) { return one.client && !one.answers; };
  while (std::any_of(all.begin(), all.end(), is_silent)) {
    for (Found& one : all) {
      if (is_silent(one)) one.hear(std::chrono::milliseconds{10});
    }
    const Duration waited = std::chrono::steady_clock::now() - begun;
    if (waited > longest_search) break;
    if (waited > search_limit && std::any_of(all.begin(), all.end(), is_wanted)) break;
  }
  return all;
}

std::string list_of(const std::vector<const Found*>& instances) {
  Table table({">pid", "name", "configuration"});
  for (const Found* one : instances) {
    table.add({std::to_string(one->instance.pid), one->name.empty() ? "-" : one->name,
               one->name.empty() ? "(" + one->configuration + ")" : one->configuration});
  }
  return table.text("  ");
}

}  // namespace

void FoundInstance::hear(Duration at_most) {
  const auto line = client->receive(at_most);
  if (line && !*line) return;
  answers = true;
  const Result<Status> status = line ? status_from(**line) : Result<Status>(line.error());
  if (status) name = status->instance.name;
  configuration = status ? status->instance.configuration : status.error().text();
}

Error instance_does_not_answer() {
  return {Errc::timed_out, "no status", "instance", "it does not answer",
          "check whether it is stopped, its loop is held, or the machine is busy"};
}

bool is_instance(const std::string& word) {
  const std::vector<Found> instances = find_instances(word);
  return std::any_of(instances.begin(), instances.end(), [&](const Found& one) { return one.matches(word); });
}

std::optional<FoundInstance> choose_instance(const std::string& wanted, const char* command, int& status) {
  status = exit_other;
  std::vector<Found> instances = find_instances(wanted);
  if (instances.empty()) {
    print_error(std::cerr, "no instance is running that this user may see; `rtdata run FILE` starts one", "not-found");
    for (const std::string& folder : closed_folders())
      print_error(std::cerr, folder + " belongs to another user, such as a service: `sudo rtdata " + command + "`",
                  "not-permitted");
    return std::nullopt;
  }
  std::vector<const Found*> all, matching;
  Found* chosen = nullptr;
  bool all_answer = true;
  for (Found& one : instances) {
    all.push_back(&one);
    all_answer = all_answer && one.answers;
    if (!one.matches(wanted)) continue;
    matching.push_back(&one);
    chosen = &one;
  }
  if (matching.empty()) {
    print_error(std::cerr,
                std::string("no running instance") + (all_answer ? "" : " that answers") + " is called \"" + wanted +
                    "\"; these are running",
                "not-found");
    std::cerr << list_of(all) << (all_answer ? "" : "name one that does not answer by its pid\n") << std::flush;
    return std::nullopt;
  }
  if (matching.size() > 1) {
    print_error(std::cerr, "several instances are running; name one, by pid or name", "bad-argument");
    std::cerr << list_of(matching) << std::flush;
    status = exit_configuration;
    return std::nullopt;
  }
  Found found = std::move(*chosen);
  if (!found.client) {
    const Error silent = instance_does_not_answer();
    print_error(std::cerr, "pid " + std::to_string(found.instance.pid) + ": " + silent.text(), silent.id());
    return std::nullopt;
  }
  return found;  // closes the connections to the others
}

}  // namespace rtdata::app
