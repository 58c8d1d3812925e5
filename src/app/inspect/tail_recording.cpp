// rtdata tail DB: recorded events, as the lines of JSON in docs/subscribe.md, or as readable text.
#include <algorithm>
#include <cmath>
#include <deque>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <ostream>
#include <set>
#include <type_traits>
#include <utility>
#include <vector>

#include "app/core/recording_commands.hpp"
#include "app/core/terminal_text.hpp"
#include "app/inspect/event_printer.hpp"
#include "app/inspect/names.hpp"
#include "app/inspect/recorded_range.hpp"
#include "rtdata/data/codec.hpp"
#include "rtdata/data/problem.hpp"
#include "rtdata/loop/gaps.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

std::string dumped(const Json& json) { return json.dump(-1, ' ', false, Json::error_handler_t::replace); }

struct Line {
  Time time{};
  std::string topic;
  std::string json;        // without its end
  std::string table = {};  // of the event or step; others have none
};

Line line_of_gap(const RecordedGap& gap, const UtcLine& utc) {
  const Time first = utc.utc(gap.first), last = utc.utc(gap.last);
  return {first, gap_topic,
          dumped({{"topic", gap_topic},
                  {"time", to_nanoseconds(first)},
                  {"data",
                   {{"origin", gap.origin},
                    {"topic", gap.topic},
                    {"kind", gap.kind},
                    {"reason", gap.reason},
                    {"first", to_nanoseconds(first)},
                    {"last", to_nanoseconds(last)},
                    {"count", gap.count}}}})};
}

Line line_of_health(const RecordedHealth& change, const UtcLine& utc) {
  const Time time = utc.utc(change.time);
  return {
      time, health_topic,
      dumped({{"topic", health_topic},
              {"time", to_nanoseconds(time)},
              {"data",
               {{"kind", change.kind}, {"name", change.name}, {"state", change.state}, {"reason", change.reason}}}})};
}

/// Writes a number like the JSON codec.
Json json_of(const Value& value) {
  return std::visit(
      [](const auto& held) -> Json {
        using Held = std::decay_t<decltype(held)>;
        if constexpr (std::is_same_v<Held, double>) {
          if (std::isnan(held)) return "NaN";
          if (std::isinf(held)) return held > 0 ? "Infinity" : "-Infinity";
          return held;
        } else if constexpr (std::is_same_v<Held, std::int64_t> || std::is_same_v<Held, std::uint64_t>) {
          return held;
        } else {
          return {};  // steps have no other
        }
      },
      value);
}

/// A row of Recording::steps as JSON: its events, then count, least, most and mean of the values of each numeric field.
std::string json_of_step(const RecordedRow& row, Duration length) {
  const EventView event = row.event();
  const auto& leaves = event.description().leaves();
  constexpr std::string_view ending = ".count";
  Json data = Json::object();
  for (std::size_t i = 1; i + 3 < leaves.size(); i += 4) {
    Json& one = data[leaves[i].path.substr(0, leaves[i].path.size() - ending.size())];
    const Value count = event.value(leaves[i]);
    one["count"] = json_of(count);
    if (count == Value{std::uint64_t{0}}) continue;
    one["least"] = json_of(event.value(leaves[i + 1]));
    one["most"] = json_of(event.value(leaves[i + 2]));
    one["mean"] = json_of(event.value(leaves[i + 3]));
  }
  return dumped({{"topic", row.topic().topic},
                 {"time", to_nanoseconds(event.time())},
                 {"until", to_nanoseconds(event.time() + length)},
                 {"origin", event.origin()},
                 {"sequence", {row.first_sequence(), row.last_sequence()}},
                 {"count", json_of(event.value(leaves.front()))},
                 {"data", std::move(data)}});
}

/// The shown events of one run, in time order.
class Content {
 public:
  Content(const Recording& recording, const RecordedTailOptions& options, const RecordedRange& range)
      : recording_(recording), range_(range), patterns_(options.topics) {
    if (!options.step.empty()) {
      step_ = parse_duration(options.step).or_throw();
      if (step_ <= Duration{0})
        throw SetupError(
            {Errc::bad_argument, "cannot show", "--step " + options.step, "it is not above 0", "write one such as 1s"});
    }
    std::set<std::string> topics, alarms;
    for (const RecordedTopic& topic : recording.topics().or_throw()) {
      topics.insert(topic.topic);
      if (topic.description->name() == "alarm") alarms.insert(topic.topic);
    }
    if (patterns_.empty()) patterns_.emplace_back("#");
    for (const std::string& pattern : patterns_) find(pattern, topics);
    for (const std::string& alarm : alarms)
      if (!takes(alarm)) patterns_.push_back(alarm);
    for (const RecordedGap& gap : recording.gaps(range.run.run).or_throw())
      if (takes(gap.topic)) others_.push_back(line_of_gap(gap, range.line));
    for (const RecordedHealth& change : recording.health(range.run.run).or_throw())
      others_.push_back(line_of_health(change, range.line));
    std::stable_sort(others_.begin(), others_.end(), [](const Line& a, const Line& b) { return a.time < b.time; });
  }

  /// Calls `give` with each line from that time on.
  template <class Give>
  void lines(Time from, Give&& give) const {
    std::vector<Source> sources;
    for (std::size_t i = 0; i < patterns_.size(); ++i) {
      RowFilter filter{.topic = patterns_[i], .run = range_.run.run, .from = from, .until = range_.until};
      filter.times = RowFilter::Times::utc;
      auto rows = step_ == Duration{0} ? recording_.rows(filter) : recording_.steps(filter, step_);
      sources.push_back({std::move(rows).or_throw()});
      next(sources, i);
    }
    auto other = std::lower_bound(others_.begin(), others_.end(), from,
                                  [](const Line& one, Time time) { return one.time < time; });
    for (;;) {
      const auto first = std::min_element(sources.begin(), sources.end(), [](const Source& a, const Source& b) {
        return a.row != nullptr && (b.row == nullptr || a.utc < b.utc);
      });
      const bool has_row = first->row != nullptr;
      const bool has_other = other != others_.end() && other->time < range_.until;
      if (has_other && (!has_row || other->time <= first->utc)) {
        give(*other++);
      } else if (has_row) {
        give(line_of(*first->row, first->utc));
        next(sources, static_cast<std::size_t>(first - sources.begin()));
      } else {
        return;
      }
    }
  }

 private:
  struct Source {
    Rows rows;
    const RecordedRow* row = nullptr;
    Time utc{};
  };

  Line line_of_event(const RecordedRow& row, Time utc) const {
    const EventView event = row.event();
    EventHeader header = event.header();
    header.time = utc;
    std::vector<std::byte> bytes;
    codec_->encode(EventView(event.topic(), header, event.description(), event.payload()), bytes).or_throw();
    while (!bytes.empty() && bytes.back() == std::byte{'\n'}) bytes.pop_back();
    return {utc,
            std::string(event.topic()),
            {reinterpret_cast<const char*>(bytes.data()), bytes.size()},
            row.topic().table};
  }
  Line line_of(const RecordedRow& row, Time utc) const {
    if (step_ == Duration{0}) return line_of_event(row, utc);
    return {utc, row.topic().topic, json_of_step(row, step_), row.topic().table};
  }

  /// Throws SetupError: it matches nothing.
  void find(const std::string& pattern, const std::set<std::string>& topics) const {
    if (pattern == "#" ||
        std::any_of(topics.begin(), topics.end(), [&](const auto& one) { return topic_matches(pattern, one); }))
      return;
    const std::string nearest = nearest_name(pattern, {topics.begin(), topics.end()});
    throw SetupError({Errc::not_found, "cannot show", "topic " + pattern, recording_.path() + " has none",
                      nearest.empty() ? "available: " + list_of(topics) : "did you mean " + nearest + "?"});
  }

  bool takes(const std::string& topic, std::size_t before) const {
    return std::any_of(patterns_.begin(), patterns_.begin() + static_cast<std::ptrdiff_t>(before),
                       [&](const std::string& pattern) { return topic_matches(pattern, topic); });
  }
  bool takes(const std::string& topic) const { return takes(topic, patterns_.size()); }

  /// Goes to the next row that no earlier pattern matches.
  void next(std::vector<Source>& sources, std::size_t which) const {
    Source& source = sources[which];
    do source.row = source.rows.next().or_throw();
    while (source.row != nullptr && takes(source.row->topic().topic, which));
    if (source.row == nullptr) return;
    const Time time = source.row->header().time;
    source.utc = step_ == Duration{0} ? range_.line.utc(time) : time;  // steps are those of UTC
  }

  const Recording& recording_;
  const RecordedRange& range_;
  std::vector<std::string> patterns_;
  Duration step_{0};
  std::vector<Line> others_;  // gaps and changes of health
  const std::unique_ptr<Codec> codec_ = make_json_codec();
};

/// Prints lines, the units of a topic before its first and again where they change.
class Output {
 public:
  Output(const Recording& recording, const RecordedTailOptions& options, std::ostream& out)
      : out_(out), show_as_(options.show_as), printer_(options.columns) {
    for (const RecordedTopic& topic : recording.topics().or_throw()) {
      Json units = Json::object();
      for (const Leaf& leaf : topic.description->leaves())
        if (!leaf.unit.empty()) units[leaf.path] = leaf.unit;
      units_[topic.table] = dumped({{"units", std::move(units)}, {"of", topic.topic}});
    }
  }
  void operator()(const Line& line) {
    if (const auto units = units_.find(line.table); units != units_.end()) {
      std::string& last = told_[line.topic];
      if (last.empty() ? !units->second.starts_with(no_units) : units->second != last) print(last = units->second);
    }
    print(line.json);
  }

 private:
  void print(const std::string& json) {
    if (show_as_ == ShowAs::json) {
      out_ << json << '\n';
    } else {
      out_ << printer_.text(json);
    }
  }
  std::ostream& out_;
  const ShowAs show_as_;
  EventPrinter printer_;
  static constexpr std::string_view no_units = "{\"units\":{}";
  std::map<std::string, std::string> units_;  // by table
  std::map<std::string, std::string> told_;   // by topic: the last
};

/// The newest lines: searches a part of the run first, then larger parts.
void print_newest(const Content& content, const RecordedRange& range, std::size_t most, Output& print) {
  std::deque<Line> newest;
  const Duration all = range.until - range.from;
  for (Duration part = std::min<Duration>(std::chrono::seconds{1}, all);; part = part > all / 10 ? all : part * 10) {
    newest.clear();
    content.lines(range.until - part, [&](Line line) {
      newest.push_back(std::move(line));
      if (newest.size() > most) newest.pop_front();
    });
    if (part == all || newest.size() == most) break;
  }
  for (const Line& line : newest) print(line);
}

}  // namespace

int tail_recording(const RecordedTailOptions& options, std::ostream& out, std::ostream& err) try {
  auto opened = Recording::open(options.database);
  if (!opened) {
    print_error(err, opened.error());
    return 2;
  }
  const RecordedRange range = range_of(*opened, options.part, "cannot show");
  const Content content(*opened, options, range);
  Output print(*opened, options, out);
  if (options.part.from.empty() && options.part.last.empty()) {
    print_newest(content, range, options.lines, print);
  } else {
    content.lines(range.from, print);
  }
  return 0;
} catch (const SetupError& error) {
  print_error(err, error.error());
  return error.error().code == make_error_code(Errc::damaged) ? 2 : 1;
}

}  // namespace rtdata::app
