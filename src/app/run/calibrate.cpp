// `rtdata calibrate`: asks for the true values of what a sensor reads, and writes the points into the configuration.
#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <optional>
#include <utility>

#include "app/core/calibration_text.hpp"
#include "app/core/configuration_commands.hpp"
#include "app/core/replaced_file.hpp"
#include "app/core/terminal_text.hpp"
#include "app/run/raw_values.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/process/processing.hpp"

namespace rtdata::app {
namespace {

using Points = std::vector<std::array<double, 2>>;

constexpr Duration glance = std::chrono::milliseconds{20};     // between two looks at standard input
constexpr Duration settling = std::chrono::milliseconds{150};  // the time before the value was typed
constexpr Duration of_a_point = std::chrono::seconds{2};
constexpr Duration patience = std::chrono::seconds{10};
constexpr int digits_of_raw = 10;

/// Lines of standard input, without waiting for them.
class Lines {
 public:
  enum class State { none, line, end };
  State next(std::string& line) {
    while (true) {
      if (const std::size_t end = text_.find('\n'); end != std::string::npos) {
        line = text_.substr(0, end);
        text_.erase(0, end + 1);
        return State::line;
      }
      if (is_ended_) {
        line = std::exchange(text_, {});
        return line.empty() ? State::end : State::line;
      }
      pollfd look{STDIN_FILENO, POLLIN, 0};
      if (::poll(&look, 1, 0) <= 0 || look.revents == 0) return State::none;
      char buffer[512];
      const ssize_t got = ::read(STDIN_FILENO, buffer, sizeof buffer);
      if (got > 0) text_.append(buffer, static_cast<std::size_t>(got));
      is_ended_ = got <= 0;
    }
  }

 private:
  std::string text_;
  bool is_ended_ = false;
};

std::string_view trimmed(std::string_view text) {
  const std::size_t first = text.find_first_not_of(" \t\r");
  return first == std::string_view::npos ? std::string_view()
                                         : text.substr(first, text.find_last_not_of(" \t\r") + 1 - first);
}

bool is_number(Kind kind) { return (kind >= Kind::i8 && kind <= Kind::u64) || kind == Kind::f32 || kind == Kind::f64; }

[[noreturn]] void refuse(const std::string& where, std::string why, std::string advice) {
  throw SetupError({Errc::bad_argument, "cannot calibrate", where, std::move(why), std::move(advice)});
}

/// The sensor with this name, or with the longest name that is followed by a point here.
const PartPlan& sensor_in(const SystemPlan& plan, const std::string& word) {
  const PartPlan* found = nullptr;
  std::vector<std::string> names;
  for (const PartPlan* part : plan.of_kind("sensor")) {
    names.push_back(part->name);
    const bool is_meant = word == part->name || word.starts_with(part->name + ".");
    if (is_meant && (found == nullptr || found->name.size() < part->name.size())) found = part;
  }
  if (found != nullptr) return *found;
  const std::string nearest = nearest_name(word.substr(0, word.find('.')), names);
  refuse(word, "the configuration has no such sensor", nearest.empty() ? "" : "did you mean " + nearest + "?");
}

std::string field_of(const PartPlan& sensor, const std::string& given) {
  std::vector<std::string> numbers;
  std::string all;
  if (sensor.publishes->description != nullptr) {
    for (const Leaf& leaf : sensor.publishes->description->leaves()) {
      if (!is_number(leaf.kind)) continue;
      numbers.push_back(leaf.path);
      if (numbers.size() <= 8) all += (all.empty() ? "" : ", ") + leaf.path;
    }
    if (numbers.size() > 8) all += " ...";
  }
  if (given.empty() && numbers.size() == 1) return numbers.front();
  if (given.empty() && std::find(numbers.begin(), numbers.end(), "value") != numbers.end()) return "value";
  if (given.empty())
    refuse("sensor " + sensor.name, "it has several numbers: " + all,
           "name one, such as " + sensor.name + "." + (numbers.empty() ? "value" : numbers.front()));
  if (numbers.empty() || std::find(numbers.begin(), numbers.end(), given) != numbers.end()) return given;
  const std::string nearest = nearest_name(given, numbers);
  refuse("sensor " + sensor.name, "it has no number " + given + "; available: " + all,
         nearest.empty() ? "" : "did you mean " + nearest + "?");
}

const ConfigChild* child_of(const ConfigItem& item, std::string_view key) {
  for (const ConfigChild& child : item.children())
    if (child.key == key) return &child;
  return nullptr;
}

/// The configuration with new points for the field of the sensor: its text, and the keys removed from the calibration.
class Edited {
 public:
  Edited(ConfigDocument document, const ConfigItem& sensor, std::string field, const Points& points)
      : document_(std::move(document)), expected_(document_.root), path_(sensor.path()), field_(std::move(field)) {
    for (const char* const key : {"scale", "offset", "polynomial", "table", "outside", "tare", "version"}) {
      const ConfigItem* const object = at(document_.root, 3);
      const ConfigChild* const child = object == nullptr ? nullptr : child_of(*object, key);
      if (child == nullptr) continue;
      gone_ += (gone_.empty() ? "" : ", ") + std::string(key);
      read(without_member(document_, *object, key));
      const_cast<ConfigItem*>(at(expected_, 3))->remove(key);
    }
    const std::array<std::string, 4> keys{"process", field_, "calibration", "points"};
    std::size_t there = 0;
    while (there < 3 && at(document_.root, there + 1) != nullptr) ++there;
    ConfigItem value = ConfigItem::of(points);
    for (std::size_t i = keys.size() - 1; i > there; --i) {
      ConfigItem around = ConfigItem::object();
      around.set(keys[i], value);
      value = std::move(around);
    }
    const_cast<ConfigItem*>(at(expected_, there))->set(keys[there], value);
    read(with_member(document_, *at(document_.root, there), keys[there], value));
    if (!(document_.root == expected_))
      refuse(document_.file, "the place of the points was not found in its text", "copy the points there");
  }
  const ConfigDocument& document() const noexcept { return document_; }
  /// "scale, version"; empty: nothing.
  const std::string& gone() const noexcept { return gone_; }

 private:
  /// The item this many levels below the sensor: itself, `process`, the field, `calibration`. Null: it is not there.
  const ConfigItem* at(const ConfigItem& root, std::size_t levels) const {
    const ConfigItem* item = root.find(path_);
    const std::array<std::string, 3> keys{"process", field_, "calibration"};
    for (std::size_t i = 0; i < levels && item != nullptr; ++i) {
      const ConfigChild* const child = child_of(*item, keys[i]);
      item = child == nullptr ? nullptr : &child->item;
    }
    return item;
  }
  void read(const std::string& text) {
    document_ = parse_config(text, document_.file);
    if (!document_.good()) refuse(document_.file, "its text cannot be changed there", "copy the points there");
  }

  ConfigDocument document_;
  ConfigItem expected_;
  const std::string path_, field_;
  std::string gone_;
};

/// Checks that the file can be replaced, as far as this is known before.
void check_writable(const std::string& file) {
  const std::filesystem::path target = std::filesystem::canonical(file);
  for (const std::filesystem::path& path : {target, target.parent_path()})
    if (::access(path.c_str(), W_OK) != 0) throw SetupError(system_error(errno, "cannot write", path.string(), ""));
}

/// Asks for points. Errors: no value comes.
class Session {
 public:
  Session(RawValues& values, std::string unit, Duration longest_wait)
      : values_(values), unit_(std::move(unit)), longest_wait_(longest_wait) {}

  Result<void> ask() {
    Lines lines;
    std::string line;
    prompt();
    while (true) {
      const Lines::State state = lines.next(line);
      if (state == Lines::State::none) {
        const auto passed = values_.take(glance);
        if (!passed) return passed.error();
        continue;
      }
      if (state == Lines::State::end) {
        if (::isatty(STDIN_FILENO) == 1) std::cout << "\n";
        return {};
      }
      const std::string word(trimmed(line));
      if (word.empty() || word == "done") return {};
      if (word == "undo") {
        undo();
      } else {
        double number = 0;
        const auto read = std::from_chars(word.data(), word.data() + word.size(), number);
        const bool is_number = read.ec == std::errc{} && read.ptr == word.data() + word.size();
        if (!is_number || !std::isfinite(number)) {
          std::cout << "  \"" << word << "\" is not a number such as 98.1; other inputs: undo, done" << std::endl;
        } else if (const Result<void> taken = take(number); !taken) {
          return taken;
        }
      }
      prompt();
    }
  }
  const Points& points() const noexcept { return points_; }

  void show_line() const {
    if (points_.size() < 2) return;
    const CalibrationLine line = line_through(points_);
    std::cout << "  line: " << line_text(line);
    if (points_.size() > 2)
      std::cout << "; largest residual " << number_text(line.largest) << " at point " << line.farthest + 1;
    std::cout << std::endl;
  }
  void show_residuals() const {
    const CalibrationLine line = line_through(points_);
    for (std::size_t i = 0; points_.size() > 2 && i < points_.size(); ++i)
      std::cout << "  " << i + 1 << ": raw " << number_text(points_[i][0], digits_of_raw) << ", true "
                << number_text(points_[i][1], digits_of_raw) << ", line " << number_text(line.value(points_[i][0]))
                << ", residual " << number_text(points_[i][1] - line.value(points_[i][0])) << "\n";
  }

 private:
  void prompt() const {
    if (::isatty(STDIN_FILENO) == 1) std::cout << "true value" << unit_ << ": " << std::flush;
  }
  void undo() {
    if (points_.empty()) {
      std::cout << "  there is no point" << std::endl;
      return;
    }
    points_.pop_back();
    std::cout << "  point " << points_.size() + 1 << " is removed" << std::endl;
    show_line();
  }
  Result<void> take(double number) {
    const auto late = values_.take(settling);
    if (!late) return late.error();
    TakenValues taken;
    for (Duration waited{0}; waited < of_a_point || taken.count == 0; waited += of_a_point) {
      if (waited >= longest_wait_)
        return Error{Errc::timed_out, "no value came", values_.where(), "none in " + to_string(longest_wait_),
                     "see with `rtdata top` or the messages above whether the sensor is read"};
      const auto came = values_.take(of_a_point);
      if (!came) return came.error();
      if (came->count > 0) taken.add(came->count, came->mean(), came->least, came->most);
    }
    const double raw = rounded(taken.mean(), digits_of_raw);
    for (std::size_t i = 0; i < points_.size(); ++i) {
      if (points_[i][0] != raw) continue;
      std::cout << "  raw is " << number_text(raw, digits_of_raw) << " as at point " << i + 1
                << ": not used; change what is measured, or undo" << std::endl;
      return {};
    }
    points_.push_back({raw, number});
    std::cout << "  " << points_.size() << ": raw " << number_text(raw, digits_of_raw) << " ("
              << number_text(taken.least) << " to " << number_text(taken.most) << ", " << taken.count
              << (taken.count == 1 ? " value" : " values") << ") is " << number_text(number, digits_of_raw)
              << std::endl;
    show_line();
    return {};
  }

  RawValues& values_;
  const std::string unit_;
  const Duration longest_wait_;
  Points points_;
};

int report(const SystemPlan& plan) {
  std::cerr << plan.report() << plan.problems.size() << (plan.problems.size() == 1 ? " problem" : " problems")
            << std::endl;
  return exit_configuration;
}

/// Checks the changed text and puts it in the file's place.
void write_points(const Registry& registry, const SystemPlan& plan, const PartPlan& sensor, const std::string& field,
                  const Points& points) {
  const Edited edited(plan.document, sensor.item, field, points);
  SystemPlan next = plan_system(registry, edited.document());
  if (!next.good()) {
    next.hide_secrets();
    refuse(plan.document.file, "with these points it has a mistake: " + next.problems[0].text(), "");
  }
  if (load_config(plan.document.file).text != plan.document.text)
    refuse(plan.document.file, "it has been changed meanwhile", "copy the points there, or calibrate again");
  replace_file(plan.document.file, edited.document().text).or_throw();
  std::cout << "wrote " << plan.document.file << ": " << points.size() << " points for " << sensor.name << "." << field
            << std::endl;
  if (!edited.gone().empty()) std::cout << "removed from this calibration: " << edited.gone() << std::endl;
  const ConfigItem* const all = sensor.item.find("process." + field + ".calibration");
  for (const char* const key : {"least", "most"}) {
    const ConfigItem* const limit = all == nullptr ? nullptr : all->find(key);
    if (limit == nullptr) continue;
    const double bound = limit->get<double>();
    for (const auto& [raw, truth] : points)
      if (key[0] == 'l' ? truth < bound : truth > bound)
        std::cout << "careful: its `" << key << "` " << number_text(bound) << " refuses " << number_text(truth)
                  << ", which is one of the points" << std::endl;
  }
}

}  // namespace

int calibrate(const Registry& registry, const CalibrateOptions& options) {
  SystemPlan plan = plan_system(registry, load_config(options.file));
  plan.hide_secrets();
  if (!plan.good()) return report(plan);
  const PartPlan& sensor = sensor_in(plan, options.sensor);
  check_writable(options.file);
  const SystemPlan alone = plan_alone(registry, plan, sensor);
  if (!alone.good()) return report(alone);
  const PartPlan& raw = sensor_in(alone, sensor.name);
  const std::string field = field_of(
      raw, options.sensor.size() > sensor.name.size() ? options.sensor.substr(sensor.name.size() + 1) : std::string());
  const ConfigItem* const unit = sensor.item.find("process." + field + ".unit");
  std::string shown = unit != nullptr ? unit->get<std::string>() : std::string();
  if (unit == nullptr && raw.publishes->description != nullptr) {
    const Leaf* const leaf = raw.publishes->description->find(field);
    if (leaf != nullptr) shown = leaf->unit;
  }
  std::unique_ptr<RawValues> values = values_of_instance(options.file, sensor.name, field);
  const bool is_running = values != nullptr;
  if (!is_running) values = values_of_sensor(registry, alone, sensor.name, field);
  const auto warm_up = sensor.item.value_or<Duration>("warm_up", Duration{0});
  std::cout << sensor.name << "." << field << " of " << values->where() << "\n"
            << (warm_up > Duration{0} && !is_running
                    ? "It warms up: no value comes before " + to_string(warm_up) + ".\n"
                    : "")
            << "Apply a known value, wait until it is steady, then enter that value.\n"
               "undo: removes the last one; an empty line, or done: ends the input.\n"
            << std::flush;
  const Duration period = raw.publishes->load ? raw.publishes->load->period : Duration{0};
  Session session(*values, shown.empty() || shown == "1" ? "" : " [" + shown + "]", patience + warm_up + 2 * period);
  const Result<void> asked = session.ask();
  values.reset();
  const Points& points = session.points();
  const auto to_copy = [&] {
    if (!points.empty())
      std::cerr << "the points, to copy:\n  \"points\": "
                << ConfigItem::of(points).to_json(ConfigItem::Layout::one_line) << std::endl;
  };
  if (!asked) {
    print_error(std::cerr, asked.error());
    std::cerr << "rtdata: nothing was written" << std::endl;
    to_copy();
    return exit_other;
  }
  if (points.size() < 2) {
    print_error(
        std::cerr,
        std::string("nothing was written: a line needs two points, there ") + (points.empty() ? "is none" : "is one"),
        "bad-argument");
    return exit_other;
  }
  session.show_residuals();
  try {
    write_points(registry, plan, sensor, field, points);
  } catch (const SetupError& error) {
    print_error(std::cerr, error.error());
    std::cerr << "rtdata: nothing was written" << std::endl;
    to_copy();
    return exit_other;
  }
  if (is_running) std::cout << "next: rtdata ctl reload" << std::endl;
  return exit_good;
}

}  // namespace rtdata::app
