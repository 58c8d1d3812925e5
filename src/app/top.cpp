#include <poll.h>
#include <signal.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdio>
#include <iostream>
#include <nlohmann/json.hpp>

#include "app/async_writer.hpp"
#include "app/control_socket.hpp"
#include "app/subcommands.hpp"
#include "app/table.hpp"
#include "data/rounded_time.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* request = R"({"request":"status"})";
constexpr Duration answer_limit = std::chrono::seconds{5};
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
std::string text_of(const Json& value) { return value.is_string() ? value.get<std::string>() : "-"; }

/// Lines of at most `columns` for people. `rows`: at most so many lines; sensors are left out for it, and that is said.
std::vector<std::string> lines_of(const Json& status, std::size_t columns, std::size_t rows) {
  const Json& instance = status.at("instance");
  std::vector<std::string> head, sensors, tail;
  const auto seconds = std::chrono::seconds{static_cast<std::int64_t>(instance.at("running_for_s").get<double>())};
  head.push_back(text_of(instance.at("name")) + "  pid " + instance.at("pid").dump() + "  running " +
                 to_string(Duration{seconds}) + "  " + text_of(instance.at("configuration")));
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
    head.push_back(left(text_of(loop.at("name")), 13) + " " +
                   left(text_of(loop.at("policy")) + (priority > 0 ? " " + std::to_string(priority) : ""), 6) +
                   right(load.data(), 8) + lateness("p50") + lateness("p99") + lateness("max"));
    for (const Json& warning : loop.at("warnings")) head.push_back("  ! " + text_of(warning));
    if (loop.at("hangs_in").is_string())
      head.push_back("  ! it does not turn: it has not come out of " + text_of(loop.at("hangs_in")));
  }
  head.push_back("");
  head.push_back("sensor         loop       wanted    reached   late missed failed  value");
  const auto add_health = [](std::vector<std::string>& lines, const Json& of) {
    const Json& health = of.at("health");
    if (health.at("state") != "ok")
      lines.push_back("  ! " + text_of(health.at("state")) + ": " + text_of(health.at("reason")));
  };
  for (const Json& sensor : status.at("sensors")) {
    sensors.push_back(left(text_of(sensor.at("name")), 14) + " " + left(text_of(sensor.at("loop")), 7) +
                      right(rate_text(sensor.at("wanted_hz")), 10) + right(rate_text(sensor.at("reached_hz")), 11) +
                      right(count_text(sensor.at("late")), 7) + right(count_text(sensor.at("missed")), 7) +
                      right(count_text(sensor.at("failed")), 7) + "  " +
                      (sensor.at("running") == true ? text_of(sensor.at("value")) : "stopped"));
    add_health(sensors, sensor);
  }
  if (!status.at("sinks").empty()) {
    tail.push_back("");
    tail.push_back("sink                              queued    stored   dropped");
    for (const Json& sink : status.at("sinks")) {
      tail.push_back(left(text_of(sink.at("name")), 30) + right(count_text(sink.at("queued")), 10) +
                     right(count_text(sink.at("stored")), 10) + right(count_text(sink.at("dropped")), 10));
      add_health(tail, sink);
    }
  }
  if (!status.at("callbacks").empty()) {
    tail.push_back("");
    tail.push_back("callback                       loop         count     total       max");
    std::size_t shown = 0;
    for (const Json& callback : status.at("callbacks")) {
      if (++shown > most_callbacks) break;
      tail.push_back(left(text_of(callback.at("name")), 30) + " " + left(text_of(callback.at("loop")), 7) +
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

struct Found {
  Instance instance;
  ControlClient client;
  std::string name;
  std::string configuration;
};

/// An answer that is a status; errors of the other side are errors.
Result<Json> ask(ControlClient& client, std::string* as_text = nullptr) {
  auto line = client.ask(request, answer_limit);
  if (!line) return std::move(line).error();
  Json status = Json::parse(*line, nullptr, false);
  if (!status.is_object() || !status.contains("instance")) {
    const bool says_why = status.is_object() && status.contains("error");
    return Error{Errc::io_failed, "no status", "instance",
                 says_why ? text_of(status["error"]) : "it answers something else",
                 "use the same version of the program on both sides"};
  }
  if (as_text != nullptr) *as_text = std::move(*line);
  return status;
}

std::vector<Found> find_instances() {
  std::vector<Found> all;
  for (Instance& instance : running_instances()) {
    auto client = ControlClient::connect(instance.path);
    if (!client) continue;
    auto status = ask(*client);
    std::string name = status ? text_of(status->at("instance").at("name")) : "(" + status.error().text() + ")";
    std::string configuration = status ? text_of(status->at("instance").at("configuration")) : "";
    all.push_back({std::move(instance), std::move(*client), std::move(name), std::move(configuration)});
  }
  return all;
}

std::string list_of(const std::vector<const Found*>& instances) {
  Table table({">pid", "name", "configuration"});
  for (const Found* one : instances) table.add({std::to_string(one->instance.pid), one->name, one->configuration});
  return table.text("  ");
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
      const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(until - std::chrono::steady_clock::now())
                            .count();
      if (left <= 0) return true;
      pollfd keys{has_keys_ ? STDIN_FILENO : -1, POLLIN, 0};
      if (::poll(&keys, 1, static_cast<int>(left)) <= 0) continue;
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

void print(const std::string& text) { write_fully(STDOUT_FILENO, text.data(), text.size()); }

int show(Found& found, const TopOptions& options) {
  Terminal terminal;
  const bool is_live = options.how_often == HowOften::live && options.show_as == ShowAs::text &&
                       ::isatty(STDOUT_FILENO) == 1;
  std::string failed;
  if (is_live) print("\x1b[?25l\x1b[2J");
  // Rates are known from the second answer on: the first was the search.
  while (terminal.wait(refresh)) {
    std::string line;
    auto status = ask(found.client, &line);
    if (!status) {
      failed = status.error().text();
      break;
    }
    if (options.show_as == ShowAs::json) {
      print(line + "\n");
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
  std::cerr << "rtdata: " << failed << std::endl;
  return exit_other;
}

}  // namespace

int top(const TopOptions& options) {
  std::vector<Found> instances = find_instances();
  if (instances.empty()) {
    std::cerr << "rtdata: no instance is running that this user may look at; `rtdata run FILE` starts one" << std::endl;
    return exit_other;
  }
  std::vector<const Found*> all, matching;
  Found* chosen = nullptr;
  for (Found& one : instances) {
    all.push_back(&one);
    const bool matches = options.instance.empty() || options.instance == one.name ||
                         options.instance == std::to_string(one.instance.pid);
    if (!matches) continue;
    matching.push_back(&one);
    chosen = &one;
  }
  if (matching.empty()) {
    std::cerr << "rtdata: no running instance is called \"" << options.instance << "\"; there are:\n"
              << list_of(all) << std::flush;
    return exit_other;
  }
  if (matching.size() > 1) {
    std::cerr << "rtdata: several instances are running; name one, by pid or name:\n"
              << list_of(matching) << std::flush;
    return exit_configuration;
  }
  Found found = std::move(*chosen);
  instances.clear();  // the others' connections
  return show(found, options);
}

}  // namespace rtdata::app
