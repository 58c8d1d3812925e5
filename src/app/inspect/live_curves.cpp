#include "app/inspect/live_curves.hpp"

#include <algorithm>
#include <limits>
#include <nlohmann/json.hpp>
#include <set>
#include <utility>

#include "app/inspect/curve_scale.hpp"
#include "app/inspect/names.hpp"
#include "app/inspect/stream_line.hpp"
#include "rtdata/loop/gaps.hpp"

namespace rtdata::app {
namespace {

[[noreturn]] void refuse(const std::string& name, std::string why, std::string advice) {
  throw SetupError({Errc::not_found, "cannot show", name, std::move(why), std::move(advice)});
}

Time time_in(const nlohmann::ordered_json& object, const char* key) { return from_nanoseconds(whole_in(object, key)); }

/// A number that is not finite is a text in JSON.
double number_in(const nlohmann::ordered_json& object, const char* key) {
  const auto found = object.find(key);
  if (found == object.end()) return std::numeric_limits<double>::quiet_NaN();
  if (found->is_number()) return found->get<double>();
  if (*found == "Infinity") return std::numeric_limits<double>::infinity();
  if (*found == "-Infinity") return -std::numeric_limits<double>::infinity();
  return std::numeric_limits<double>::quiet_NaN();
}

/// "12 lost since the start". What sinks dropped is not lost here: the curve does not come through them.
std::string verdict_of(const Status::Account& of) {
  std::string text;
  if (of.losses() != 0) text = std::to_string(of.losses()) + " lost";
  if (of.outages.number != 0) text += (text.empty() ? "" : ", ") + to_string(of.outages);
  text = text.empty() ? "all there so far" : text + " since the start";
  return of.dropped == 0 ? text : text + ", sinks dropped " + std::to_string(of.dropped);
}

}  // namespace

LiveCurves::LiveCurves(const std::vector<std::string>& fields, const std::vector<std::string>& topics, Duration window)
    : wants_all_(fields.empty()), window_(window) {
  if (wants_all_)
    for (const std::string& topic : topics) wanted_.push_back({topic, ""});
  for (const std::string& name : fields) {
    // Both topics and fields may have points in their names: the longest topic is meant.
    std::string topic = name;
    while (std::find(topics.begin(), topics.end(), topic) == topics.end()) {
      const std::size_t point = topic.rfind('.');
      if (point == std::string::npos)
        refuse(name, "nothing was published on such a topic", nearest_or_all(name, topics));
      topic.resize(point);
    }
    wanted_.push_back({topic, name.size() > topic.size() ? name.substr(topic.size() + 1) : ""});
  }
}

std::string LiveCurves::request(Duration step, bool with_past) const {
  std::set<std::string> topics;
  for (const Wanted& one : wanted_) topics.insert(wants_all_ ? "#" : one.topic);
  Json request{{"request", "subscribe"}, {"version", Status::newest}, {"topics", topics}, {"step", to_string(step)}};
  if (with_past) request["from"] = "-" + to_string(window_);
  return request.dump(-1, ' ', false, Json::error_handler_t::replace);
}

void LiveCurves::take(std::string_view text) {
  const Json line = Json::parse(text, nullptr, false);
  if (!line.is_object()) return;
  for (const char* const key : {"until", "time", "now", "live"}) now_ = std::max(now_, time_in(line, key));
  if (line.contains("subscribed")) is_live_ = !line.contains("from");
  if (line.contains("live")) is_live_ = true;
  if (const auto units = line.find("units"); units != line.end() && units->is_object()) {
    auto& of_topic = units_[text_in(line, "of")];
    for (const auto& [path, unit] : units->items())
      of_topic[path] = unit.is_string() && unit != "1" ? unit.get<std::string>() : std::string();
  }
  const auto data = line.find("data");
  if (data == line.end() || !data->is_object()) return;
  if (text_in(line, "topic") == gap_topic) {
    take_gap(*data);
  } else if (line.contains("count")) {
    take_step(line);
  }
  prune();
}

void LiveCurves::take_step(const Json& line) {
  const std::string topic = text_in(line, "topic"), origin = text_in(line, "origin");
  const Json& data = line["data"];
  for (std::size_t place = 0; place < wanted_.size(); ++place) {
    Wanted& wanted = wanted_[place];
    if (wanted.topic != topic) continue;
    std::size_t number = 0;
    for (const auto& [path, of] : data.items()) {
      ++number;
      if (!wanted.path.empty() && path != wanted.path && !path.starts_with(wanted.path + ".") &&
          !path.starts_with(wanted.path + "["))
        continue;
      wanted.is_found = true;
      Field& field = curves_[{place, origin, number}];
      if (field.curve.name.empty()) {
        field.curve.name = topic + "." + path;
        field.curve.topic = topic;
        field.curve.origin = origin;
        field.curve.path = path;
        field.curve.unit = units_[topic][path];
      }
      CurveStep step{time_in(line, "time"), line.value("count", std::uint64_t{0}), 0, 0.0, 0.0, 0};
      step.numbers = of.value("count", std::uint64_t{0});
      if (step.numbers != 0) {
        step.least = number_in(of, "least");
        step.most = number_in(of, "most");
        step.mean = number_in(of, "mean");
        field.last = number_in(of, "last");
        field.last_at = time_in(line, "until");
        field.has_last = true;
      }
      field.curve.steps.push_back(step);
    }
    if (wanted.is_found || wants_all_) continue;
    std::vector<std::string> numbers;
    for (const auto& [path, of] : data.items()) numbers.push_back(path);
    const bool is_other = units_[topic].contains(wanted.path);
    refuse(wanted.path.empty() ? topic : topic + "." + wanted.path,
           is_other              ? "it is not a number"
           : wanted.path.empty() ? "it has no numbers"
                                 : "there is no such field",
           nearest_or_all(wanted.path, numbers));
  }
}

void LiveCurves::take_gap(const Json& data) {
  const std::string kind = text_in(data, "kind"), reason = text_in(data, "reason");
  CurveGap gap{time_in(data, "first"), time_in(data, "last"), 0, gap_text(kind, reason)};
  if (kind == "missed" || kind == "failed") gap.lost = data.value("count", std::uint64_t{0});
  for (auto& [key, field] : curves_)
    if (field.curve.topic == text_in(data, "topic") && field.curve.origin == text_in(data, "name"))
      field.curve.gaps.push_back(gap);
}

void LiveCurves::prune() {
  const Time first = now_ - window_ - std::chrono::seconds{1};
  for (auto& [key, field] : curves_) {
    std::erase_if(field.curve.gaps, [&](const CurveGap& one) { return one.last < first; });
    auto& steps = field.curve.steps;
    // Seldom, because it moves the others.
    if (!steps.empty() && steps.front().begin < first - window_ / 4)
      std::erase_if(steps, [&](const CurveStep& one) { return one.begin < first; });
  }
}

std::vector<const LiveCurves::Field*> LiveCurves::fields() const {
  std::vector<const Field*> all;
  for (const auto& [key, field] : curves_) all.push_back(&field);
  return all;
}

Plot LiveCurves::plot(Duration step, const Status& status) const {
  Plot plot;
  plot.title = status.instance.name + ", live";
  plot.step = step;
  const std::int64_t end = floor_of(to_nanoseconds(now_) - 1, step.count()) + 1;
  plot.until = from_nanoseconds(end * step.count());
  plot.from = plot.until - step * std::max<Duration::rep>(window_ / step, 1);
  for (const Field* const field : fields()) {
    Curve curve = field->curve;
    const bool has_several = std::any_of(curves_.begin(), curves_.end(), [&](const auto& other) {
      return other.second.curve.name == curve.name && other.second.curve.origin != curve.origin;
    });
    if (has_several) curve.name += " of " + curve.origin;
    curve.steps.clear();
    for (const CurveStep& one : field->curve.steps) {
      if (one.begin < plot.from || one.begin >= plot.until) continue;
      if (one.numbers != 0) {
        if (!curve.least || one.least < curve.least->number) curve.least = {one.least, one.begin};
        if (!curve.most || curve.most->number < one.most) curve.most = {one.most, one.begin};
      }
      const Time begin = from_nanoseconds(floor_of(to_nanoseconds(one.begin), step.count()) * step.count());
      if (curve.steps.empty() || curve.steps.back().begin != begin) {
        curve.steps.push_back(one);
        curve.steps.back().begin = begin;
      } else {
        join(one, curve.steps.back());
      }
    }
    std::erase_if(curve.gaps, [&](const CurveGap& gap) { return gap.last < plot.from; });
    for (CurveGap& gap : curve.gaps) gap.first = std::max(gap.first, plot.from);
    const auto account = std::find_if(status.topics.begin(), status.topics.end(),
                                      [&](const Status::Account& one) { return one.name == curve.topic; });
    if (account != status.topics.end()) {
      curve.verdict = verdict_of(*account);
      curve.has_loss = account->has_loss();
    }
    plot.curves.push_back(std::move(curve));
  }
  return plot;
}

}  // namespace rtdata::app
