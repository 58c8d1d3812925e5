#include <unistd.h>

#include <algorithm>
#include <iostream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "app/control/instances.hpp"
#include "app/core/configuration_commands.hpp"
#include "app/core/terminal_text.hpp"
#include "app/inspect/event_printer.hpp"
#include "rtdata/data/problem.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

constexpr Duration answer_limit = std::chrono::seconds{5};
constexpr Duration longest_silence = std::chrono::seconds{10};  // an instance says something every second

/// Prints what the instance sends, until it ends, fails or is silent, or nobody reads the output. Returns the exit
/// status.
int follow(ControlClient& client, pid_t pid, ShowAs show_as) {
  EventPrinter printer(columns_of(STDOUT_FILENO));
  const auto fail = [&](const std::string& why, std::string_view id) {
    std::cout << std::flush;
    print_error(std::cerr, "pid " + std::to_string(pid) + ": " + why, id);
    return exit_other;
  };
  while (std::cout.good()) {
    auto line = client.receive(Duration{0});
    if (line && !*line) {
      std::cout << std::flush;
      line = client.receive(longest_silence);
    }
    if (!line) return fail(line.error().text(), line.error().id());
    if (!*line) return fail(instance_does_not_answer().text(), instance_does_not_answer().id());
    const std::string& text = **line;
    if (text.starts_with("{\"error\":")) return fail(Json::parse(text).at("error").get<std::string>(), "refused");
    if (show_as == ShowAs::json) {
      std::cout << text << '\n';
    } else {
      std::cout << printer.text(text);
    }
    if (text.starts_with("{\"ended\":")) {
      std::cout << std::flush;
      std::cerr << "rtdata: pid " << pid << " has ended" << std::endl;
      return exit_good;
    }
  }
  return exit_good;  // nobody reads what it prints
}

/// Warns of a topic without events: with a mistyped topic the user would wait for ever.
void tell_unknown(const std::vector<std::string>& topics, const Status& status) {
  std::vector<std::string> names;
  for (const Status::Account& topic : status.topics) names.push_back(topic.name);
  for (const std::string& wanted : topics) {
    if (wanted.starts_with('$') ||
        std::any_of(names.begin(), names.end(), [&](const std::string& name) { return topic_matches(wanted, name); }))
      continue;
    const std::string nearest = nearest_name(wanted, names);
    std::cerr << "rtdata: nothing is published on \"" << wanted << "\" now; waiting for the first event"
              << (nearest.empty() ? "" : " (did you mean \"" + nearest + "\"?)") << std::endl;
  }
}

}  // namespace

int tail(const TailOptions& options) {
  std::vector<std::string> topics = options.words;
  std::string instance;
  if (!topics.empty() && is_instance(topics.front())) {
    instance = topics.front();
    topics.erase(topics.begin());
  }
  int status = exit_good;
  std::optional<FoundInstance> found = choose_instance(instance, "tail", status);
  if (!found) return status;
  // The status that was asked for comes first.
  if (!found->answers) (void)found->client->receive(answer_limit);
  if (!topics.empty()) {
    const auto line = found->client->ask(status_request, answer_limit);
    if (const auto now = line ? status_from(*line) : Result<Status>(line.error())) tell_unknown(topics, *now);
  }
  Json request{{"request", "subscribe"}, {"version", Status::newest}};
  if (!topics.empty()) request["topics"] = topics;
  if (!options.step.empty()) request["step"] = options.step;
  if (!options.from.empty()) request["from"] = options.from;
  found->client->send(request.dump(-1, ' ', false, Json::error_handler_t::replace));
  return follow(*found->client, found->instance.pid, options.show_as);
}

}  // namespace rtdata::app
