#include <unistd.h>

#include <algorithm>
#include <functional>
#include <iostream>
#include <optional>

#include "app/control/instances.hpp"
#include "app/control/status_view.hpp"
#include "app/control/terminal.hpp"
#include "app/core/configuration_commands.hpp"
#include "app/core/terminal_text.hpp"
#include "data/utf8.hpp"

namespace rtdata::app {
namespace {

constexpr Duration silence_limit = std::chrono::milliseconds{500};  // then the view shows the silence
constexpr Duration answer_limit = std::chrono::seconds{5};          // for the watched instance
constexpr Duration once_limit = std::chrono::seconds{3};            // with --once
constexpr Duration most_deaf = std::chrono::milliseconds{50};       // longest time without a check for keys
constexpr Duration refresh = std::chrono::seconds{1};

/// The next answer; empty if the terminal ends the wait. Calls `report_silence` once if there is no answer for a while.
std::optional<Result<std::string>> receive(ControlClient& client, Terminal& terminal, Duration limit,
                                           const std::function<void()>& report_silence) {
  const auto begun = std::chrono::steady_clock::now();
  for (bool is_reported = false;;) {
    auto line = client.receive(most_deaf);
    if (!line) return std::move(line).error();
    if (*line) return std::move(**line);
    if (!terminal.wait(Duration{0})) return std::nullopt;
    const Duration waited = std::chrono::steady_clock::now() - begun;
    if (waited > limit) return instance_does_not_answer();
    if (!is_reported && waited > silence_limit) {
      report_silence();
      is_reported = true;
    }
  }
}

int show(FoundInstance& found, const TopOptions& options) {
  Terminal terminal;
  const bool is_live = options.how_often == HowOften::live && options.show_as == ShowAs::text &&
                       ::isatty(STDOUT_FILENO) == 1;
  std::string failed;
  bool has_ended = false;  // normally, with its last answer
  std::optional<HiddenCursor> cursor(std::in_place, is_live);
  const Duration limit = options.how_often == HowOften::once ? once_limit : answer_limit;
  const auto next_answer = [&] {
    return receive(*found.client, terminal, limit, [&] {
      if (is_live) print("\x1b[H\x1b[Jpid " + std::to_string(found.instance.pid) + " does not answer\r\nq ends");
    });
  };
  // Rates are known from the second answer on; the search used the first.
  bool goes_on = true;
  if (!found.answers) {
    const auto first = next_answer();
    goes_on = first.has_value();
    if (first && !*first) failed = first->error().text_with_id();
  }
  while (goes_on && failed.empty() && std::cout.good() && terminal.wait(refresh)) {
    found.client->send(status_request);
    const auto line = next_answer();
    if (!line) break;
    const auto status = *line ? status_from(**line) : Result<Status>(line->error());
    if (!status) {
      failed = status.error().text_with_id();
      has_ended = *line && status.error().code == make_error_code(Errc::closed);
      break;
    }
    if (options.show_as == ShowAs::json) {
      print(**line + "\n");
    } else {
      const TerminalSize size = is_live ? terminal_size() : TerminalSize{};
      const std::size_t rows = is_live ? size.rows - 1 : 100000;
      std::string text = is_live ? "\x1b[H" : "";
      std::size_t shown = 0;
      for (const std::string& one : lines_of(*status, std::max<std::size_t>(size.columns, 20) - 1, rows)) {
        if (++shown > rows) break;
        text += detail::visible(one) + (is_live ? "\x1b[K\r\n" : "\n");
      }
      text += is_live ? "\x1b[Jq ends" : options.how_often == HowOften::live ? "\n" : "";
      print(text);
    }
    if (options.how_often == HowOften::once) return exit_good;
  }
  cursor.reset();  // before the messages at the end
  if (failed.empty()) return options.how_often == HowOften::once ? exit_other : exit_good;
  if (has_ended && options.how_often == HowOften::live) {
    std::cerr << "rtdata: pid " << found.instance.pid << " has ended" << std::endl;
    return exit_good;
  }
  print_error(std::cerr, "pid " + std::to_string(found.instance.pid) + ": " + failed, "");
  return exit_other;
}

}  // namespace

int top(const TopOptions& options) {
  int status = exit_good;
  std::optional<FoundInstance> found = choose_instance(options.instance, "top", status);
  return found ? show(*found, options) : status;
}

}  // namespace rtdata::app
