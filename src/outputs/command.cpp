#include "rtdata/outputs/command.hpp"

#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <string_view>

#include "data/setting_mistake.hpp"
#include "io/child_process.hpp"
#include "outputs/set_text.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_set_command = "cannot set the value by the program";
constexpr std::size_t longest_errors = 4096;

/// Reads the available output, so that the program is not blocked, and keeps its end.
void read_printed(int fd, std::string& kept) {
  std::array<char, 4096> bytes;
  for (int i = 0; i < 64; ++i) {
    const ssize_t got = ::read(fd, bytes.data(), bytes.size());
    if (got <= 0) return;
    kept.append(bytes.data(), static_cast<std::size_t>(got));
    if (kept.size() > longest_errors) kept.erase(0, kept.size() - longest_errors);
  }
}

std::string last_line(std::string_view text) {
  while (!text.empty() && (text.back() == '\n' || text.back() == '\r')) text.remove_suffix(1);
  const std::size_t before = text.rfind('\n');
  if (before != text.npos) text.remove_prefix(before + 1);
  return std::string(text.substr(0, 500));
}

struct EndOfChild {
  const detail::Child& child;
  ~EndOfChild() { detail::end_child(child); }
};

}  // namespace

void check_config(const CommandActuatorConfig& config, const ConfigItem& item, Problems& problems) {
  detail::check_words(config.words, item, problems);
  const auto refuse = [&](const char* why) { detail::add_mistake({"run", why}, item, problems); };
  if (config.run.empty() || config.run.front().empty()) return refuse("there is no program");
  detail::add_mistake(detail::mistake_in_program(config.run), item, problems);
  if (std::none_of(config.run.begin() + 1, config.run.end(), detail::has_value_mark))
    refuse("every value would run the same command: write {value} into an argument");
}

Result<void> CommandActuator::open(std::optional<double> value) { return value ? set(*value) : Result<void>(); }

Result<void> CommandActuator::set(double value) {
  const auto until = std::chrono::steady_clock::now() + config_.timeout;
  if (config_.run.empty()) return Error{Errc::bad_argument, cannot_set_command, "", "there is no program", "set `run`"};
  std::vector<std::string> run = config_.run;
  for (auto argument = run.begin() + 1; argument != run.end(); ++argument)
    *argument = detail::set_text(*argument, value, config_.words);
  const Result<detail::Child> started = detail::start_child(run, detail::ChildPrints::to_pipe);
  if (!started) return started.error();
  const EndOfChild end{*started};
  std::string printed, errors;
  std::array<pollfd, 3> waiting{
      {{started->ended, POLLIN, 0}, {started->output, POLLIN, 0}, {started->errors, POLLIN, 0}}};
  while ((waiting[0].revents & POLLIN) == 0) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(until - std::chrono::steady_clock::now());
    const int ready = left.count() > 0 ? ::poll(waiting.data(), waiting.size(), static_cast<int>(left.count())) : 0;
    if (ready < 0 && errno != EINTR) return system_error(errno, cannot_set_command, run.front());
    if (ready == 0)
      return Error{Errc::timed_out, cannot_set_command, run.front(),
                   "the program did not end within " + to_string(config_.timeout),
                   "set a longer `timeout`, or check the program: it was ended"};
    if (ready < 0) continue;
    read_printed(started->output, printed);
    read_printed(started->errors, errors);
    for (std::size_t i = 1; i < waiting.size(); ++i)
      if ((waiting[i].revents & POLLIN) == 0 && waiting[i].revents != 0) waiting[i].fd = -1;  // it was closed
  }
  read_printed(started->errors, errors);
  if (detail::has_succeeded(*started)) return {};
  std::string why = detail::end_of(*started);
  if (const std::string said = last_line(errors); !said.empty()) why += "; it said: " + said;
  return Error{Errc::disconnected, cannot_set_command, run.front(), std::move(why),
               "check the program: `run` it by hand"};
}

}  // namespace rtdata
