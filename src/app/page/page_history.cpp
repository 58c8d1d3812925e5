#include "app/page/page_history.hpp"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <type_traits>

#include "app/core/figures.hpp"
#include "app/core/number_text.hpp"
#include "app/inspect/course.hpp"
#include "rtdata/data/codec.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

constexpr Duration patience = std::chrono::milliseconds{400};
constexpr std::int64_t steps_of_slice = 64, most_steps = 4000;
constexpr std::size_t most_topics = 64, most_points = 200'000, most_marks = 300, most_gaps = 2000;

struct Request {
  std::map<std::string, std::vector<std::string>> topics;
  Time from{}, until{};
  Duration step{0};
  bool wants_marks = false;
};

double in_ms(Time time) { return static_cast<double>(to_nanoseconds(time)) / 1e6; }
double in_ms(Duration time) { return static_cast<double>(time.count()) / 1e6; }

Time whole_steps(Time time, Duration step, bool up) {
  const std::int64_t ns = to_nanoseconds(time), past = ((ns % step.count()) + step.count()) % step.count();
  return from_nanoseconds(past == 0 ? ns : ns - past + (up ? step.count() : 0));
}

[[noreturn]] void refuse_request(std::string why) {
  throw SetupError({Errc::bad_argument, "cannot read the history", "request", std::move(why), ""});
}

Request request_of(std::string_view text) {
  // In ms: values computed from these times fit into 64 bits of ns.
  constexpr double latest = 9.1e12, longest = 3.2e12, longest_step = 1e11;
  const Json given = Json::parse(text, nullptr, false);
  const auto topics = given.is_object() ? given.find("topics") : given.end();
  if (topics == given.end() || !topics->is_object()) refuse_request("it has no object of \"topics\"");
  const auto number = [&](const char* key, double least, double most) {
    const auto found = given.find(key);
    if (found == given.end() || !found->is_number())
      refuse_request("it has no number of ms \"" + std::string(key) + "\"");
    const double value = found->get<double>();
    if (!(value >= least && value <= most))
      refuse_request("\"" + std::string(key) + "\" " + found->dump() + " is out of range");
    return value;
  };
  const double from = number("from", -latest, latest), until = number("until", -latest, latest);
  const double step = number("step", 1, longest_step);
  if (!(until > from)) refuse_request("\"until\" is not after \"from\"");
  if (until - from > longest) refuse_request("it asks for more than 100 years");
  if ((until - from) / step > static_cast<double>(most_steps))
    refuse_request("it asks for more than " + std::to_string(most_steps) + " steps: give a longer \"step\"");
  if (topics->size() > most_topics) refuse_request("it asks for more than " + std::to_string(most_topics) + " topics");
  Request request;
  request.step = Duration{std::llround(step) * 1'000'000};
  request.from = whole_steps(from_nanoseconds(std::llround(from * 1e6)), request.step, false);
  request.until = whole_steps(from_nanoseconds(std::llround(until * 1e6)), request.step, true);
  for (const auto& [topic, paths] : topics->items()) {
    const auto is_path = [](const Json& path) { return path.is_string(); };
    if (!is_topic_name(topic) || !paths.is_array() || !std::all_of(paths.begin(), paths.end(), is_path))
      refuse_request("its topics are not as {\"room/air\": [\"temperature\"]}");
    request.topics[topic] = paths.get<std::vector<std::string>>();
  }
  request.wants_marks = given.value("marks", Json(false)) == Json(true);
  return request;
}

std::string error_text(std::string_view why) {
  return Json{{"error", why}}.dump(-1, ' ', false, Json::error_handler_t::replace);
}

/// As JSON text. A step without a number breaks the curve; JSON has no infinities and no NaN.
void append_value(std::string& to, const Value& value) {
  std::visit(
      [&to](const auto& held) {
        using Held = std::decay_t<decltype(held)>;
        if constexpr (std::is_same_v<Held, double>) {
          std::isfinite(held) ? append_number(to, held) : void(to += "null");
        } else if constexpr (std::is_same_v<Held, std::int64_t> || std::is_same_v<Held, std::uint64_t>) {
          append_number(to, held);
        } else {
          to += "null";
        }
        to += ',';
      },
      value);
}

/// The curve of a field: numbers, each followed by a comma. `later` has the numbers read before.
struct Series {
  std::string unit;
  struct Column {
    const char* name;
    std::string text = {}, later = {};
  };
  std::array<Column, 4> columns = {{{"time"}, {"least"}, {"mean"}, {"most"}}};
};
/// The events of a step, by their sequences.
struct Span {
  Time time{};
  std::uint64_t first = 0, last = 0, events = 0;
};
/// An origin on a topic.
struct HistorySource {
  std::vector<Span> spans;
  std::map<std::string, Series> series;  // by path
  const RecordedTopic* topic = nullptr;  // the description to which `wanted` belongs
  std::vector<std::pair<Figures, Series*>> wanted;
};

class Answer {
 public:
  Answer(const Recording& recording, const RunInfo& run, const Request& request)
      : recording_(recording), run_(run), request_(request) {
    for (RecordedTopic& one : recording.topics().or_throw())
      if (request.topics.contains(one.topic)) descriptions_[{one.topic, one.version}] = std::move(one);
  }

  /// Reads the steps of a topic that are before those read earlier. False: there are more points than fit into an
  /// answer.
  bool read(const std::string& topic, Time from, Time until) {
    RowFilter filter{.topic = topic, .run = run_.run, .from = from, .until = until};
    auto rows = recording_.steps(filter, request_.step, request_.topics.at(topic)).or_throw();
    while (const RecordedRow* row = rows.next().or_throw()) add(*row);
    for (auto& [key, source] : sources_) {
      source.topic = nullptr;  // it belonged to these rows
      for (auto& [path, series] : source.series)
        for (Series::Column& column : series.columns) column.later.insert(0, std::exchange(column.text, {}));
    }
    return points_ < most_points;
  }
  /// Also of sensors that never had an event.
  void read_gaps(Time from, Time until) {
    std::vector<RecordedGap> all = recording_.gaps(run_.run).or_throw();
    for (auto gap = all.rbegin(); gap != all.rend() && gaps_.size() < most_gaps; ++gap)
      if (request_.topics.contains(gap->topic) && gap->last >= from && gap->first < until)
        gaps_.push_back(std::move(*gap));
  }

  /// The curves go into a text of their own, as objects with a comma behind each.
  void add_to(Json& answer, std::string& curves) {
    for (const auto& [key, source] : sources_)
      for (const auto& [path, series] : source.series) {
        curves += Json{{"topic", key.first}, {"origin", key.second}, {"path", path}, {"unit", series.unit}}.dump(
            -1, ' ', false, Json::error_handler_t::replace);
        curves.pop_back();
        for (const Series::Column& column : series.columns) {
          curves.append(",\"").append(column.name).append("\":[").append(column.later);
          curves.back() = ']';
        }
        curves += "},";
      }
    add_missing();
    for (const RecordedGap& gap : gaps_)
      answer["gaps"].push_back({{"topic", gap.topic},
                                {"origin", gap.origin},
                                {"kind", gap.kind},
                                {"reason", gap.reason},
                                {"first", in_ms(gap.first)},
                                {"last", in_ms(gap.last)},
                                {"count", gap.count}});
  }

 private:
  void add(const RecordedRow& row) {
    HistorySource& source = sources_[{row.topic().topic, std::string(row.header().origin)}];
    if (source.topic != &row.topic()) set_wanted(source, row.topic());
    const EventView event = row.event();
    const auto count_of = [&](const Leaf& leaf) { return std::get<std::uint64_t>(event.value(leaf)); };
    source.spans.push_back(
        {row.header().time, row.first_sequence(), row.last_sequence(), count_of(event.description().leaves().front())});
    for (const auto& [figures, series] : source.wanted) {
      const bool has_numbers = count_of(*figures.count) > 0;
      auto column = series->columns.begin();
      append_value(column++->text, in_ms(row.header().time));
      for (const Leaf* const of : {figures.least, figures.mean, figures.most})
        append_value(column++->text, has_numbers ? event.value(*of) : Value());
      ++points_;
    }
  }

  void set_wanted(HistorySource& source, const RecordedTopic& topic) {
    source.topic = &topic;
    source.wanted.clear();
    const std::vector<std::string>& wanted = request_.topics.at(topic.topic);
    for (const Figures& one :
         figures_of(*topic.description, *descriptions_.at({topic.topic, topic.version}).description)) {
      if (!wanted.empty() && std::find(wanted.begin(), wanted.end(), one.of->path) == wanted.end()) continue;
      Series& series = source.series[one.of->path];
      series.unit = one.of->unit;
      source.wanted.emplace_back(one, &series);
    }
  }

  /// Events that the recording did not store: sequences without a row.
  void add_missing() {
    for (auto& [key, source] : sources_) {
      std::sort(source.spans.begin(), source.spans.end(), [](const Span& a, const Span& b) { return a.time < b.time; });
      const Span* before = nullptr;
      for (const Span& span : source.spans) {
        std::uint64_t missing = span.last - span.first + 1 > span.events ? span.last - span.first + 1 - span.events : 0;
        if (before != nullptr && span.first > before->last + 1) missing += span.first - before->last - 1;
        if (missing > 0)
          gaps_.push_back({key.first, key.second, "not stored", "dropped by the recording",
                           before != nullptr ? before->time : span.time, span.time, missing});
        before = &span;
      }
    }
  }

  const Recording& recording_;
  const RunInfo& run_;
  const Request& request_;
  std::map<std::pair<std::string, std::int64_t>, RecordedTopic> descriptions_;
  std::map<std::pair<std::string, std::string>, HistorySource> sources_;  // by topic and origin
  std::vector<RecordedGap> gaps_;
  std::size_t points_ = 0;
};

void add_marks(Json& answer, const Recording& recording, const RunInfo& run, const Request& request) {
  const auto codec = make_json_codec();
  std::size_t count = 0;
  for (const RecordedTopic& topic : recording.topics().or_throw()) {
    if (!is_change(*topic.description)) continue;
    RowFilter filter{.topic = topic.topic, .run = run.run, .from = request.from, .until = request.until};
    filter.limit = most_marks;
    auto rows = recording.rows(filter).or_throw();
    while (const RecordedRow* row = rows.next().or_throw()) {
      std::vector<std::byte> line;
      if (!codec->encode(row->event(), line)) continue;
      answer["marks"].push_back(
          Json::parse(std::string_view(reinterpret_cast<const char*>(line.data()), line.size()), nullptr, false));
      ++count;
    }
  }
  if (count >= most_marks) answer["marks_left_out"] = true;
}

}  // namespace

bool is_change(const Description& description) {
  return is_of_course(description) || description.name() == "output_change";
}

nlohmann::ordered_json page_run(const Recording& recording, const RunInfo& run) {
  Json told{{"number", run.run},
            {"name", run.name},
            {"notes", run.notes},
            {"state", name_of(run.state)},
            {"started", in_ms(run.started)},
            {"ended", nullptr}};
  if (run.ended) told["ended"] = in_ms(*run.ended);
  const std::vector<RecordedClock> clock = recording.clock(run.run).or_throw();
  if (!clock.empty()) {
    const RecordedClock& last = clock.back();
    const Time recorded{last.monotonic.time_since_epoch() + run.clock_offset};
    told["clock"] = {{"offset", in_ms(last.realtime - recorded)}, {"source", last.source}, {"accuracy", nullptr}};
    if (last.accuracy) told["clock"]["accuracy"] = std::chrono::duration<double>(*last.accuracy).count();
  }
  return told;
}

std::string page_history(const std::vector<PageRecording>& recordings, std::optional<std::int64_t> run,
                         std::string_view text) try {
  const Request request = request_of(text);
  const auto takes = [](const PageRecording& one, const std::string& topic) {
    return std::any_of(one.topics.begin(), one.topics.end(),
                       [&](const auto& taken) { return topic_matches(taken, topic); });
  };
  std::map<const PageRecording*, std::vector<std::string>> wanted;
  for (const auto& [topic, paths] : request.topics)
    for (const PageRecording& one : recordings)
      if (takes(one, topic)) {
        wanted[&one].push_back(topic);
        break;
      }
  if (wanted.empty() && !recordings.empty()) wanted[&recordings.front()];
  if (wanted.empty()) return error_text("nothing is recorded");
  const auto until = std::chrono::steady_clock::now() + patience;
  std::string curves;
  Json answer{{"run", nullptr}, {"reached", in_ms(request.from)}, {"gaps", Json::array()}, {"marks", Json::array()}};
  Time reached = request.from;
  for (const auto& [one, topics] : wanted) {
    const Recording recording = Recording::open(one->path).or_throw();
    const std::vector<RunInfo> runs = recording.runs().or_throw();
    const auto chosen = std::find_if(runs.rbegin(), runs.rend(), [&](const RunInfo& info) {
      return run ? info.run == *run : info.pid == ::getpid();
    });
    if (chosen == runs.rend()) continue;  // nothing is stored yet
    if (answer["run"].is_null()) {
      answer["run"] = page_run(recording, *chosen);
      answer["run"]["sink"] = one->sink;
    }
    Answer of(recording, *chosen, request);
    const Duration all = request.until - request.from;
    Duration slice = request.step * std::min(steps_of_slice, all / request.step);
    Time end = request.until;
    // There is no data before the run: a run of hours is not searched in a window of a month.
    const Time begin = whole_steps(std::max(reached, chosen->started), request.step, false);
    while (end > begin) {
      const auto asked = std::chrono::steady_clock::now();
      const Time start = std::max(begin, whole_steps(end - slice, request.step, false));
      bool has_room = true;
      for (const std::string& topic : topics) has_room = of.read(topic, start, end) && has_room;
      end = start;
      const auto now = std::chrono::steady_clock::now();
      if (!has_room || now > until) break;
      // Preparing a slice takes longer than reading a short one.
      slice *= std::clamp<std::int64_t>(patience / 16 / (now - asked + Duration{1}), 1,
                                        std::min(steps_of_slice, all / slice));
    }
    if (end > begin) reached = end;
    of.read_gaps(end, request.until);
    of.add_to(answer, curves);
    if (request.wants_marks) add_marks(answer, recording, *chosen, request);
  }
  answer["reached"] = in_ms(reached);
  if (!curves.empty()) curves.pop_back();
  std::string told = answer.dump(-1, ' ', false, Json::error_handler_t::replace);
  told.pop_back();
  return told + ",\"series\":[" + curves + "]}";
} catch (const std::exception& error) {
  return error_text(std::string(detail::reason_of(error)));
}

}  // namespace rtdata::app
