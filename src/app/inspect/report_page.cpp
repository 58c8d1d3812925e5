#include "app/inspect/report_page.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <optional>
#include <set>
#include <utility>

#include "app/core/amounts.hpp"
#include "app/core/table.hpp"
#include "app/core/terminal_text.hpp"
#include "app/inspect/curve_scale.hpp"
#include "app/inspect/html.hpp"
#include "app/inspect/recorded_curves.hpp"
#include "app/inspect/report_figures.hpp"

namespace rtdata::app {
namespace {

constexpr std::size_t most_rows = 300;               // of a list
constexpr std::size_t most_curves = 1000;            // of the page
constexpr std::size_t most_configuration = 100'000;  // bytes of its text
constexpr std::size_t whole = static_cast<std::size_t>(-1);

constexpr const char* style =
    "@page{size:A4;margin:14mm 12mm}"
    "body{font:11pt/1.4 system-ui,sans-serif;color:#222;background:#fff;max-width:186mm;margin:8mm auto;padding:0 4mm}"
    "h1{font-size:20pt;margin:0 0 2mm}h2{font-size:14pt;margin:8mm 0 2mm;border-bottom:1px solid #bbb}"
    "p{margin:1mm 0 3mm}.small,figcaption,td,th{font-size:9pt}.small,.unit{color:#555}"
    "table{border-collapse:collapse;width:100%}td,th{text-align:left;vertical-align:top;padding:.6mm 2mm .6mm 0;"
    "border-bottom:1px solid #e4e4e4;overflow-wrap:anywhere;unicode-bidi:isolate}th{white-space:nowrap}"
    "thead{display:table-header-group}tr{break-inside:avoid}td.r,th.r{text-align:right;padding-right:3mm}td.r{overflow-"
    "wrap:normal}td.t{white-space:nowrap}"
    "pre{font:8.5pt/1.35 ui-monospace,monospace;white-space:pre-wrap;overflow-wrap:anywhere;background:#f6f6f6;"
    "padding:2mm;margin:2mm 0}"
    "figure{margin:0 0 4mm;break-inside:avoid}figcaption{display:flex;flex-wrap:wrap;justify-content:space-between;"
    "column-gap:4mm}figcaption .range{flex-basis:100%;color:#444}"
    ".verdict{border-left:2mm solid;padding:1mm 3mm;margin:3mm 0}.good{border-color:#2a7f3b}.part{border-color:#d08a14}"
    ".bad{border-color:#b52b27}.verdict b{font-size:13pt}.lost{color:#b52b27}.there{color:#2a7f3b}"
    "@media print{body{margin:0;max-width:none;padding:0;font-size:10pt}h2{break-after:avoid}"
    "*{print-color-adjust:exact;-webkit-print-color-adjust:exact}}";

std::string count(std::uint64_t number, const char* what) {
  return std::to_string(number) + " " + what + (number == 1 ? "" : "s");
}

constexpr Duration fine = std::chrono::milliseconds{1};  // enough for a list

std::string instant(Time utc, Duration step) { return date_text(utc) + " " + clock_text(utc, step); }

/// "30 ms", "39 min"; empty for 0.
std::string time_text(Duration time) {
  if (time == Duration{0}) return "";
  return time < std::chrono::seconds{1} ? to_string(two_digits(time)) : span_text(time);
}

/// A word of a command line.
std::string quoted(const std::string& word) {
  const bool is_plain = !word.empty() && std::all_of(word.begin(), word.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '.' || c == '_' ||
           c == '/' || c == '-';
  });
  if (is_plain && word.front() != '-') return word;
  std::string text = "'";
  for (const char c : word) text += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return text + "'";
}

class Page {
 public:
  explicit Page(const ReportContent& content) : content_(content), run_(content.report.runs.at(0)) {}

  std::string text() && {
    head();
    verdict();
    facts();
    lost();
    make_course();
    curves();
    course();
    sensors();
    errors();
    clock();
    configuration();
    add("<p class=\"small\">Made ", instant(content_.made, std::chrono::seconds{1}), " UTC by <code>rtdata report ",
        quoted(content_.file), " --run ", std::to_string(run_.info.run),
        "</code>. All times are UTC.</p>\n</body></html>\n");
    return std::move(out_);
  }

 private:
  struct Raw {
    std::string text;
  };

  /// Literals of this page are markup, and all other texts are text.
  void put(const char* markup) { out_ += markup; }
  void put(const std::string& text) { out_ += html_text(text); }
  void put(const Raw& markup) { out_ += markup.text; }
  template <class... Parts>
  void add(const Parts&... parts) {
    (put(parts), ...);
  }
  void heading(const char* text) { add("\n<h2>", text, "</h2>\n"); }
  void row(const char* name, const std::string& value) {
    if (!value.empty()) add("<tr><th>", name, "</th><td>", value, "</td></tr>\n");
  }
  /// The text keeps its lines.
  void lines(const std::string& text) {
    add("<pre>");
    for (std::size_t at = 0; at < text.size();) {
      const std::size_t end = std::min(text.find('\n', at), text.size());
      std::string line = text.substr(at, end - at);
      std::replace(line.begin(), line.end(), '\t', ' ');
      if (line.ends_with('\r')) line.pop_back();
      out_ += html_text(line, whole) + "\n";
      at = end + 1;
    }
    add("</pre>\n");
  }
  void left_out(std::uint64_t all, std::size_t shown, const char* where) {
    if (all > shown) add("<p class=\"small\">", std::to_string(all - shown), " left out", where, "</p>\n");
  }
  /// A row for each item, with `row`, up to most_rows; `where` says where the omitted ones are.
  template <class Items, class Row>
  void table(const char* headings, const Items& items, const char* where, const Row& row) {
    add("<table>\n<thead><tr>", headings, "</tr></thead>\n");
    std::size_t shown = 0;
    for (const auto& item : items) {
      if (shown++ == most_rows) break;
      row(item);
    }
    add("</table>\n");
    left_out(items.size(), most_rows, where);
  }
  Time utc(Time recorded) const { return run_.line.utc(recorded); }
  /// With its date, if that differs from the date of the beginning.
  std::string listed_time(Time time) const { return instant_text(time, content_.range.from, fine); }
  Duration length() const { return content_.range.until - content_.range.from; }
  std::string verify_command() const {
    return "rtdata verify " + quoted(content_.file) + " --run " + std::to_string(run_.info.run);
  }

  void head() {
    const std::string name = run_.info.name.empty() ? "Run " + std::to_string(run_.info.run)
                                                    : fitted(run_.info.name, 80);
    add("<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">"
        "<meta name=\"viewport\" content=\"width=device-width\"><title>",
        name, " - ", content_.file, "</title>\n<style>", style, ReportCharts::style(), "</style></head>\n<body>\n<h1>",
        name, "</h1>\n<p>Run ", std::to_string(run_.info.run), " of ", content_.file, ", ",
        instant(content_.range.from, std::chrono::seconds{1}), " to ",
        instant(content_.range.until, std::chrono::seconds{1}), " UTC, ", span_text(length()), "</p>\n");
    if (!run_.info.notes.empty()) add("<p>", Raw{html_text(run_.info.notes, 5000)}, "</p>\n");
  }

  void verdict() {
    const bool is_whole = run_.losses.empty() && run_.not_known.empty() && run_.mute.empty();
    const bool is_bad = content_.report.exit_code() != 0;
    const bool is_good = is_whole && content_.report.verdict() == Verdict::balanced;
    add("<div class=\"verdict ", is_bad ? "bad" : is_good ? "good" : "part", "\"><b>", run_.lines.at(0), "</b>");
    lines(content_.report.text());
    add("</div>\n");
  }

  void facts() {
    const RunInfo& info = run_.info;
    add("<table>\n");
    row("recorded", instant(content_.range.from, fine) + " to " + instant(content_.range.until, fine) + " UTC (" +
                        std::string(name_of(run_.info.state)) + ")");
    row("by", info.program + (info.host.empty() ? "" : " on " + info.host));
    row("holds", count(run_.rows, "row") + " of " + count(run_.origins, "origin"));
    row("remark", info.remark);
    row("run id", info.uuid);
    add("<tr><th>checksum</th><td><code>", run_.checksum_text(),
        "</code>, of all that the recording has of the run. <code>", verify_command() + " --json",
        "</code> computes it from the recording again, and finds what was changed.</td></tr>\n</table>\n");
  }

  /// Each reason of each origin: how often, how much, when first and last.
  void lost() {
    heading("What is missing");
    struct Lost {
      std::uint64_t gaps = 0, counted = 0;
      Duration time{0};
      Time first = Time::max(), last = Time::min();
      bool has_count = false;
    };
    std::map<std::array<std::string, 3>, Lost> all;
    for (const RecordedGap& gap : content_.gaps) {
      Lost& of = all[{gap.topic, gap.origin, reason_of(gap)}];
      const bool has_schedule = std::any_of(content_.ledger.begin(), content_.ledger.end(), [&](const auto& entry) {
        return entry.topic == gap.topic && entry.origin == gap.origin && entry.sensor.has_schedule;
      });
      ++of.gaps;
      of.has_count = has_schedule;
      if (has_schedule) of.counted += gap.count;
      of.time += gap.last - gap.first;
      of.first = std::min(of.first, gap.first);
      of.last = std::max(of.last, gap.last);
    }
    const bool is_pruned = run_.pruned != 0;
    if (all.empty() && run_.losses.empty() && (!is_pruned || !run_.not_known.empty()))
      add("<p>", run_.not_known.empty() ? "Nothing." : "Nothing that is known of.", "</p>\n");
    if (is_pruned) {
      std::string topics;
      std::map<std::string, std::uint64_t> by_topic;
      for (const LedgerEntry& entry : content_.ledger)
        if (entry.pruned != 0) by_topic[entry.topic] += entry.pruned;
      for (const auto& [topic, rows] : by_topic)
        topics += (topics.empty() ? "" : ", ") + topic + " " + std::to_string(rows);
      add("<p>Rows that were recorded and deleted since, by max_age or max_bytes: ", Raw{html_text(topics, 5000)},
          "</p>\n");
    }
    const std::vector<std::string>& notes = content_.plot.notes;
    constexpr std::size_t most_notes = 50;
    for (std::size_t i = 0; i < std::min(notes.size(), most_notes); ++i) add("<p>", notes[i], "</p>\n");
    left_out(notes.size(), most_notes, " of these.");
    if (all.empty()) return;
    constexpr const char* headings =
        "<th>topic</th><th>of</th><th>why</th><th class=\"r\">gaps</th><th class=\"r\">ticks lost</th>"
        "<th class=\"r\">time</th><th>first</th><th>last</th>";
    table(headings, all, ".", [&](const auto& item) {
      const auto& [key, of] = item;
      add("<tr><td>", key[0], "</td><td>", key[1], "</td><td>", key[2], "</td><td class=\"r\">",
          std::to_string(of.gaps), "</td><td class=\"r\">", of.has_count ? std::to_string(of.counted) : "not known",
          "</td><td class=\"r\">", time_text(of.time), "</td><td class=\"t\">", listed_time(utc(of.first)),
          "</td><td class=\"t\">", listed_time(utc(of.last)), "</td></tr>\n");
    });
  }

  // ---- the course

  struct Happening {
    Time at{};
    const char* kind;
    const CourseEvent* event;
  };

  void make_course() {
    const Course& of = content_.course;
    for (const auto& [events, kind] :
         {std::pair{&of.notes, "note"}, {&of.commands, "command"}, {&of.alarms, "alarm"}, {&of.states, "state"}}) {
      happened_ += events->count;
      for (const CourseEvent& event : events->first) happenings_.push_back({utc(event.time), kind, &event});
    }
    std::stable_sort(happenings_.begin(), happenings_.end(),
                     [](const Happening& a, const Happening& b) { return a.at < b.at; });
  }

  void course() {
    if (happenings_.empty()) return;
    heading("What happened");
    add("<table>\n<thead><tr><th class=\"r\">no.</th><th>time</th><th>kind</th><th>of, or by</th><th>what</th>"
        "</tr></thead>\n");
    const std::size_t shown = std::min(happenings_.size(), most_rows);
    for (std::size_t i = 0; i < shown; ++i) {
      const Happening& one = happenings_[i];
      add("<tr><td class=\"r\">", std::to_string(i + 1), "</td><td class=\"t\">", listed_time(one.at), "</td><td>",
          one.kind, "</td><td>", one.event->object, "</td><td>", one.event->text, "</td></tr>\n");
    }
    add("</table>\n");
    left_out(happened_, shown, "; `rtdata info --json` and `rtdata export` have them.");
  }

  // ---- curves

  const LedgerEntry* account_of_curve(const Curve& curve) const {
    const auto found = std::find_if(content_.ledger.begin(), content_.ledger.end(), [&](const LedgerEntry& entry) {
      return entry.topic == curve.topic && entry.origin == curve.origin;
    });
    return found == content_.ledger.end() ? nullptr : &*found;
  }

  /// The rate was changed while it was recorded: rows of one time weigh more than those of another.
  bool has_several_rates(const Curve& curve) const {
    std::set<Duration> periods;
    for (const RecordedSegment& one : content_.schedule)
      if (one.topic == curve.topic && one.origin == curve.origin && one.segment.scheduled != 0)
        periods.insert(one.segment.period);
    return periods.size() > 1;
  }

  /// "over 97.2 % of the time"; where rows do not stand for equal times, "of the recorded values". `in`: "of", or "in".
  std::string coverage_text(const Curve& curve, const char* in) const {
    const LedgerEntry* const account = account_of_curve(curve);
    if (account == nullptr) return "of what is there";
    Duration outages{0};
    for (const OriginOutages& of : run_.outages)
      if (of.topic == curve.topic && of.origin == curve.origin) outages = of.outages.time;
    const double share = coverage_of(curve, *account, outages, length());
    const std::string of = account->sensor.has_schedule || outages > Duration{0} ? " of the time" : " of its values";
    const double percent = std::floor(share * 1000) / 10;
    std::array<char, 40> part{};
    std::snprintf(part.data(), part.size(), percent < 0.1 ? "less than 0.1 %%" : "%.1f %%", percent);
    // How many values of it would have come of what its sources lost is not known.
    if (share >= 1 && curve.has_loss && !account->made_of.empty()) return "of what is there";
    const std::uint64_t held_back = account->sensor.filtered;
    const bool is_rate_changed = has_several_rates(curve);
    if (held_back == 0 && !is_rate_changed) return "over " + std::string(share >= 1 ? "all" : part.data()) + of;
    std::string text = std::string(in) + " the recorded values";
    if (share < 1) text += ", which stand for " + (part.data() + of);
    if (held_back != 0) text += "; " + count(held_back, "sample") + (held_back == 1 ? " was" : " were") + " held back";
    return text + (is_rate_changed ? "; the rate was changed" : "");
  }

  std::string time_of(const Extreme& extreme) const {
    return instant_text(extreme.at, content_.plot.from, content_.plot.read_step);
  }

  std::string range_of_curve(const Curve& curve) const {
    const Scale scale(curve);
    const RangeTexts texts = range_texts(curve, scale);
    std::string text;
    if (!curve.least) {
      text = "no values";
    } else if (scale.is_constant()) {
      text = "always " + exact_text(*scale.least, curve.kind) + " " + coverage_text(curve, "in");
    } else {
      text = "least " + texts.least + " at " + time_of(*curve.least) + ", most " + texts.most + " at " +
             time_of(*curve.most);
      text += (texts.mean.empty() ? " " : ", mean " + texts.mean + " ") + coverage_text(curve, "of");
    }
    std::uint64_t events = 0;
    for (const CurveStep& step : curve.steps) events += step.events;
    const std::uint64_t none = events - scale.numbers;
    if (none != 0) text += "; " + std::to_string(none) + (none == 1 ? " is" : " are") + " absent or NaN";
    return text + (scale.has_infinite ? "; some are infinite" : "");
  }

  std::string limits_text(const std::vector<TimedLimits>& limits) const {
    std::string text;
    const auto add = [&](const std::optional<double>& limit, const char* name) {
      if (limit) text += (text.empty() ? "limits: " : ", ") + std::string(name) + " " + to_string(Value{*limit});
    };
    for (const auto& [one, from, until] : limits) {
      add(one.low_low, "low low");
      add(one.low, "low");
      add(one.high, "high");
      add(one.high_high, "high high");
      if (from > content_.range.from) text += " from " + listed_time(from);
      if (until < content_.range.until) text += " until " + listed_time(until);
    }
    return text;
  }

  void curves() {
    heading("Curves");
    std::vector<ChartMark> marks;
    constexpr std::size_t most_numbers = 40;
    for (std::size_t i = 0; i < happenings_.size(); ++i)
      marks.push_back({happenings_[i].at, i < most_numbers ? i + 1 : 0, happenings_[i].kind});
    ReportCharts charts(content_.plot, marks);
    add("<p class=\"small\">A line shows the mean of each ", to_string(content_.plot.step),
        ", and the area around it the range from least to most. Red: data is missing.");
    if (!content_.limits.empty()) add(" Orange and red from a dashed line on: beyond a limit.");
    if (!marks.empty()) add(" Dotted lines and their numbers: what happened, see the list below.");
    if (content_.plot.read_step >= std::chrono::seconds{1})
      add(" Times of the least and the most are the beginning of the ",
          content_.plot.read_step == std::chrono::seconds{1} ? "second" : "minute", ".");
    add("</p>\n");
    std::size_t shown = 0;
    for (const Curve& curve : content_.plot.curves) {
      if (shown == most_curves) break;
      ++shown;
      add("<figure><figcaption><span><b>", curve.name, "</b>");
      if (!curve.unit.empty()) add(" <span class=\"unit\">[", curve.unit, "]</span>");
      add("</span><span class=\"", curve.has_loss ? "lost" : "there", "\">", curve.verdict,
          "</span><span class=\"range\">", range_of_curve(curve), "</span>");
      const auto limits = content_.limits.find(curve.topic + "." + curve.path);
      static const std::vector<TimedLimits> none;
      const std::vector<TimedLimits>& of = limits == content_.limits.end() ? none : limits->second;
      if (!of.empty()) add("<span class=\"range\">", limits_text(of), "</span>");
      if (!curve.gaps.empty()) add("<span class=\"range lost\">", gaps_text(curve), "</span>");
      add("</figcaption>\n", Raw{charts.chart_of(curve, of)}, "</figure>\n");
    }
    if (content_.plot.curves.empty()) add("<p>The run has no numbers.</p>\n");
    left_out(content_.plot.curves.size(), shown, "; `rtdata plot` draws each.");
    if (content_.not_drawn.empty()) return;
    constexpr std::size_t most = 20;
    std::string names;
    for (std::size_t i = 0; i < content_.not_drawn.size() && i < most; ++i)
      names += (i == 0 ? "" : ", ") + content_.not_drawn[i];
    if (content_.not_drawn.size() > most) names += " and " + std::to_string(content_.not_drawn.size() - most) + " more";
    add("<p class=\"small\">Without a curve, because these fields are not numbers: ", Raw{html_text(names, whole)},
        ".</p>\n");
  }

  // ---- other sections

  void sensors() {
    heading("Who measured");
    if (content_.ledger.empty()) {
      add("<p>Nobody is known.</p>\n");
      return;
    }
    constexpr const char* headings =
        "<th>topic</th><th>of</th><th class=\"r\">stored</th><th class=\"r\">ticks</th><th class=\"r\">missed</th>"
        "<th class=\"r\">failed</th><th class=\"r\">late</th><th class=\"r\">unreadable</th>"
        "<th class=\"r\">lost by source</th><th class=\"r\">dropped</th><th class=\"r\">pruned</th>";
    table(headings, content_.ledger, "; `rtdata info` has all.", [&](const LedgerEntry& entry) {
      const SensorCounts& sensor = entry.sensor;
      add("<tr><td>", entry.topic, "</td><td>", entry.origin, "</td>");
      const auto cell = [&](const std::string& text) { add("<td class=\"r\">", text, "</td>"); };
      const auto of_schedule = [&](std::uint64_t number) {
        cell(sensor.has_schedule ? std::to_string(number) : std::string("-"));
      };
      cell(std::to_string(entry.stored));
      of_schedule(sensor.scheduled);
      of_schedule(sensor.missed);
      of_schedule(sensor.failed);
      of_schedule(sensor.late);
      cell(std::to_string(sensor.unreadable));
      cell(sensor.lost_is_known || sensor.lost != 0 ? std::to_string(sensor.lost) : std::string("-"));
      cell(std::to_string(entry.dropped()));
      cell(std::to_string(entry.pruned));
      add("</tr>\n");
    });
    add("<p class=\"small\">-: the sensor has no schedule, or does not number its samples.</p>\n");
  }

  void errors() {
    if (!content_.errors.empty()) {
      heading("Errors");
      constexpr const char* headings = "<th>time</th><th>of</th><th>error</th><th class=\"r\">times</th>";
      table(headings, content_.errors, ".", [&](const RecordedError& error) {
        add("<tr><td class=\"t\">", listed_time(utc(error.time)), "</td><td>", error.object, "</td><td>", error.text,
            "</td><td class=\"r\">", std::to_string(error.count), "</td></tr>\n");
      });
    }
    if (content_.health.empty()) return;
    heading("Health");
    constexpr const char* headings = "<th>time</th><th>of</th><th>since then</th><th>why</th>";
    table(headings, content_.health, ".", [&](const RecordedHealth& change) {
      add("<tr><td class=\"t\">", listed_time(utc(change.last)), "</td><td>", change.kind + " " + change.name,
          "</td><td>", change.state + (change.count > 1 ? ", after " + count(change.count, "change") : std::string()),
          "</td><td>", change.reason, "</td></tr>\n");
    });
  }

  void clock() {
    heading("Clock");
    std::map<std::string, std::uint64_t> sources;
    std::uint64_t steps = 0;
    for (const RecordedClock& pair : content_.clock) {
      ++sources[pair.source];
      if (pair.occasion == "step") ++steps;
    }
    std::string text;
    for (const auto& [source, number] : sources)
      text += (text.empty() ? "" : ", ") + source + " " + std::to_string(number);
    if (text.empty()) {
      add("<p>The time of day was never read: times are shown as they were recorded, not converted to UTC.</p>\n");
      return;
    }
    const auto error = clock_error(run_.info, content_.clock, length());
    add("<p>The time of day was read ", std::to_string(content_.clock.size()), " times (", text, "). ",
        error ? "UTC is right to within " + to_string(two_digits(std::max(*error, Duration{1}))) + " in all of the run."
              : std::string("How far UTC is wrong is not known: the machine did not say how well its clock was set."));
    if (steps != 0)
      add(" The clock was set ", count(steps, "time"), "; no interval in the recording has changed by it.");
    add("</p>\n");
  }

  void configuration() {
    if (!content_.changes.empty()) {
      heading("Changes of the configuration");
      table("<th>time</th><th>what</th>", content_.changes, ".", [&](const RecordedConfiguration& change) {
        add("<tr><td class=\"t\">", listed_time(utc(change.time)), "</td><td>",
            change.object.empty() ? std::string("a new text")
                                  : change.object + (change.text.empty() ? ": removed" : ""),
            "</td></tr>\n");
        if (!change.text.empty()) {
          add("<tr><td></td><td>");
          lines(change.text.substr(0, 2000));
          if (change.text.size() > 2000) add("(", std::to_string(change.text.size() - 2000), " bytes left out)");
          add("</td></tr>\n");
        }
      });
    }
    const std::string& text = run_.info.configuration;
    if (text.empty()) return;
    heading("Configuration at the start");
    lines(text.substr(0, most_configuration));
    if (text.size() > most_configuration)
      add("<p class=\"small\">", std::to_string(text.size() - most_configuration),
          " bytes left out; `rtdata info --json` has them.</p>\n");
  }

  const ReportContent& content_;
  const RunReport& run_;
  std::string out_;
  std::vector<Happening> happenings_;  // in order of time, from the first on
  std::uint64_t happened_ = 0;         // of all
};

}  // namespace

std::string page_of(const ReportContent& content) { return Page(content).text(); }

}  // namespace rtdata::app
