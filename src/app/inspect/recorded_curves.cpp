#include "app/inspect/recorded_curves.hpp"

#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include "rtdata/data/problem.hpp"
#include "rtdata/recording/verify.hpp"

namespace rtdata::app {
namespace {

bool is_number(Kind kind) {
  return kind != Kind::text && kind != Kind::character && kind != Kind::enumeration && kind != Kind::record;
}

[[noreturn]] void refuse(const std::string& name, std::string why, std::string advice) {
  throw SetupError({Errc::not_found, "cannot plot", name, std::move(why), std::move(advice)});
}

std::string nearest_or_all(const std::string& name, const std::vector<std::string>& known) {
  const std::string nearest = nearest_name(name, known);
  if (!nearest.empty()) return "did you mean " + nearest + "?";
  return "there is " + list_of({known.begin(), known.end()});
}

/// The numbers that a path stands for; empty: none. `is_there`: there is something of that name.
std::vector<std::string> numbers_of(const Description& of, const std::string& path, bool& is_there) {
  std::vector<std::string> found;
  for (const Leaf& leaf : of.leaves()) {
    const bool is_it = path.empty() || leaf.path == path || leaf.path.starts_with(path + ".") ||
                       leaf.path.starts_with(path + "[");
    // "pressure.raw" was added beside the number "pressure", and is none of its parts.
    if (!is_it || (leaf.path != path && of.find(path) != nullptr)) continue;
    is_there = true;
    if (is_number(leaf.kind)) found.push_back(leaf.path);
  }
  return found;
}

/// Why there is no number.
std::string no_number_text(const Description& of, const std::string& path) {
  const Leaf* const leaf = of.find(path);
  if (leaf == nullptr) return "it holds no number";
  std::string text = "it is " +
                     std::string(leaf->kind == Kind::enumeration ? "an enum" : "a " + std::string(name_of(leaf->kind)));
  if (leaf->kind == Kind::enumeration) {
    std::set<std::string> words;
    for (const EnumValue& value : leaf->field->values) words.insert(value.name);
    text += " (" + list_of(words) + ")";
  }
  return text + ", and a curve is of numbers";
}

std::vector<ChosenField> chosen(const std::string& name, const std::vector<RecordedTopic>& topics) {
  std::set<std::string> names;
  for (const RecordedTopic& topic : topics) names.insert(topic.topic);
  // Both topics and fields may have points in their names: the longest topic is meant.
  std::string topic = name;
  while (!names.contains(topic)) {
    const std::size_t point = topic.rfind('.');
    if (point == std::string::npos) {
      std::vector<std::string> known(names.begin(), names.end());
      for (const RecordedTopic& one : topics)
        for (const Leaf& leaf : one.description->leaves())
          if (is_number(leaf.kind)) known.push_back(one.topic + "." + leaf.path);
      const std::string nearest = nearest_name(name, known);
      refuse(name, "there is no such topic",
             nearest.empty() ? "there is " + list_of(names) : "did you mean " + nearest + "?");
    }
    topic.resize(point);
  }
  const std::string path = name.size() > topic.size() ? name.substr(topic.size() + 1) : "";
  std::vector<ChosenField> fields;
  const Description* last = nullptr;
  bool is_there = false;
  for (const RecordedTopic& one : topics) {  // another description may have other fields
    if (one.topic != topic) continue;
    last = one.description.get();
    for (std::string& found : numbers_of(*last, path, is_there)) {
      ChosenField field{topic, std::move(found)};
      if (std::find(fields.begin(), fields.end(), field) == fields.end()) fields.push_back(std::move(field));
    }
  }
  if (!fields.empty()) return fields;
  if (is_there) refuse(name, no_number_text(*last, path), "`rtdata export` has all values");
  std::vector<std::string> known;
  for (const Leaf& leaf : last->leaves()) known.push_back(leaf.path);
  refuse(name, "topic " + topic + " has no field " + path, nearest_or_all(path, known));
}

/// Where the steps of one field are in the rows of one description: its least and its most follow its count.
struct Place {
  const Leaf *count = nullptr, *least = nullptr, *most = nullptr, *mean = nullptr;
  Kind kind = Kind::f64;  // of the field
};

/// The number that an alternative of Value is.
Number number_of(const Value& value) {
  if (const auto* const whole = std::get_if<std::int64_t>(&value)) return *whole;
  if (const auto* const natural = std::get_if<std::uint64_t>(&value)) return *natural;
  return std::get<double>(value);
}

/// One origin on one topic.
struct Source {
  std::vector<Curve> curves;  // of the fields that were chosen of that topic
  std::vector<CurveGap> gaps;
  bool has_schedule = false;
  std::uint64_t last_sequence = 0;  // of the step before
  Time last_begin{};
};

class Reader {
 public:
  Reader(const Recording& recording, const RecordedRange& range, std::string topic, std::vector<std::string> paths,
         const std::optional<std::string>& origin, Duration step)
      : range_(range), topic_(std::move(topic)), paths_(std::move(paths)), step_(step) {
    for (RecordedTopic& one : recording.topics().or_throw())
      if (one.topic == topic_) descriptions_[one.version] = std::move(one);
    for (const LedgerEntry& entry : recording.ledger(range.run.run).or_throw())
      if (entry.topic == topic_ && (!origin || entry.origin == *origin))
        source(entry.origin).has_schedule = entry.sensor.has_schedule;
    RowFilter filter{.topic = topic_, .run = range.run.run, .origin = origin, .from = range.from, .until = range.until};
    filter.gaps = RowFilter::Gaps::in_place;
    filter.times = RowFilter::Times::utc;
    auto rows = recording.steps(filter, step).or_throw();
    while (const RecordedRow* row = rows.next().or_throw()) row->gap() != nullptr ? add(*row->gap()) : add(*row);
  }

  std::map<std::string, Source>& sources() { return sources_; }

 private:
  Source& source(const std::string& origin) {
    const auto [known, is_new] = sources_.try_emplace(origin);
    if (is_new) {
      for (const std::string& path : paths_) {
        Curve& curve = known->second.curves.emplace_back();
        curve.name = topic_ + "." + path;
        curve.source = topic_ + " " + origin;
        for (const auto& [version, one] : descriptions_) {
          const Leaf* const leaf = one.description->find(path);
          if (leaf != nullptr) curve.unit = leaf->unit;
        }
      }
    }
    return known->second;
  }

  void add(const RecordedGap& gap) {
    Source& of = source(gap.origin);
    const bool is_joined = gap.kind == "joined";
    const bool has_count = gap.kind == "missed" || gap.kind == "failed" || (is_joined && of.has_schedule);
    std::string reason = is_joined ? "several gaps joined" : gap.kind;
    if (!gap.reason.empty() && gap.reason != gap.kind) reason += ": " + gap.reason;
    of.gaps.push_back({range_.line.utc(gap.first), range_.line.utc(gap.last), has_count ? gap.count : 0, reason});
  }

  /// What sequences between two steps, or within one, do not have a row.
  void add_missing(Source& of, const RecordedRow& row, std::uint64_t events) {
    constexpr const char* not_stored = "not stored: dropped by the recording";
    const Time begin = row.header().time;
    if (of.last_sequence != 0 && row.first_sequence() > of.last_sequence + 1) {
      const bool is_beside = begin - of.last_begin <= step_;
      of.gaps.push_back({is_beside ? begin : of.last_begin + step_, is_beside ? begin : begin - Duration{1},
                         row.first_sequence() - of.last_sequence - 1, not_stored});
    }
    const std::uint64_t span = row.last_sequence() - row.first_sequence() + 1;
    if (span > events) of.gaps.push_back({begin, begin, span - events, not_stored});
    of.last_sequence = row.last_sequence();
    of.last_begin = begin;
  }

  void add(const RecordedRow& row) {
    Source& of = source(std::string(row.header().origin));
    const EventView event = row.event();
    const std::uint64_t events = std::get<std::uint64_t>(event.value(event.description().leaves().front()));
    add_missing(of, row, events);
    const std::vector<Place>& places = places_of(row);
    for (std::size_t i = 0; i < places.size(); ++i) {
      const Place& place = places[i];
      if (place.count == nullptr) continue;  // the description of this row does not have it
      CurveStep step{row.header().time, events, std::get<std::uint64_t>(event.value(*place.count)), {}, {}, 0};
      if (step.numbers != 0) {
        step.least = number_of(event.value(*place.least));
        step.most = number_of(event.value(*place.most));
        step.mean = std::get<double>(event.value(*place.mean));
      }
      Curve& curve = of.curves[i];
      if (!curve.steps.empty() && curve.kind != place.kind)
        refuse(curve.name, "its type changed within the run", "choose a part of it: --from, --until");
      curve.kind = place.kind;
      curve.steps.push_back(step);
    }
  }

  /// The steps have four values of each number, in the order of the numbers, after the number of events.
  const std::vector<Place>& places_of(const RecordedRow& row) {
    const auto [known, is_new] = places_.try_emplace(row.topic().version);
    if (!is_new) return known->second;
    known->second.resize(paths_.size());
    const Leaf* of_steps = row.topic().description->leaves().data() + 1;
    for (const Leaf& leaf : descriptions_.at(row.topic().version).description->leaves()) {
      if (!is_number(leaf.kind)) continue;
      const auto path = std::find(paths_.begin(), paths_.end(), leaf.path);
      if (path != paths_.end())
        known->second[static_cast<std::size_t>(path - paths_.begin())] = {of_steps, of_steps + 1, of_steps + 2,
                                                                          of_steps + 3, leaf.kind};
      of_steps += 4;
    }
    return known->second;
  }

  const RecordedRange& range_;
  const std::string topic_;
  const std::vector<std::string> paths_;
  const Duration step_;
  std::map<std::int64_t, RecordedTopic> descriptions_;  // by version
  std::map<std::int64_t, std::vector<Place>> places_;   // of the paths, by version
  std::map<std::string, Source> sources_;               // by origin
};

/// There is nothing of the topic, or of that origin on it, in the run.
[[noreturn]] void refuse_run(const Recording& recording, std::int64_t run, const std::string& topic,
                             const std::optional<std::string>& origin) {
  std::set<std::string> runs, origins;
  for (const RunInfo& one : recording.runs().or_throw()) {
    for (const LedgerEntry& entry : recording.ledger(one.run).or_throw()) {
      if (entry.topic != topic) continue;
      if (one.run == run) origins.insert(entry.origin);
      if (!origin || entry.origin == *origin) runs.insert(std::to_string(one.run));
    }
  }
  const std::string of_run = "run " + std::to_string(run);
  if (!origins.empty()) refuse(topic, of_run + " has none of origin " + *origin, "there is " + list_of(origins));
  refuse(topic, of_run + " has nothing of it", runs.empty() ? "" : "see --run: " + list_of(runs));
}

// ---- what the account says

/// What a topic lost in the run, and the unrecorded topics that it is made of.
TopicLoss loss_of(const RunReport& account, const std::string& topic) {
  TopicLoss loss;
  for (const TopicLoss& one : account.losses) {
    const auto& made = one.made_of_it;
    if (one.topic == topic || std::find(made.begin(), made.end(), topic) != made.end()) loss.add(one);
  }
  loss.topic = topic;
  return loss;
}

/// "12 lost", "1 outage of 6.3 s", both; where only a part of the run is shown: "4 of 12 lost here".
std::string verdict_of(const RunReport& account, const TopicLoss& loss, const std::map<std::string, Source>& sources,
                       bool is_whole) {
  if (!loss.has_loss()) {
    if (account.verdict == Verdict::recording) return "all there so far";
    const bool is_known = account.not_known.empty() &&
                          std::none_of(account.losses.begin(), account.losses.end(),
                                       [](const TopicLoss& one) { return one.topic.empty(); });
    return is_known ? "all there" : "all there as far as is known";
  }
  const std::uint64_t lost = loss.ticks() + loss.samples(), outages = loss.outages.number;
  std::uint64_t lost_here = 0, outages_here = 0;
  for (const auto& [origin, source] : sources) {
    for (const CurveGap& gap : source.gaps) {
      lost_here += gap.lost;
      outages_here += gap.lost == 0 ? 1 : 0;
    }
  }
  std::string text;
  const auto add = [&](const std::string& what) { text += (text.empty() ? "" : ", ") + what; };
  if (is_whole || (lost_here == lost && outages_here == outages)) {
    if (lost != 0) add(std::to_string(lost) + " lost");
    if (outages != 0) add(to_string(loss.outages));
    return text;
  }
  if (lost != 0) add(std::to_string(lost_here) + " of " + std::to_string(lost) + " lost");
  if (outages != 0) add(std::to_string(outages_here) + " of " + to_string(loss.outages));
  return text + " here";
}

/// "lost of room/climate in run 1: missed 4, failed 2"; none: nothing was.
void add_notes(std::vector<std::string>& notes, const RunReport& account, const TopicLoss& loss) {
  const std::string of = loss.topic + " in run " + std::to_string(account.info.run);
  std::string parts;
  for (const auto& [what, count] : {std::pair{"missed", loss.missed},
                                    {"failed", loss.failed},
                                    {"lost by the source", loss.by_source},
                                    {"unreadable", loss.unreadable},
                                    {"dropped by the queue", loss.dropped_newest + loss.dropped_oldest},
                                    {"refused on storing", loss.refused},
                                    {"not saved", loss.not_saved}})
    if (count != 0) parts += (parts.empty() ? "" : ", ") + std::string(what) + " " + std::to_string(count);
  if (loss.outages.number != 0) parts += (parts.empty() ? "" : ", ") + to_string(loss.outages);
  if (!parts.empty()) notes.push_back("lost of " + of + ": " + parts);
  const auto& blind = account.not_detectable;
  if (std::find(blind.begin(), blind.end(), loss.topic) != blind.end())
    notes.push_back("not detectable: what the source of " + loss.topic + " lost itself");
}

}  // namespace

std::vector<ChosenField> chosen_fields(const std::vector<std::string>& names,
                                       const std::vector<RecordedTopic>& topics) {
  std::vector<ChosenField> fields;
  std::set<std::string> all;
  for (const RecordedTopic& topic : topics) all.insert(topic.topic);
  if (names.empty()) refuse("nothing", "name a field, as TOPIC.FIELD, or a topic", "there is " + list_of(all));
  for (const std::string& name : names)
    for (ChosenField& field : chosen(name, topics))
      if (std::find(fields.begin(), fields.end(), field) == fields.end()) fields.push_back(std::move(field));
  return fields;
}

Plot curves_of(const Recording& recording, const RecordedRange& range, const std::vector<ChosenField>& fields,
               const std::optional<std::string>& origin, Duration step) {
  Plot plot;
  plot.title = recording.path() + ", run " + std::to_string(range.run.run) +
               (range.run.name.empty() ? "" : " \"" + range.run.name + "\"");
  plot.from = range.from;
  plot.until = range.until;
  plot.step = step;
  const RunReport account = account_of(recording, range.run.run).or_throw();
  std::map<std::string, std::map<std::string, std::vector<Curve>>> curves;  // by topic and path, one an origin
  for (const ChosenField& field : fields) {
    if (curves.contains(field.topic)) continue;
    std::vector<std::string> paths;
    for (const ChosenField& one : fields)
      if (one.topic == field.topic) paths.push_back(one.path);
    Reader reader(recording, range, field.topic, paths, origin, step);
    if (reader.sources().empty()) refuse_run(recording, range.run.run, field.topic, origin);
    const TopicLoss loss = loss_of(account, field.topic);
    const std::string verdict = verdict_of(account, loss, reader.sources(), range.is_whole);
    for (std::size_t i = 0; i < paths.size(); ++i) {
      for (auto& [name, source] : reader.sources()) {
        Curve& curve = curves[field.topic][paths[i]].emplace_back(std::move(source.curves[i]));
        if (reader.sources().size() > 1) curve.name += " of " + name;
        curve.gaps = source.gaps;
        curve.verdict = verdict;
        curve.has_loss = loss.has_loss();
      }
    }
    add_notes(plot.notes, account, loss);
  }
  for (const ChosenField& field : fields)
    for (Curve& curve : curves[field.topic][field.path]) plot.curves.push_back(std::move(curve));
  for (const std::string& what : account.not_known) plot.notes.push_back("not known: " + what);
  for (const TopicLoss& loss : account.losses)
    if (loss.topic.empty())
      plot.notes.push_back("not known: of which sensors, that had only begun, " + std::to_string(loss.not_saved) +
                           " lost events were");
  return plot;
}

}  // namespace rtdata::app
