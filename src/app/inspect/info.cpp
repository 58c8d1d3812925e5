#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>
#include <ostream>

#include "app/core/amounts.hpp"
#include "app/core/recording_commands.hpp"
#include "app/core/table.hpp"
#include "app/core/terminal_text.hpp"
#include "app/inspect/course.hpp"
#include "data/listed.hpp"
#include "data/rounded_time.hpp"
#include "data/wrap.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/runs.hpp"
#include "rtdata/recording/verify.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

Time present() { return std::chrono::time_point_cast<Duration>(std::chrono::system_clock::now()); }
std::string short_time(Time utc) { return to_iso8601(utc).substr(0, 19) + "Z"; }

/// What the account says of a topic besides its summary.
struct OfTopic {
  std::vector<std::string> mute;  // origins from which no event ever came
  std::uint64_t filtered = 0;     // held back on purpose
};
using OfTopics = std::map<std::string, OfTopic>;

std::string table_of(const std::vector<TopicSummary>& topics, const OfTopics& more) {
  bool is_complete = true;
  Table table({"topic", ">rows", ">reached", ">wanted", ">late p50", ">p99", ">max", ">missed", ">dropped"});
  for (const TopicSummary& topic : topics) {
    is_complete = is_complete && topic.is_complete;
    const auto count_of = [&](std::uint64_t count) { return std::to_string(count) + (topic.is_complete ? "" : "+"); };
    const auto rate = [](double hertz) { return hertz > 0 ? frequency_text(hertz) : "-"; };
    const auto late = [&](Duration time) {
      return topic.has_lateness ? detail::rounded_time(static_cast<double>(time.count())) : "-";
    };
    std::string losses;
    const auto add = [&](std::uint64_t count, const char* what) {
      if (count != 0) losses += (losses.empty() ? "" : ", ") + count_of(count) + " " + what;
    };
    add(topic.failed, "failed");
    add(topic.unreadable, "unreadable");
    add(topic.late, topic.late == 1 ? "read late" : "reads late");
    add(topic.lost.value_or(0), "lost by the source");
    add(topic.first_lines, topic.first_lines == 1 ? "first line discarded" : "first lines discarded");
    if (topic.outages.number != 0) losses += (losses.empty() ? "" : ", ") + to_string(topic.outages);
    if (topic.pruned != 0)
      losses += (losses.empty() ? "" : ", ") + std::to_string(topic.pruned) +
                " more rows were pruned (max_age, max_bytes)";
    if (topic.repeated != 0)
      losses += (losses.empty() ? "" : "; ") + count_of(topic.repeated) +
                " repeated by the source, which is not a loss";
    const auto of = more.find(topic.topic);
    if (of != more.end() && of->second.filtered != 0)
      losses += (losses.empty() ? "" : "; ") + count_of(of->second.filtered) +
                " held back on purpose (filtered), which is not a loss";
    if (of != more.end() && !of->second.mute.empty())
      losses += (losses.empty() ? "" : "; ") + ("no event ever came from " + detail::listed(of->second.mute));
    if (!topic.made_of_it.empty())
      losses += (losses.empty() ? "" : "; ") +
                ("not recorded itself: account of what is made of it, " + detail::listed(topic.made_of_it));
    table.add({topic.topic, std::to_string(topic.rows), rate(topic.reached_hertz), rate(topic.wanted_hertz),
               late(topic.lateness_p50), late(topic.lateness_p99), late(topic.lateness_max), count_of(topic.missed),
               count_of(topic.dropped)},
              losses);
  }
  std::string text = table.empty() ? "" : table.text("  ", 80);
  if (!is_complete)
    detail::wrap(text, "  ", "+: up to the last account; the run was not closed, `rtdata verify` says what is known");
  return text;
}

void print_fields(const std::vector<RecordedTopic>& topics, std::ostream& out) {
  for (const RecordedTopic& topic : topics) {
    std::string line = "  " + topic.topic +
                       (topic.version > 1 ? " (version " + std::to_string(topic.version) + ")" : "") + ":";
    for (const Field& field : topic.description->fields()) {
      std::string item = " " + field.name + (field.unit.empty() ? "" : " [" + field.unit + "]");
      if (&field != &topic.description->fields().back()) item += ",";
      if (line.size() + item.size() > 80) {
        out << line << "\n";
        line = "    ";
      }
      line += item;
    }
    out << line << "\n";
  }
}

/// The identity of a chip that the user declared is shown as it is: it is one line.
std::string what_became_of(const RecordedConfiguration& change) {
  if (change.text.empty()) return "removed";
  return change.object.starts_with("identity of ") ? change.text : "added";
}

Json utc_json(const UtcLine& line, std::optional<Time> recorded) {
  return recorded ? Json(to_iso8601(line.utc(*recorded))) : Json();
}

Json json_of(const RunInfo& run, const UtcLine& line) {
  Json json{{"run", run.run},
            {"uuid", run.uuid},
            {"name", run.name},
            {"notes", run.notes},
            {"program", run.program},
            {"host", run.host},
            {"state", name_of(run.state)},
            {"started", to_nanoseconds(run.started)}};
  json["ended"] = run.ended ? Json(to_nanoseconds(*run.ended)) : Json();
  json["started_utc"] = utc_json(line, run.started);
  json["ended_utc"] = utc_json(line, run.ended);
  json["lost"] = run.lost ? Json(*run.lost) : Json();
  json["remark"] = run.remark;
  return json;
}

/// Uses the keys of a running instance's status, as far as a recording has the values.
Json json_of(const TopicSummary& topic, const OfTopic& more) {
  const auto rate = [](double hertz) { return hertz > 0 ? Json(hertz) : Json(); };
  const auto time = [](const std::optional<Time>& at) { return at ? Json(to_nanoseconds(*at)) : Json(); };
  Json json{{"name", topic.topic},
            {"origins", topic.origins},
            {"rows", topic.rows},
            {"published", topic.published},
            {"wanted_hz", rate(topic.wanted_hertz)},
            {"reached_hz", rate(topic.reached_hertz)},
            {"missed", topic.missed},
            {"failed", topic.failed},
            {"unreadable", topic.unreadable},
            {"repeated", topic.repeated},
            {"filtered", more.filtered},
            {"mute", more.mute},
            {"dropped", topic.dropped},
            {"first_lines", topic.first_lines},
            {"pruned", topic.pruned},
            {"outages", topic.outages.number},
            {"outage_time_s", std::chrono::duration<double>(topic.outages.time).count()},
            {"late", topic.late},
            {"made_of_it", topic.made_of_it},
            {"is_complete", topic.is_complete},
            {"lost", topic.lost ? Json(*topic.lost) : Json()},
            {"lateness_ns", Json()},
            {"first", time(topic.first)},
            {"last", time(topic.last)}};
  if (topic.has_lateness)
    json["lateness_ns"] = {
        {"p50", topic.lateness_p50.count()}, {"p99", topic.lateness_p99.count()}, {"max", topic.lateness_max.count()}};
  return json;
}

Json json_of(const Value& value) {
  return std::visit(
      [](const auto& held) -> Json {
        using Held = std::decay_t<decltype(held)>;
        if constexpr (std::is_same_v<Held, std::monostate>) {
          return {};
        } else if constexpr (std::is_same_v<Held, char>) {
          return std::string(1, held);
        } else {
          return held;
        }
      },
      value);
}

/// The data read from a recording before anything is printed.
struct Content {
  std::vector<RunInfo> runs;
  std::vector<UtcLine> lines;  // of these
  DeletedRuns deleted;
  std::vector<RecordedTopic> topics;
  std::optional<RunInfo> shown;
  std::vector<TopicSummary> summaries;
  OfTopics of_topics;
  std::vector<RecordedError> errors;
  std::vector<RecordedHealth> health;
  std::vector<RecordedConfiguration> configurations;
  std::vector<RecordedBacklog> backlogs;
  std::vector<RecordedGap> gaps;
  Course course;
  UtcLine line{{}};  // of the run that is shown
};

/// Throws SetupError.
OfTopics of_topics(const Recording& recording, const std::vector<TopicSummary>& summaries, std::int64_t run) {
  const RunReport account = account_of(recording, run).or_throw();
  OfTopics all;
  for (const LedgerEntry& entry : recording.ledger(run).or_throw()) {
    OfTopic& topic = all[entry.topic];
    topic.filtered += entry.sensor.filtered;
    if (std::find(account.mute.begin(), account.mute.end(), entry.origin) != account.mute.end())
      topic.mute.push_back(entry.origin);
  }
  for (const TopicSummary& topic : summaries)
    if (!topic.made_of_it.empty()) all[topic.topic].filtered = 0;  // they are the events that are not recorded
  return all;
}

/// Throws SetupError.
Content read(const Recording& recording, std::vector<RunInfo> runs, std::optional<RunInfo> shown,
             InfoOptions::Gaps gaps) {
  Content content;
  content.runs = std::move(runs);
  content.shown = std::move(shown);
  content.deleted = recording.deleted_runs().or_throw();
  content.topics = recording.topics().or_throw();
  for (const RunInfo& run : content.runs) {
    content.lines.push_back(recording.utc_line(run.run).or_throw());
    if (run.run == content.shown->run) content.line = content.lines.back();
  }
  if (!content.shown) return content;
  const std::int64_t run = content.shown->run;
  content.summaries = summary(recording, run).or_throw();
  content.of_topics = of_topics(recording, content.summaries, run);
  content.errors = recording.errors(run).or_throw();
  content.health = recording.health(run).or_throw();
  content.course = course_of(recording, content.topics, run);
  content.configurations = recording.configurations(run).or_throw();
  content.backlogs = recording.backlogs().or_throw();
  if (gaps == InfoOptions::Gaps::listed) content.gaps = recording.gaps(run).or_throw();
  return content;
}

/// "missed 12: reason", "disconnected: reason"; for joined gaps, with their number.
std::string described(const RecordedGap& gap) {
  if (gap.kind == "joined") {
    return "several gaps joined" + (gap.count > 0 ? ", " + std::to_string(gap.count) + " together" : std::string()) +
           (gap.reason.empty() || gap.reason == "several" ? ", for several reasons" : ": " + gap.reason);
  }
  return gap.kind + (gap.count > 0 ? " " + std::to_string(gap.count) : "") +
         (gap.reason.empty() || gap.reason == gap.kind ? "" : ": " + gap.reason);
}

/// Prints the first items, a wrapped line each; prints nothing if there are none.
template <class Item, class Text>
void print_first(const std::vector<Item>& items, std::size_t most, const std::string& heading, std::ostream& out,
                 const Text& text_of_item) {
  if (items.empty()) return;
  out << "\n" << heading << "\n";
  for (std::size_t i = 0; i < items.size() && i < most; ++i) {
    std::string line;
    detail::wrap(line, "  ", text_of_item(items[i]));
    out << line;
  }
  if (items.size() > most) out << "  and " << items.size() - most << " more\n";
}

void print_gaps(const Content& content, std::ostream& out) {
  out << "\ngaps of run " << content.shown->run << " (UTC)\n";
  if (content.gaps.empty()) out << "  none\n";
  for (const RecordedGap& gap : content.gaps) {
    const Time from = content.line.utc(gap.first), until = content.line.utc(gap.last);
    std::string line;
    detail::wrap(line, "  ",
                 to_iso8601(from) + (gap.last == gap.first ? "" : " to " + to_iso8601(until)) + " " + gap.origin +
                     " on " + gap.topic + ": " + described(gap));
    out << line;
  }
}

void print(const Recording& recording, const Content& content, InfoOptions::Gaps gaps, std::ostream& out) {
  out << recording.path() << "\n\n";
  if (content.runs.empty()) {
    out << (content.deleted.runs == 0 ? "No run was recorded yet.\n" : "No run is left: all were deleted.\n");
    return;
  }
  const auto shown_time = [&](Time recorded) { return short_time(content.line.utc(recorded)); };
  out << "runs (UTC)\n";
  if (content.deleted.runs != 0) {
    std::string line;
    detail::wrap(line, "  ",
                 std::to_string(content.deleted.first_run) + " to " + std::to_string(content.deleted.last_run) + "  " +
                     short_time(content.deleted.started) + " to " + short_time(content.deleted.ended) + "  " +
                     std::to_string(content.deleted.runs) + " of them deleted, sums in rtdata_deleted");
    out << line;
  }
  for (std::size_t i = 0; i < content.runs.size(); ++i) {
    const RunInfo& run = content.runs[i];
    const UtcLine& line = content.lines[i];
    out << "  " << run.run << (run.name.empty() ? "" : " \"" + run.name + "\"") << "  "
        << short_time(line.utc(run.started)) << (run.ended ? " to " + short_time(line.utc(*run.ended)) : "") << "  "
        << name_of(run.state) << "\n";
    std::string lines;
    if (!run.notes.empty()) detail::wrap(lines, "    ", run.notes);
    if (!run.remark.empty()) detail::wrap(lines, "    ", run.remark);
    out << lines;
  }
  out << "\nrun " << content.shown->run << "\n";
  out << table_of(content.summaries, content.of_topics);
  if (gaps == InfoOptions::Gaps::listed) print_gaps(content, out);
  const std::string of_run = " run " + std::to_string(content.shown->run);
  print_first(content.errors, 10, "errors of" + of_run, out, [&](const RecordedError& error) {
    return shown_time(error.time) + " " + error.object + ": " + error.text +
           (error.count > 1 ? " (" + std::to_string(error.count) + " times)" : "");
  });
  print_first(content.health, 20, "health in" + of_run, out, [&](const RecordedHealth& change) {
    return shown_time(change.time) + " " + change.kind + " " + change.name + ": " + change.state +
           (change.reason.empty() ? "" : ": " + change.reason) +
           (change.count == 1
                ? ""
                : " (" + std::to_string(change.count) + " changes up to " + shown_time(change.last) + ")");
  });
  const auto print_course = [&](const CourseEvents& events, const char* what) {
    print_first(events.first, 20, what + of_run, out, [&](const CourseEvent& event) {
      return shown_time(event.time) + " " + event.object + ": " + event.text;
    });
    if (events.count > events.first.size()) out << "  of " << events.count << "\n";
  };
  print_course(content.course.notes, "notes in");
  print_course(content.course.alarms, "alarms in");
  print_course(content.course.states, "changes of state in");
  print_first(content.configurations, 20, "changes of the configuration in" + of_run + " (texts: --json)", out,
              [&](const RecordedConfiguration& change) {
                return shown_time(change.time) + " " +
                       (change.object.empty() ? "a new text of " + std::to_string(change.text.size()) + " bytes"
                                              : change.object + ": " + what_became_of(change)) +
                       (change.count > 1 ? " (the last of " + std::to_string(change.count) + " changes)" : "");
              });
  print_first(content.backlogs, 20, "sinks that go through this recording", out, [](const RecordedBacklog& of) {
    const auto age = of.oldest ? std::optional(std::max(present() - *of.oldest, Duration{0})) : std::nullopt;
    return of.sink + " of " + of.host + ": " +
           (of.events == 0 ? std::string("nothing waits") : waiting_text({of.events, of.bytes, age})) +
           (of.refused == 0
                ? ""
                : "; refused: " + std::to_string(of.refused) + ", see rtdata_refused" +
                      (of.refused_keys == of.refused ? ""
                                                     : ", which has the newest " + std::to_string(of.refused_keys))) +
           (of.unsent == 0 ? "" : "; deleted before they were sent: " + std::to_string(of.unsent));
  });
  out << "\nfields\n";
  print_fields(content.topics, out);
}

void print_json(const Recording& recording, const Content& content, InfoOptions::Gaps gaps, std::ostream& out) {
  Json json;
  json["path"] = recording.path();
  json["deleted_runs"] = content.deleted.runs;
  const auto list = [&](const char* key, const auto& items, const auto& made) {
    Json& all = json[key] = Json::array();
    for (const auto& item : items) all.push_back(made(item));
  };
  json["runs"] = Json::array();
  for (std::size_t i = 0; i < content.runs.size(); ++i)
    json["runs"].push_back(json_of(content.runs[i], content.lines[i]));
  json["shown_run"] = content.shown ? Json(content.shown->run) : Json();
  list("topics", content.summaries, [&](const TopicSummary& topic) {
    const auto of = content.of_topics.find(topic.topic);
    return json_of(topic, of == content.of_topics.end() ? OfTopic{} : of->second);
  });
  list("errors", content.errors, [&](const RecordedError& error) {
    return Json{{"time", to_nanoseconds(error.time)},
                {"object", error.object},
                {"id", error.id},
                {"text", error.text},
                {"count", error.count},
                {"last", to_nanoseconds(error.last)},
                {"utc", utc_json(content.line, error.time)}};
  });
  list("health", content.health, [&](const RecordedHealth& change) {
    return Json{{"time", to_nanoseconds(change.time)},
                {"kind", change.kind},
                {"name", change.name},
                {"state", change.state},
                {"reason", change.reason},
                {"count", change.count},
                {"last", to_nanoseconds(change.last)},
                {"utc", utc_json(content.line, change.time)}};
  });
  const auto add_course = [&](const char* name, const char* object, const CourseEvents& events) {
    json[name] = Json::array();
    for (const CourseEvent& event : events.first) {
      Json one{{"time", to_nanoseconds(event.time)}, {object, event.object}};
      for (const auto& [field, value] : event.values) one[field] = json_of(value);
      one["utc"] = utc_json(content.line, event.time);
      json[name].push_back(std::move(one));
    }
    json[std::string(name) + "_count"] = events.count;
  };
  add_course("notes", "by", content.course.notes);
  add_course("alarms", "limit_of", content.course.alarms);
  add_course("states", "machine", content.course.states);
  json["configuration"] = content.shown ? Json(content.shown->configuration) : Json();
  list("configurations", content.configurations, [&](const RecordedConfiguration& change) {
    return Json{{"time", to_nanoseconds(change.time)},
                {"object", change.object},
                {"text", change.text},
                {"count", change.count},
                {"utc", utc_json(content.line, change.time)}};
  });
  list("backlogs", content.backlogs, [](const RecordedBacklog& of) {
    return Json{{"sink", of.sink},
                {"host", of.host},
                {"events", of.events},
                {"bytes", of.bytes},
                {"oldest", of.oldest ? Json(to_nanoseconds(*of.oldest)) : Json()},
                {"refused", of.refused},
                {"unsent", of.unsent}};
  });
  if (gaps == InfoOptions::Gaps::listed) {
    list("gaps", content.gaps, [&](const RecordedGap& gap) {
      return Json{{"topic", gap.topic},
                  {"origin", gap.origin},
                  {"kind", gap.kind},
                  {"reason", gap.reason},
                  {"first", to_nanoseconds(gap.first)},
                  {"last", to_nanoseconds(gap.last)},
                  {"first_utc", utc_json(content.line, gap.first)},
                  {"last_utc", utc_json(content.line, gap.last)},
                  {"count", gap.count}};
    });
  }
  list("descriptions", content.topics, [](const RecordedTopic& topic) {
    return Json{{"topic", topic.topic},
                {"version", topic.version},
                {"table", topic.table},
                {"first_run", topic.first_run},
                {"description", Json::parse(topic.description->to_json())}};
  });
  out << json.dump(2, ' ', false, Json::error_handler_t::replace) << "\n";
}

}  // namespace

int info(const InfoOptions& options, std::ostream& out, std::ostream& err) try {
  const Recording recording = Recording::open(options.database).or_throw();
  std::vector<RunInfo> runs = recording.runs().or_throw();
  std::optional<RunInfo> shown;
  if (options.run || !runs.empty()) shown = find_run(runs, options.run.value_or("-1"), recording.path()).or_throw();
  const Content content = read(recording, std::move(runs), std::move(shown), options.gaps);
  options.show_as == ShowAs::json ? print_json(recording, content, options.gaps, out)
                                  : print(recording, content, options.gaps, out);
  return 0;
} catch (const SetupError& error) {
  print_error(err, error.error());
  return status_after(error.error());
}

}  // namespace rtdata::app
