#include <poll.h>
#include <signal.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdio>
#include <functional>
#include <iostream>
#include <nlohmann/json.hpp>
#include <optional>

#include "app/control/control_socket.hpp"
#include "app/control/top_view.hpp"
#include "app/core/configuration_commands.hpp"
#include "app/core/table.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* request = R"({"request":"status"})";
constexpr Duration search_limit = std::chrono::milliseconds{500};  // of all instances, when the one meant has answered
constexpr Duration longest_search = std::chrono::seconds{3};       // when it has not
constexpr Duration answer_limit = std::chrono::seconds{5};         // of the one that is looked at
constexpr Duration once_limit = std::chrono::seconds{3};           // with --once
constexpr Duration most_deaf = std::chrono::milliseconds{50};      // to keys and signals
constexpr Duration refresh = std::chrono::seconds{1};

std::string text_or_dash(const Json& value) { return value.is_string() ? value.get<std::string>() : "-"; }

/// An answer that is a status; errors of the other side are errors.
Result<Json> status_of(const std::string& line) {
  Json status = Json::parse(line, nullptr, false);
  if (status.is_object() && status.contains("instance")) return status;
  if (status.is_object() && status.contains("ended"))
    return Error{Errc::closed, "no status", "instance", "it has ended", "start it again"};
  const bool says_why = status.is_object() && status.contains("error");
  return Error{Errc::io_failed, "no status", "instance",
               says_why ? text_or_dash(status["error"]) : "it answers something else",
               "use the same version of the program on both sides"};
}

struct Found {
  Instance instance;
  std::optional<ControlClient> client;  // none: it takes no connection
  bool answers = false;
  std::string name;           // empty: not known
  std::string configuration;  // or why nothing is known

  /// By name or pid; every one when none is given.
  bool matches(const std::string& wanted) const {
    return wanted.empty() || wanted == name || wanted == std::to_string(instance.pid);
  }
  void hear(Duration at_most) {
    const auto line = client->receive(at_most);
    if (line && !*line) return;
    answers = true;
    const Result<Json> status = line ? status_of(**line) : Result<Json>(line.error());
    if (status) name = text_or_dash(status->at("instance").at("name"));
    configuration = status ? text_or_dash(status->at("instance").at("configuration")) : status.error().text();
  }
};

/// All are asked at once, and waited for together. `wanted`: see Found::matches.
std::vector<Found> find_instances(const std::string& wanted) {
  std::vector<Found> all;
  for (Instance& instance : running_instances()) {
    Found found{std::move(instance), {}, false, "", "does not answer"};
    if (auto client = ControlClient::connect(found.instance.path)) {
      client->send(request);
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

Error does_not_answer() {
  return {Errc::timed_out, "no status", "instance", "it does not answer",
          "see whether it is stopped, its loop is held, or the machine is busy"};
}

volatile sig_atomic_t interrupted = 0;

/// While it lives: keys come one by one and unseen, and Ctrl-C ends the view rather than the process.
class Terminal {
 public:
  Terminal() {
    struct sigaction action {};
    action.sa_handler = [](int) { interrupted = 1; };
    for (const int signal : {SIGINT, SIGTERM, SIGHUP}) ::sigaction(signal, &action, nullptr);
    is_changed_ = ::tcgetattr(STDIN_FILENO, &before_) == 0;
    if (!is_changed_) return;
    termios now = before_;
    now.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO);
    ::tcsetattr(STDIN_FILENO, TCSANOW, &now);
  }
  Terminal(const Terminal&) = delete;
  Terminal& operator=(const Terminal&) = delete;
  ~Terminal() {
    if (is_changed_) ::tcsetattr(STDIN_FILENO, TCSANOW, &before_);
  }
  /// False: it is to end, since q was typed or a signal came.
  bool wait(Duration duration) {
    const auto until = std::chrono::steady_clock::now() + duration;
    while (interrupted == 0) {
      const Duration left = std::clamp<Duration>(until - std::chrono::steady_clock::now(), Duration{0}, most_deaf);
      pollfd keys{has_keys_ ? STDIN_FILENO : -1, POLLIN, 0};
      const auto left_ms = std::chrono::ceil<std::chrono::milliseconds>(left).count();
      if (::poll(&keys, 1, static_cast<int>(left_ms)) <= 0) {
        if (left == Duration{0}) return interrupted == 0;
        continue;
      }
      char key = 0;
      if (::read(STDIN_FILENO, &key, 1) != 1) {
        has_keys_ = false;
      } else if (key == 'q' || key == 'Q') {
        return false;
      }
    }
    return false;
  }

 private:
  termios before_{};
  bool is_changed_ = false;
  bool has_keys_ = true;
};

void print(const std::string& text) { std::cout << text << std::flush; }

/// The next answer; none when the terminal ends the wait. `tell_silence` is called once, when none came for a while.
std::optional<Result<std::string>> receive(ControlClient& client, Terminal& terminal, Duration limit,
                                           const std::function<void()>& tell_silence) {
  const auto begun = std::chrono::steady_clock::now();
  for (bool is_told = false;;) {
    auto line = client.receive(most_deaf);
    if (!line) return std::move(line).error();
    if (*line) return std::move(**line);
    if (!terminal.wait(Duration{0})) return std::nullopt;
    const Duration waited = std::chrono::steady_clock::now() - begun;
    if (waited > limit) return does_not_answer();
    if (!is_told && waited > search_limit) {
      tell_silence();
      is_told = true;
    }
  }
}

int show(Found& found, const TopOptions& options) {
  Terminal terminal;
  const bool is_live = options.how_often == HowOften::live && options.show_as == ShowAs::text &&
                       ::isatty(STDOUT_FILENO) == 1;
  std::string failed;
  bool has_ended = false;  // as it should, and said so
  if (is_live) print("\x1b[?25l\x1b[2J");
  const Duration limit = options.how_often == HowOften::once ? once_limit : answer_limit;
  const auto next_answer = [&] {
    return receive(*found.client, terminal, limit, [&] {
      if (is_live) print("\x1b[H\x1b[Jpid " + std::to_string(found.instance.pid) + " does not answer\r\nq ends");
    });
  };
  // Rates are known from the second answer on: the first was the search.
  bool goes_on = true;
  if (!found.answers) {
    const auto first = next_answer();
    goes_on = first.has_value();
    if (first && !*first) failed = first->error().text();
  }
  while (goes_on && failed.empty() && std::cout.good() && terminal.wait(refresh)) {
    found.client->send(request);
    const auto line = next_answer();
    if (!line) break;
    const Result<Json> status = *line ? status_of(**line) : Result<Json>(line->error());
    if (!status) {
      failed = status.error().text();
      has_ended = *line && status.error().code == make_error_code(Errc::closed);
      break;
    }
    if (options.show_as == ShowAs::json) {
      print(**line + "\n");
    } else {
      winsize size{};
      if (!is_live || ::ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) != 0 || size.ws_col == 0) size = {24, 80, 0, 0};
      const std::size_t rows = is_live ? std::max<std::size_t>(size.ws_row, 4) - 1 : 100000;
      std::string text = is_live ? "\x1b[H" : "";
      std::size_t shown = 0;
      for (const std::string& one : lines_of_status(**line, std::max<std::size_t>(size.ws_col, 20) - 1, rows)) {
        if (++shown > rows) break;
        text += one + (is_live ? "\x1b[K\r\n" : "\n");
      }
      text += is_live ? "\x1b[Jq ends" : options.how_often == HowOften::live ? "\n" : "";
      print(text);
    }
    if (options.how_often == HowOften::once) return exit_good;
  }
  if (is_live) print("\r\x1b[K\x1b[?25h");
  if (failed.empty()) return options.how_often == HowOften::once ? exit_other : exit_good;
  if (has_ended && options.how_often == HowOften::live) {
    std::cerr << "rtdata: pid " << found.instance.pid << " has ended" << std::endl;
    return exit_good;
  }
  std::cerr << "rtdata: pid " << found.instance.pid << ": " << failed << std::endl;
  return exit_other;
}

}  // namespace

int top(const TopOptions& options) {
  std::vector<Found> instances = find_instances(options.instance);
  if (instances.empty()) {
    std::cerr << "rtdata: no instance is running that this user may look at; `rtdata run FILE` starts one" << std::endl;
    for (const std::string& folder : closed_folders())
      std::cerr << "rtdata: " << folder << " is of another user, such as a service: `sudo rtdata top`" << std::endl;
    return exit_other;
  }
  std::vector<const Found*> all, matching;
  Found* chosen = nullptr;
  bool all_answer = true;
  for (Found& one : instances) {
    all.push_back(&one);
    all_answer = all_answer && one.answers;
    if (!one.matches(options.instance)) continue;
    matching.push_back(&one);
    chosen = &one;
  }
  if (matching.empty()) {
    std::cerr << "rtdata: no running instance" << (all_answer ? "" : " that answers") << " is called \""
              << options.instance << "\"; there are:\n"
              << list_of(all) << (all_answer ? "" : "name one that does not answer by its pid\n") << std::flush;
    return exit_other;
  }
  if (matching.size() > 1) {
    std::cerr << "rtdata: several instances are running; name one, by pid or name:\n"
              << list_of(matching) << std::flush;
    return exit_configuration;
  }
  Found found = std::move(*chosen);
  if (!found.client) {
    std::cerr << "rtdata: pid " << found.instance.pid << ": " << does_not_answer().text() << std::endl;
    return exit_other;
  }
  instances.clear();  // the others' connections
  return show(found, options);
}

}  // namespace rtdata::app
