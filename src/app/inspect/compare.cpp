// rtdata compare: the figures of two runs side by side.
#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <limits>
#include <list>
#include <map>
#include <nlohmann/json.hpp>
#include <ostream>
#include <set>
#include <utility>

#include "app/core/figures.hpp"
#include "app/core/recording_commands.hpp"
#include "app/core/table.hpp"
#include "app/core/terminal_text.hpp"
#include "app/inspect/curve_scale.hpp"
#include "rtdata/data/problem.hpp"
#include "rtdata/loop/topic.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/runs.hpp"
#include "rtdata/recording/verify.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

/// The figures of the values of a field that are present and not NaN.
struct RunFigures {
  std::uint64_t count = 0;
  double least = std::numeric_limits<double>::infinity(), largest = -least, mean = 0, squares = 0;
  void add(double value) {
    if (std::isnan(value)) return;
    least = std::min(least, value);
    largest = std::max(largest, value);
    const double before = value - mean;
    weigh_in(mean, value, 1 / static_cast<double>(++count));
    squares += before * (value - mean);
  }
  double deviation() const { return count < 2 ? 0 : std::sqrt(squares / static_cast<double>(count - 1)); }
};

std::optional<double> number_of(const Value& value) {
  return std::visit(
      [](const auto& held) -> std::optional<double> {
        using Held = std::decay_t<decltype(held)>;
        if constexpr (std::is_same_v<Held, bool>) {
          return held ? 1.0 : 0.0;
        } else if constexpr (std::is_same_v<Held, char> || !std::is_arithmetic_v<Held>) {
          return std::nullopt;
        } else {
          return static_cast<double>(held);
        }
      },
      value);
}

/// One of the two runs.
struct Side {
  RunInfo info;
  Time from{};
  std::optional<Time> until;
  std::string from_utc;
};

/// A field whose unit changed, between the runs or within one, is one for each unit.
struct ComparedField {
  std::string path, unit;
  Kind kind = Kind::f64;
  std::array<RunFigures, 2> figures{};
};

/// One comparison: an origin's events on a topic, in both runs.
struct Part {
  std::array<std::uint64_t, 2> events{};
  std::array<std::string, 2> lost;
  std::array<std::uint64_t, 2> pruned{};  // of the whole run
  std::list<ComparedField> fields;        // in order

  /// A new one follows that of the same path, if there is one.
  ComparedField& field_of(const Leaf& leaf) {
    auto at = fields.end();
    for (auto one = fields.begin(); one != fields.end(); ++one) {
      if (one->path != leaf.path) continue;
      if (one->unit == leaf.unit) return *one;
      at = std::next(one);
    }
    return *fields.insert(at, {leaf.path, leaf.unit, leaf.kind, {}});
  }
};
using Key = std::pair<std::string, std::string>;  // topic and origin

[[noreturn]] void refuse(const std::string& where, std::string why, std::string advice) {
  throw SetupError({Errc::not_found, "cannot compare", where, std::move(why), std::move(advice)});
}

/// The first event of a topic in the run; for "MACHINE=STATE", the first that goes to this state.
Time instant_of(const Recording& recording, const RunInfo& run, const std::string& from) {
  if (from.empty()) return run.started;
  const std::string topic = from.substr(0, from.find('='));
  const std::string state = topic.size() < from.size() ? from.substr(topic.size() + 1) : "";
  const std::string where = recording.path() + ", run " + std::to_string(run.run);
  std::vector<std::string> topics;
  for (const RecordedTopic& one : recording.topics().or_throw()) topics.push_back(one.topic);
  if (std::find(topics.begin(), topics.end(), topic) == topics.end()) {
    const std::string nearest = nearest_name(topic, topics);
    refuse(recording.path(), "there is no topic " + topic + (nearest.empty() ? "" : " (did you mean " + nearest + "?)"),
           "`rtdata info` lists what there is");
  }
  auto rows = recording.rows({.topic = topic, .run = run.run}).or_throw();
  std::vector<std::string> states;
  while (const RecordedRow* const row = rows.next().or_throw()) {
    if (topic.size() == from.size()) return row->header().time;
    const auto to = row->event().value("to");
    if (!to) refuse(where, "topic " + topic + " has no states: its events have no field `to`", "name a topic alone");
    if (to_string(*to) == state) return row->header().time;
    states.push_back(to_string(*to));
  }
  if (topic.size() == from.size()) refuse(where, "topic " + topic + " has no events in it", "choose another instant");
  const std::string nearest = nearest_name(state, states);
  refuse(where, topic + " never goes to state " + state + (nearest.empty() ? "" : " (did you mean " + nearest + "?)"),
         "choose another instant");
}

/// The losses of each topic in the whole of both runs.
using Losses = std::map<std::string, std::array<std::string, 2>>;

void read_side(const Recording& recording, const Side& side, std::size_t which, std::map<Key, Part>& parts,
               Losses& losses) {
  std::set<std::string> topics;
  for (const RecordedTopic& topic : recording.topics().or_throw()) topics.insert(topic.topic);
  for (const std::string& topic : topics) {
    auto rows = recording.rows({.topic = topic, .run = side.info.run, .from = side.from, .until = side.until})
                    .or_throw();
    std::map<std::pair<const Part*, const Leaf*>, ComparedField*> known;  // of the descriptions that `rows` has
    while (const RecordedRow* const row = rows.next().or_throw()) {
      const EventView event = row->event();
      Part& part = parts[{topic, std::string(event.origin())}];
      ++part.events[which];
      for (const Leaf& leaf : event.description().leaves()) {
        const auto value = number_of(event.value(leaf));
        if (!value) continue;
        ComparedField*& field = known[{&part, &leaf}];
        if (field == nullptr) field = &part.field_of(leaf);
        field->figures[which].add(*value);
      }
    }
  }
  for (const LedgerEntry& entry : recording.ledger(side.info.run).or_throw())
    if (entry.pruned != 0) parts[{entry.topic, entry.origin}].pruned[which] = entry.pruned;
  const RunReport account = account_of(recording, side.info.run).or_throw();
  for (const TopicLoss& loss : account.losses) {
    std::string text;
    if (loss.samples() != 0) text = std::to_string(loss.samples()) + (loss.samples() == 1 ? " sample" : " samples");
    if (loss.ticks() != 0)
      text += (text.empty() ? "" : ", ") + std::to_string(loss.ticks()) + (loss.ticks() == 1 ? " tick" : " ticks");
    if (loss.outages.number != 0) text += (text.empty() ? "" : ", ") + to_string(loss.outages);
    losses[loss.topic][which] = text;
  }
}

/// A topic that lost something and has no event is a part of its own, without an origin.
void add_losses(const Losses& losses, std::map<Key, Part>& parts) {
  for (const auto& [topic, lost] : losses) {
    const auto first = parts.lower_bound({topic, ""});
    if (first == parts.end() || first->first.first != topic) parts[{topic, ""}];
    for (auto& [key, part] : parts)
      if (key.first == topic) part.lost = lost;
  }
}

/// A curve of one step, whose scale gives the digits.
Curve curve_of(const ComparedField& field, const RunFigures& of) {
  Curve curve;
  curve.kind = field.kind;
  if (of.count != 0) curve.steps.push_back({{}, of.count, of.count, of.least, of.largest, of.mean});
  return curve;
}

/// Enough digits to tell values of each run apart, and those of one run from those of the other.
Scale scale_of(const ComparedField& field) {
  Curve curve = curve_of(field, field.figures[0]);
  int digits = Scale(curve).digits;
  const Curve second = curve_of(field, field.figures[1]);
  digits = std::max(digits, Scale(second).digits);
  curve.steps.insert(curve.steps.end(), second.steps.begin(), second.steps.end());
  Scale both(curve);
  both.digits = std::max(digits, both.digits);
  return both;
}

std::string figure(const ComparedField& field, const RunFigures& of, double value, const Scale& scale) {
  constexpr double all_exact = 0x1p53;
  if (of.count == 0) return "-";
  if (std::isnan(value)) return "nan";  // its sign has no meaning
  const bool is_whole = field.kind != Kind::f32 && field.kind != Kind::f64 && std::abs(value) < all_exact &&
                        value == std::trunc(value);
  if (is_whole) return std::to_string(static_cast<std::int64_t>(value));
  return of.least == of.largest ? exact_text(value, field.kind) : scale.text(value);
}

std::string title_of(const Side& side) {
  return "run " + std::to_string(side.info.run) + (side.info.name.empty() ? "" : " \"" + side.info.name + "\"") +
         " from " + side.from_utc;
}

void print(const std::array<Side, 2>& sides, const std::map<Key, Part>& parts, std::ostream& out) {
  out << "1: " << title_of(sides[0]) << "\n2: " << title_of(sides[1]) << "\n";
  for (const auto& [key, part] : parts) {
    out << "\n"
        << (key.first.empty() ? "sensors that had only begun" : key.first)
        << (key.second == key.first || key.second.empty() ? "" : " of " + key.second) << ": " << part.events[0]
        << " and " << part.events[1] << " events\n";
    for (std::size_t i = 0; i < 2; ++i)
      if (part.pruned[i] != 0)
        out << "  " << i + 1 << ": " << part.pruned[i] << " rows of the run are pruned, and not in the figures\n";
    for (std::size_t i = 0; i < 2; ++i)
      if (!part.lost[i].empty()) out << "  " << i + 1 << ": in the whole run the topic lost " << part.lost[i] << "\n";
    Table table({"field", "", ">least", ">mean", ">largest"});
    for (const ComparedField& field : part.fields) {
      std::string name = field.path + (field.unit.empty() ? "" : " [" + field.unit + "]");
      const Scale scale = scale_of(field);
      for (std::size_t i = 0; i < 2; ++i) {
        const RunFigures& of = field.figures[i];
        const auto text = [&](double value) { return figure(field, of, value, scale); };
        table.add({std::exchange(name, ""), i == 0 ? "1:" : "2:", text(of.least), text(of.mean), text(of.largest)});
      }
    }
    if (!table.empty()) out << table.text("  ", 80);
  }
  const auto has_none = [](const auto& of) { return of.second.events[0] + of.second.events[1] == 0; };
  if (std::all_of(parts.begin(), parts.end(), has_none)) out << "\nNeither of the two runs has an event.\n";
}

/// Written like the JSON codec.
Json json_of(double value) {
  if (std::isnan(value)) return "NaN";
  if (std::isinf(value)) return value > 0 ? "Infinity" : "-Infinity";
  return value;
}

void print_json(const std::array<Side, 2>& sides, const std::map<Key, Part>& parts, std::ostream& out) {
  Json json{{"runs", Json::array()}, {"topics", Json::array()}};
  for (const Side& side : sides)
    json["runs"].push_back({{"run", side.info.run}, {"name", side.info.name}, {"from_utc", side.from_utc}});
  for (const auto& [key, part] : parts) {
    Json one{{"topic", key.first},
             {"origin", key.second},
             {"events", part.events},
             {"lost", part.lost},
             {"pruned", part.pruned}};
    one["fields"] = Json::array();
    for (const ComparedField& field : part.fields) {
      Json figures{{"field", field.path}, {"unit", field.unit}};
      for (const char* name : {"count", "min", "mean", "max", "deviation"}) figures[name] = Json::array();
      for (const RunFigures& of : field.figures) {
        const auto add = [&](const char* name, double value) {
          figures[name].push_back(of.count == 0 ? Json() : json_of(value));
        };
        figures["count"].push_back(of.count);
        add("min", of.least);
        add("mean", of.mean);
        add("max", of.largest);
        add("deviation", of.deviation());
      }
      one["fields"].push_back(std::move(figures));
    }
    json["topics"].push_back(std::move(one));
  }
  out << json.dump(2, ' ', false, Json::error_handler_t::replace) << "\n";
}

}  // namespace

int compare(const CompareOptions& options, std::ostream& out, std::ostream& err) try {
  const Recording recording = Recording::open(options.database).or_throw();
  std::optional<Duration> length;
  if (!options.length.empty()) {
    length = parse_duration(options.length).or_throw();
    if (*length <= Duration{0})
      throw SetupError({Errc::bad_argument, "cannot compare", "--for " + options.length, "it is not above 0",
                        "write one such as 10s"});
  }
  const std::vector<RunInfo> runs = recording.runs().or_throw();
  std::array<Side, 2> sides;
  std::map<Key, Part> parts;
  Losses losses;
  for (std::size_t i = 0; i < sides.size(); ++i) {
    Side& side = sides[i];
    side.info = find_run(runs, i == 0 ? options.first : options.second, recording.path()).or_throw();
    side.from = instant_of(recording, side.info, options.from);
    if (length) side.until = side.from + *length;
    side.from_utc = to_iso8601(recording.utc_line(side.info.run).or_throw().utc(side.from));
    read_side(recording, side, i, parts, losses);
  }
  add_losses(losses, parts);
  options.show_as == ShowAs::json ? print_json(sides, parts, out) : print(sides, parts, out);
  return 0;
} catch (const SetupError& error) {
  print_error(err, error.error());
  return status_after(error.error());
}

}  // namespace rtdata::app
