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
#include "app/core/configuration_commands.hpp"
#include "app/core/table.hpp"
#include "data/rounded_time.hpp"
#include "rtdata/loop/ledger.hpp"

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
constexpr std::size_t most_callbacks = 5;

std::string right(const std::string& text, std::size_t width) {
  const std::size_t have = width_of(text);
  return have < width ? std::string(width - have, ' ') + text : text;
}

std::string left(std::string_view text, std::size_t width) {
  std::string cut = fitted(text, width);
  cut.append(width - std::min(width, width_of(cut)), ' ');
  return cut;
}

/// "12.3 us"; "-" for what is not known.
std::string time_text(const Json& ns) { return ns.is_number() ? detail::rounded_time(ns.get<double>()) : "-"; }
std::string rate_text(const Json& hertz) { return hertz.is_number() ? frequency_text(hertz.get<double>()) : "-"; }
std::string count_text(const Json& count) { return count.is_number() ? short_count(count.get<std::uint64_t>()) : "-"; }
std::string text_or_dash(const Json& value) { return value.is_string() ? value.get<std::string>() : "-"; }

/// The status as at most `rows` lines of at most `columns`. Sensors that find no room are left out, and their number is
/// shown.
std::vector<std::string> lines_of(const Json& status, std::size_t columns, std::size_t rows) {
  const Json& instance = status.at("instance");
  std::vector<std::string> head, sensors, tail;
  const auto seconds = std::chrono::seconds{static_cast<std::int64_t>(instance.at("running_for_s").get<double>())};
  head.push_back(text_or_dash(instance.at("name")) + "  pid " + instance.at("pid").dump() + "  running " +
                 to_string(Duration{seconds}) + "  " + text_or_dash(instance.at("configuration")));
  head.push_back("");
  head.push_back("loop          policy    load  late p50       p99       max");
  for (const Json& loop : status.at("loops")) {
    const Json& late = loop.at("lateness_ns");
    std::array<char, 16> load{"-"};
    if (loop.at("load_percent").is_number())
      std::snprintf(load.data(), load.size(), "%.1f %%", loop.at("load_percent").get<double>());
    const int priority = loop.at("priority").get<int>();
    const auto lateness = [&](const char* what) {
      return right(late.is_object() ? time_text(late.at(what)) : "-", 10);
    };
    head.push_back(left(text_or_dash(loop.at("name")), 13) + " " +
                   left(text_or_dash(loop.at("policy")) + (priority > 0 ? " " + std::to_string(priority) : ""), 6) +
                   right(load.data(), 8) + lateness("p50") + lateness("p99") + lateness("max"));
    for (const Json& warning : loop.at("warnings")) head.push_back("  ! " + text_or_dash(warning));
    if (loop.at("hangs_in").is_string())
      head.push_back("  ! it does not turn: it has not come out of " + text_or_dash(loop.at("hangs_in")));
  }
  head.push_back("");
  const auto unreadable = [](const Json& sensor) { return sensor.value("unreadable", std::uint64_t{0}); };
  const auto& all = status.at("sensors");
  const bool has_unreadable = std::any_of(all.begin(), all.end(), [&](const Json& s) { return unreadable(s) > 0; });
  head.push_back("sensor         loop       wanted    reached   late missed failed" +
                 std::string(has_unreadable ? " unread" : "") + "  value");
  const auto add_health = [](std::vector<std::string>& lines, const Json& of) {
    const Json& health = of.at("health");
    if (health.at("state") != "ok")
      lines.push_back("  ! " + text_or_dash(health.at("state")) + ": " + text_or_dash(health.at("reason")));
  };
  for (const Json& sensor : status.at("sensors")) {
    sensors.push_back(left(text_or_dash(sensor.at("name")), 14) + " " + left(text_or_dash(sensor.at("loop")), 7) +
                      right(rate_text(sensor.at("wanted_hz")), 10) + right(rate_text(sensor.at("reached_hz")), 11) +
                      right(count_text(sensor.at("late")), 7) + right(count_text(sensor.at("missed")), 7) +
                      right(count_text(sensor.at("failed")), 7) +
                      (has_unreadable ? right(count_text(unreadable(sensor)), 7) : "") + "  " +
                      (sensor.at("running") == true ? text_or_dash(sensor.at("value")) : "stopped"));
    add_health(sensors, sensor);
    if (const auto number = sensor.value("outages", std::uint64_t{0}); number > 0) {
      const std::chrono::duration<double> time(sensor.value("outage_time_s", 0.0));
      sensors.push_back("  - " + to_string(Outages{number, std::chrono::duration_cast<Duration>(time)}));
    }
  }
  if (!status.at("sinks").empty()) {
    tail.push_back("");
    tail.push_back("sink                              queued    stored   dropped");
    for (const Json& sink : status.at("sinks")) {
      tail.push_back(left(text_or_dash(sink.at("name")), 30) + right(count_text(sink.at("queued")), 10) +
                     right(count_text(sink.at("stored")), 10) + right(count_text(sink.at("dropped")), 10));
      add_health(tail, sink);
    }
  }
  if (status.contains("parts") && !status["parts"].empty()) {
    tail.push_back("");
    tail.push_back("part                           type             used by");
    for (const Json& part : status["parts"]) {
      std::string users;
      for (const Json& user : part.at("users")) users += (users.empty() ? "" : ", ") + text_or_dash(user);
      tail.push_back(left(text_or_dash(part.at("kind")) + " " + text_or_dash(part.at("name")), 30) + " " +
                     left(text_or_dash(part.at("type")), 16) + " " + (users.empty() ? "-" : users));
      if (!part.contains("places")) continue;
      for (const Json& place : part["places"]) {
        const auto count = [&](const char* key) { return place.value(key, std::uint64_t{0}); };
        if (count("transfers") == 0) continue;
        tail.push_back("  - " + text_or_dash(place.at("place")) + ": " + std::to_string(count("transfers")) +
                       " transfers, " + std::to_string(count("failed")) + " failed, " +
                       std::to_string(count("retried")) + " retries, held it for " + time_text(place.at("busy_ns")));
      }
    }
  }
  if (!status.at("callbacks").empty()) {
    tail.push_back("");
    tail.push_back("callback                       loop         count     total       max");
    std::size_t shown = 0;
    for (const Json& callback : status.at("callbacks")) {
      if (++shown > most_callbacks) break;
      tail.push_back(left(text_or_dash(callback.at("name")), 30) + " " + left(text_or_dash(callback.at("loop")), 7) +
                     right(count_text(callback.at("count")), 10) + right(time_text(callback.at("total_ns")), 10) +
                     right(time_text(callback.at("max_ns")), 10));
    }
  }
  const std::size_t room = rows > head.size() + tail.size() + 2 ? rows - head.size() - tail.size() - 1 : 1;
  if (sensors.size() > room) {
    const std::size_t hidden = sensors.size() - room;
    sensors.resize(room);
    sensors.push_back("and " + std::to_string(hidden) + " more lines of sensors");
  }
  std::vector<std::string> lines = std::move(head);
  lines.insert(lines.end(), sensors.begin(), sensors.end());
  lines.insert(lines.end(), tail.begin(), tail.end());
  for (std::string& line : lines) line = fitted(line, columns);
  return lines;
}

/// An answer that is a status; errors of the other side are errors.
Result<Json> status_of(const std::string& line) {
  Json status = Json::parse(line, nullptr, false);
  if (status.is_object() && status.contains("instance")) return status;
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
      for (const std::string& one : lines_of(*status, std::max<std::size_t>(size.ws_col, 20) - 1, rows)) {
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
