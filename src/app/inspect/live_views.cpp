// Fields of a running instance: as curves, and as a table.
#include <unistd.h>

#include <algorithm>
#include <functional>
#include <iostream>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "app/control/instances.hpp"
#include "app/control/status_view.hpp"
#include "app/control/terminal.hpp"
#include "app/core/configuration_commands.hpp"
#include "app/core/table.hpp"
#include "app/core/terminal_text.hpp"
#include "app/inspect/curve_scale.hpp"
#include "app/inspect/live_curves.hpp"
#include "app/inspect/names.hpp"
#include "app/inspect/plot_picture.hpp"

namespace rtdata::app {
namespace {

using namespace std::chrono_literals;
using Lines = std::vector<std::string>;
using Clock = std::chrono::steady_clock;

constexpr Duration answer_limit = 5s;
constexpr Duration longest_silence = 10s;  // an instance says something every second
constexpr Duration refresh = 1s;
constexpr Duration most_deaf = 20ms;  // longest time without a check for keys

/// The view of an instance.
struct View {
  const char* command;
  std::vector<std::string> fields;
  Duration window, step;
  HowOften how_often;
  /// With `once`: how long it waits if no recording has earlier events, or nothing comes.
  Duration once_after;
  std::function<Lines(const LiveCurves&, const Status&)> draw;
};

/// Two connections to one instance: one for its status, one for the steps.
class Watch {
 public:
  Watch(FoundInstance& found, const View& view)
      : view_(view), pid_(found.instance.pid), asked_(*found.client), steps_(connected(found)) {
    // The status that was asked for comes first.
    if (!found.answers) (void)asked_.receive(answer_limit);
    ask_status();
    std::vector<std::string> topics;
    for (const Status::Account& topic : status_.topics) topics.push_back(topic.name);
    curves_.emplace(view.fields, topics, view.window);
    steps_.send(curves_->request(view.step, true));
  }

  int show() {
    const bool is_once = view_.how_often == HowOften::once;
    const bool is_live = !is_once && ::isatty(STDOUT_FILENO) == 1;
    Terminal terminal;
    std::optional<HiddenCursor> cursor(std::in_place, is_live);
    const Clock::time_point begun = Clock::now();
    for (bool goes_on = true; goes_on && std::cout.good();) {
      goes_on = take_lines(terminal, begun);
      if (is_interrupted_ || !failed_.empty()) break;
      const bool is_enough = Clock::now() - begun >= view_.once_after ||
                             (has_past_ && curves_->is_live() && !curves_->is_empty() && !view_.fields.empty());
      if (is_once && !is_enough && goes_on) continue;
      if (goes_on) ask_status();
      Lines lines = view_.draw(*curves_, status_);
      if (is_live) lines.resize(std::min(lines.size(), terminal_size().rows - 1));
      std::string text = is_live ? "\x1b[H" : "";
      for (const std::string& line : lines) text += line + (is_live ? "\x1b[K\r\n" : "\n");
      print(text + (is_live ? "\x1b[Jq ends" : ""));
      if (is_once) break;
    }
    cursor.reset();  // before the messages at the end
    if (failed_.empty() && has_ended_) std::cerr << "rtdata: pid " << pid_ << " has ended" << std::endl;
    if (failed_.empty()) return exit_good;
    print_error(std::cerr, "pid " + std::to_string(pid_) + ": " + failed_, "");
    return exit_other;
  }

 private:
  static ControlClient connected(const FoundInstance& found) {
    return ControlClient::connect(found.instance.path).or_throw();
  }

  void ask_status() {
    const auto line = asked_.ask(status_request, answer_limit);
    auto status = line ? status_from(*line) : Result<Status>(line.error());
    if (status || is_first_) status_ = std::move(status).or_throw();
    is_first_ = false;
  }

  /// Takes events until the next drawing. False: nothing more comes.
  bool take_lines(Terminal& terminal, Clock::time_point begun) {
    const Clock::time_point until = Clock::now() + refresh;
    while (failed_.empty() && (Clock::now() < until || !curves_->is_live())) {
      if (!terminal.wait(0s)) {
        is_interrupted_ = true;
        return false;
      }
      if (view_.how_often == HowOften::once && Clock::now() - begun >= view_.once_after) return true;
      const auto line = steps_.receive(most_deaf);
      if (!line) {
        failed_ = line.error().text_with_id();  // closed without a message: it was killed
        return false;
      }
      if (!*line) {
        if (Clock::now() - last_heard_ > longest_silence) failed_ = instance_does_not_answer().text_with_id();
        continue;
      }
      last_heard_ = Clock::now();
      if (!take(**line)) return false;
    }
    return failed_.empty();
  }

  /// False: it was the last line.
  bool take(const std::string& line) {
    if (line.starts_with("{\"ended\":")) {
      has_ended_ = true;
      return false;
    }
    if (!line.starts_with("{\"error\":")) {
      curves_->take(line);
      is_subscribed_ = true;
      return true;
    }
    if (is_subscribed_ || !has_past_) {
      failed_ = detail::with_id(nlohmann::json::parse(line).at("error").get<std::string>(), "refused");
      return false;
    }
    has_past_ = false;  // no recording has it
    steps_.send(curves_->request(view_.step, false));
    return true;
  }

  const View& view_;
  const pid_t pid_;
  ControlClient& asked_;
  ControlClient steps_;
  Status status_;
  std::optional<LiveCurves> curves_;
  Clock::time_point last_heard_ = Clock::now();
  bool is_first_ = true, has_past_ = true, is_subscribed_ = false, has_ended_ = false, is_interrupted_ = false;
  std::string failed_;
};

int show(const std::string& instance, const View& view) try {
  int status = exit_good;
  std::optional<FoundInstance> found = choose_instance(instance, view.command, status);
  return found ? Watch(*found, view).show() : status;
} catch (const SetupError& error) {
  print_error(std::cerr, error.error());
  return exit_other;
}

Lines lines_in(const std::string& text) {
  Lines lines;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    lines.push_back(text.substr(at, end - at));
    at = end + 1;
  }
  return lines;
}

/// One number per line, over the whole kept time.
Lines table_of(const LiveCurves& curves, Time now) {
  Table table({"field", ">last", "unit", ">least", ">mean", ">most", ">age"});
  const std::vector<const LiveCurves::Field*> fields = curves.fields();
  for (const LiveCurves::Field* const field : fields) {
    CurveStep all;
    for (const CurveStep& step : field->curve.steps)
      if (step.numbers != 0) join(step, all);
    const bool has_several = std::any_of(fields.begin(), fields.end(), [&](const auto* other) {
      return other->curve.path == field->curve.path && other->curve.origin != field->curve.origin;
    });
    const auto of_all = [&](const Number& number) { return all.numbers == 0 ? "-" : shown_value(as_double(number)); };
    const Duration age = std::max<Duration>(now - field->last_at, 0s);
    table.add({field->curve.path + (has_several ? " of " + field->curve.origin : ""),
               field->has_last ? shown_value(field->last) : "-", field->curve.unit, of_all(all.least),
               all.numbers == 0 ? "-" : shown_value(all.mean), of_all(all.most),
               field->has_last ? to_string(std::chrono::floor<std::chrono::seconds>(age)) : "-"});
  }
  return lines_in(table.text(""));
}

/// Only this topic's sensors.
Status status_of_topic(const Status& status, const std::string& topic) {
  Status of = status;
  std::erase_if(of.sensors, [&](const Status::Sensor& sensor) { return sensor.topic != topic; });
  std::erase_if(of.loops, [&](const Status::Loop& loop) {
    return std::none_of(of.sensors.begin(), of.sensors.end(),
                        [&](const Status::Sensor& sensor) { return sensor.loop == loop.name; });
  });
  of.sinks.clear();
  of.parts.clear();
  of.callbacks.clear();
  const auto account = std::find_if(status.topics.begin(), status.topics.end(),
                                    [&](const Status::Account& one) { return one.name == topic; });
  if (account != status.topics.end()) of.total = *account;
  return of;
}

/// The fields received until now that can be plotted.
Lines list_of(const LiveCurves& curves, const Status& status, const std::string& instance) {
  std::map<std::string, std::vector<std::string>> by_topic;
  for (const Status::Account& topic : status.topics) by_topic[topic.name];
  for (const LiveCurves::Field* field : curves.fields()) {
    std::vector<std::string>& paths = by_topic[field->curve.topic];
    if (std::find(paths.begin(), paths.end(), field->curve.path) == paths.end()) paths.push_back(field->curve.path);
  }
  return lines_in(list_of_fields(by_topic, "rtdata plot" + (instance.empty() ? "" : " " + instance)));
}

}  // namespace

int plot_instance(const LivePlotOptions& options) {
  const PlotStyle first = terminal_style();
  const Duration step = std::max<Duration>(step_for(Time{}, Time{} + options.window, first), 1ms);
  const bool is_terminal = ::isatty(STDOUT_FILENO) == 1;
  std::vector<std::string> fields = options.words;
  std::string instance;
  if (!fields.empty() && is_instance(fields.front())) {
    instance = fields.front();
    fields.erase(fields.begin());
  }
  if (fields.empty())
    return show(instance,
                {"plot", {}, 1min, 1s, HowOften::once, 2s, [&](const LiveCurves& curves, const Status& status) {
                   return list_of(curves, status, instance);
                 }});
  return show(instance, {"plot", std::move(fields), options.window, step, is_terminal ? HowOften::live : HowOften::once,
                         options.window, [&](const LiveCurves& curves, const Status& status) -> Lines {
                           if (curves.is_empty()) return {"no events so far"};
                           PlotStyle style = terminal_style();
                           if (is_terminal) --style.rows;  // "q ends"
                           // A terminal that was made smaller has room for longer steps only.
                           const Duration least = step_for(Time{}, Time{} + options.window, style);
                           return picture_of(
                               curves.plot(step * std::max<Duration::rep>((least + step - 1ns) / step, 1), status),
                               style);
                         }});
}

int top_topic(const TopOptions& options) {
  return show(
      options.instance,
      {"top", {options.topic}, 1min, 1s, options.how_often, 3s, [&](const LiveCurves& curves, const Status& status) {
         const bool is_live = options.how_often == HowOften::live && ::isatty(STDOUT_FILENO) == 1;
         const TerminalSize size = is_live ? terminal_size() : TerminalSize{80, 100000};
         const Lines table = table_of(curves, curves.now());
         const std::size_t rows = size.rows - 1;
         const std::size_t for_table = std::min(table.size() + 2, rows * 2 / 3);
         Lines lines = lines_of(status_of_topic(status, options.topic), size.columns - 1, rows - for_table);
         lines.emplace_back();
         lines.emplace_back("the last minute:");
         lines.insert(lines.end(), table.begin(), table.end());
         if (lines.size() > rows) lines.resize(rows);
         for (std::string& line : lines) line = fitted(printable(line), size.columns - 1);
         return lines;
       }});
}

}  // namespace rtdata::app
