#include <algorithm>
#include <iostream>
#include <nlohmann/json.hpp>

#include "app/control/commands.hpp"
#include "app/control/instances.hpp"
#include "app/core/configuration_commands.hpp"
#include "app/core/terminal_text.hpp"
#include "rtdata/data/problem.hpp"

namespace rtdata::app {
namespace {

constexpr Duration answer_limit = std::chrono::seconds{10};

std::vector<std::string> known_verbs() {
  std::vector<std::string> all;
  for (const CommandHelp& one : command_help()) {
    const std::string words = one.words;
    all.push_back(words.substr(0, words.find(' ')));
  }
  return all;
}
bool is_verb(const std::string& word) {
  const std::vector<std::string> all = known_verbs();
  return std::find(all.begin(), all.end(), word) != all.end();
}

}  // namespace

std::string ctl_help() {
  std::string text = "commands:\n";
  for (const CommandHelp& one : command_help()) {
    std::string words = "  " + std::string(one.words);
    words.resize(std::max<std::size_t>(words.size() + 2, 22), ' ');
    text += words + one.meaning + "\n";
  }
  return text;
}

int ctl(const std::vector<std::string>& given) {
  if (given.empty()) {
    print_error(std::cerr, "which command?", "bad-argument");
    std::cerr << ctl_help() << std::flush;
    return exit_configuration;
  }
  // The first word may be an instance. An instance with the name of a command must be given by its pid.
  std::vector<std::string> words = given;
  std::string instance;
  if (words.size() > 1 && !is_verb(words[0]) && is_verb(words[1])) {
    instance = words[0];
    words.erase(words.begin());
  }
  if (!is_verb(words[0])) {
    const std::string nearest = nearest_name(words[0], known_verbs());
    print_error(
        std::cerr,
        "there is no command \"" + words[0] + "\"" + (nearest.empty() ? "" : "; did you mean \"" + nearest + "\"?"),
        "bad-argument");
    std::cerr << ctl_help() << std::flush;
    return exit_configuration;
  }
  int status = exit_good;
  std::optional<FoundInstance> found = choose_instance(instance, "ctl", status);
  if (!found) return status;
  // The answer to the status request comes first.
  if (!found->answers) (void)found->client->receive(answer_limit);
  const nlohmann::ordered_json request{{"request", "command"}, {"version", Status::newest}, {"words", words}};
  const auto line = found->client->ask(request.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace),
                                       answer_limit);
  const auto fail = [&](const std::string& why, std::string_view id) {
    print_error(std::cerr, "pid " + std::to_string(found->instance.pid) + ": " + why, id);
    return exit_other;
  };
  if (!line)
    return fail(line.error().text() + "; the log of the instance says whether the command was done", line.error().id());
  if (line->find_first_not_of(" \r\n") == std::string::npos)
    return fail("the command is not done yet; the log of the instance will have the result", "timed-out");
  const auto answer = nlohmann::ordered_json::parse(*line, nullptr, false);
  for (const char* key : {"done", "refused", "error", "ended"}) {
    if (!answer.is_object() || !answer.contains(key) || !answer[key].is_string()) continue;
    const std::string text = answer[key].get<std::string>();
    if (std::string(key) != "done") return fail(text, "refused");
    std::cout << text << std::endl;
    return exit_good;
  }
  return fail("the answer of the instance does not fit the request; use the same version of the program on both sides",
              "bad-data");
}

}  // namespace rtdata::app
