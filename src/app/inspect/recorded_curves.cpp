#include "app/inspect/recorded_curves.hpp"

#include <algorithm>
#include <iterator>
#include <map>
#include <set>
#include <utility>

#include "app/core/figures.hpp"
#include "app/inspect/course.hpp"
#include "app/inspect/curve_scale.hpp"
#include "app/inspect/names.hpp"
#include "rtdata/data/problem.hpp"
#include "rtdata/recording/verify.hpp"

namespace rtdata::app {

std::string reason_of(const RecordedGap& gap) { return gap_text(gap.kind, gap.reason); }

namespace {

/// The number in a Value.
Number number_of(const Value& value) {
  if (const auto* const whole = std::get_if<std::int64_t>(&value)) return *whole;
  if (const auto* const natural = std::get_if<std::uint64_t>(&value)) return *natural;
  return std::get<double>(value);
}

/// One origin on one topic.
struct Source {
  std::vector<std::vector<Curve>> curves;  // of each chosen field of that topic; several: its type changed
  std::vector<CurveGap> gaps;
  bool has_schedule = false;
  std::uint64_t held_back = 0, pruned = 0;  // on purpose; by a limit of the recording
  std::set<std::string> made_of;            // topics, also through others
  std::uint64_t last_sequence = 0;          // of the step before
  Time last_begin{};
};
using Sources = std::map<std::pair<std::string, std::string>, Source>;  // by topic and origin

/// The topics of which the events of an origin are made, also through others.
std::set<std::string> made_of(const LedgerEntry& origin, const std::vector<LedgerEntry>& ledger) {
  std::set<std::string> all;
  for (std::vector<std::string> next = origin.made_of; !next.empty();) {
    const std::string topic = std::move(next.back());
    next.pop_back();
    if (topic == origin.topic || !all.insert(topic).second) continue;
    for (const LedgerEntry& entry : ledger)
      if (entry.topic == topic) next.insert(next.end(), entry.made_of.begin(), entry.made_of.end());
  }
  return all;
}

/// The steps in which a run is read.
struct Sampling {
  Duration step{1};    ///< read from the recording
  Duration column{1};  ///< of the curves: the same, or several of these joined
  RowFilter::Times times = RowFilter::Times::utc;
};

class Reader {
 public:
  Reader(const Recording& recording, const RecordedRange& range, const std::vector<ChosenField>& fields,
         const std::optional<std::string>& origin, const Sampling& sampling)
      : range_(range), sampling_(sampling) {
    for (const ChosenField& field : fields) topics_[field.topic].paths.push_back(field.path);
    for (RecordedTopic& one : recording.topics().or_throw())
      if (const auto topic = topics_.find(one.topic); topic != topics_.end())
        topic->second.descriptions[one.version] = std::move(one);
    const std::vector<LedgerEntry> ledger = recording.ledger(range.run.run).or_throw();
    for (const LedgerEntry& entry : ledger) {
      if (!topics_.contains(entry.topic) || (origin && entry.origin != *origin)) continue;
      Source& of = source(entry.topic, entry.origin);
      of.has_schedule = entry.sensor.has_schedule;
      of.held_back = entry.sensor.filtered;
      of.pruned = entry.pruned;
      of.made_of = made_of(entry, ledger);
    }
    add_gaps_of_others(recording, ledger);
    RowFilter filter{.run = range.run.run, .origin = origin};
    if (topics_.size() == 1) filter.topic = topics_.begin()->first;
    if (sampling.times == RowFilter::Times::utc) {  // recorded steps cover the whole run
      filter.from = range.from;
      filter.until = range.until;
    }
    filter.gaps = RowFilter::Gaps::in_place;
    filter.times = sampling.times;
    auto rows = recording.steps(filter, sampling.step).or_throw();
    while (const RecordedRow* row = rows.next().or_throw())
      if (const auto topic = topics_.find(row->topic().topic); topic != topics_.end())
        row->gap() != nullptr ? add(*row->gap()) : add(*row, topic->second);
  }

  Sources& sources() { return sources_; }

 private:
  struct Topic {
    std::vector<std::string> paths;
    std::map<std::int64_t, RecordedTopic> descriptions;   // by version
    std::map<std::int64_t, std::vector<Figures>> places;  // of the paths, by version
  };

  Source& source(const std::string& topic, const std::string& origin) {
    const auto [known, is_new] = sources_.try_emplace({topic, origin});
    if (is_new) {
      const Topic& of = topics_.at(topic);
      for (const std::string& path : of.paths) {
        Curve curve;
        curve.name = topic + "." + path;
        curve.topic = topic;
        curve.origin = origin;
        curve.path = path;
        for (const auto& [version, one] : of.descriptions) {
          const Leaf* const leaf = one.description->find(path);
          if (leaf == nullptr) continue;
          curve.unit = leaf->unit;
          curve.kind = leaf->kind;
        }
        known->second.curves.push_back({std::move(curve)});
      }
    }
    return known->second;
  }

  CurveGap gap_of(const RecordedGap& gap, bool has_schedule) const {
    const bool is_joined = gap.kind == "joined";
    const bool has_count = gap.kind == "missed" || gap.kind == "failed" || (is_joined && has_schedule);
    return {range_.line.utc(gap.first), range_.line.utc(gap.last), has_count ? gap.count : 0, reason_of(gap)};
  }

  void add(const RecordedGap& gap) {
    Source& of = source(gap.topic, gap.origin);
    of.gaps.push_back(gap_of(gap, of.has_schedule));
  }

  /// What is missing of a topic is missing of those that are made of it, too.
  void add_gaps_of_others(const Recording& recording, const std::vector<LedgerEntry>& ledger) {
    const bool is_any_made = std::any_of(sources_.begin(), sources_.end(),
                                         [](const auto& one) { return !one.second.made_of.empty(); });
    if (!is_any_made) return;
    std::set<std::pair<std::string, std::string>> scheduled;
    for (const LedgerEntry& entry : ledger)
      if (entry.sensor.has_schedule) scheduled.emplace(entry.topic, entry.origin);
    for (const RecordedGap& gap : recording.gaps(range_.run.run).or_throw()) {
      CurveGap of_other = gap_of(gap, scheduled.contains({gap.topic, gap.origin}));
      if (of_other.last < range_.from || of_other.first >= range_.until) continue;
      of_other.reason += ", of " + gap.topic;
      for (auto& [name, source] : sources_)
        if (source.made_of.contains(gap.topic)) source.gaps.push_back(of_other);
    }
  }

  Time begin_of(const RecordedRow& row) const {
    const Time begin = row.header().time;
    return sampling_.times == RowFilter::Times::utc ? begin : range_.line.utc(begin);
  }

  /// Missing rows: sequences between two steps, or within one, without a row.
  void add_missing(Source& of, const RecordedRow& row, std::uint64_t events) {
    constexpr const char* not_stored = "not stored: dropped by the recording";
    const Time begin = begin_of(row);
    if (of.last_sequence != 0 && row.first_sequence() > of.last_sequence + 1) {
      const bool is_beside = begin - of.last_begin <= sampling_.step;
      of.gaps.push_back({is_beside ? begin : of.last_begin + sampling_.step, is_beside ? begin : begin - Duration{1},
                         row.first_sequence() - of.last_sequence - 1, not_stored});
    }
    const std::uint64_t span = row.last_sequence() - row.first_sequence() + 1;
    if (span > events) of.gaps.push_back({begin, begin, span - events, not_stored});
    of.last_sequence = row.last_sequence();
    of.last_begin = begin;
  }

  void add(const RecordedRow& row, Topic& topic) {
    Source& of = source(topic_name(row), std::string(row.header().origin));
    const EventView event = row.event();
    const std::uint64_t events = std::get<std::uint64_t>(event.value(event.description().leaves().front()));
    add_missing(of, row, events);
    const std::vector<Figures>& places = places_of(row, topic);
    for (std::size_t i = 0; i < places.size(); ++i) {
      const Figures& place = places[i];
      if (place.count == nullptr) continue;  // the description of this row does not have it
      CurveStep step{begin_of(row), events, std::get<std::uint64_t>(event.value(*place.count)), {}, {}, 0};
      if (step.numbers != 0) {
        step.least = number_of(event.value(*place.least));
        step.most = number_of(event.value(*place.most));
        step.mean = std::get<double>(event.value(*place.mean));
      }
      add(step, curve_of(of.curves[i], place));
    }
  }

  static const std::string& topic_name(const RecordedRow& row) { return row.topic().topic; }

  /// A panel has one type and one unit.
  static Curve& curve_of(std::vector<Curve>& curves, const Figures& place) {
    for (Curve& curve : curves)
      if (curve.kind == place.of->kind && curve.unit == place.of->unit) return curve;
    if (curves.back().steps.empty()) {
      curves.back().kind = place.of->kind;
      curves.back().unit = place.of->unit;
      return curves.back();
    }
    Curve curve;
    curve.name = curves.front().name + " as " + std::string(name_of(place.of->kind));
    curve.topic = curves.front().topic;
    curve.origin = curves.front().origin;
    curve.path = curves.front().path;
    curve.kind = place.of->kind;
    curve.unit = place.of->unit;
    return curves.emplace_back(std::move(curve));
  }

  std::int64_t column_of(Time time) const { return floor_of((time - range_.from).count(), sampling_.column.count()); }

  /// Adds it to its column.
  void add(const CurveStep& step, Curve& curve) const {
    if (step.numbers != 0) {
      if (!curve.least || step.least < curve.least->number) curve.least = {step.least, step.begin};
      if (!curve.most || curve.most->number < step.most) curve.most = {step.most, step.begin};
    }
    const bool is_joined = sampling_.column != sampling_.step && !curve.steps.empty() &&
                           column_of(curve.steps.back().begin) == column_of(step.begin);
    is_joined ? join(step, curve.steps.back()) : curve.steps.push_back(step);
  }

  /// The leaves of the paths.
  const std::vector<Figures>& places_of(const RecordedRow& row, Topic& topic) const {
    const auto [known, is_new] = topic.places.try_emplace(row.topic().version);
    if (!is_new) return known->second;
    known->second.resize(topic.paths.size());
    for (const Figures& one :
         figures_of(*row.topic().description, *topic.descriptions.at(row.topic().version).description)) {
      const auto path = std::find(topic.paths.begin(), topic.paths.end(), one.of->path);
      if (path != topic.paths.end()) known->second[static_cast<std::size_t>(path - topic.paths.begin())] = one;
    }
    return known->second;
  }

  const RecordedRange& range_;
  const Sampling sampling_;
  std::map<std::string, Topic> topics_;
  Sources sources_;
};

/// Throws the error of a run without data of the topic, or of that origin on it.
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
  const bool has_others = !origins.empty();
  std::string why = of_run + (has_others ? " has none of origin " + *origin : " has nothing of it");
  std::string advice = has_others     ? "available: " + list_of(origins)
                       : runs.empty() ? ""
                                      : "see --run: " + list_of(runs);
  throw SetupError({Errc::not_found, "cannot plot", topic, std::move(why), std::move(advice)});
}

// ---- the account

/// The losses of a topic in the run, then those of the topics of which it is made: what the recording dropped of these
/// came, and is in what was made of it.
std::vector<TopicLoss> losses_of(const RunReport& account, const std::string& topic,
                                 const std::set<std::string>& made) {
  std::vector<TopicLoss> losses(1);
  losses.front().topic = topic;
  for (TopicLoss one : account.losses) {
    if (one.topic == topic) losses.front() = one;
    if (!made.contains(one.topic)) continue;
    one.dropped_newest = one.dropped_oldest = one.refused = one.not_saved = 0;
    if (one.has_loss()) losses.push_back(std::move(one));
  }
  return losses;
}

/// "12 lost", "1 outage of 6.3 s", both; where only a part of the run is shown: "4 of 12 lost here". `there`: "all
/// there".
std::string loss_verdict_of(const RunReport& account, const TopicLoss& loss, const Sources& sources, bool is_whole,
                            const std::string& there) {
  if (!loss.has_loss()) {
    if (account.verdict == Verdict::recording) return there + " so far";
    const bool is_known = account.not_known.empty() &&
                          std::none_of(account.losses.begin(), account.losses.end(),
                                       [](const TopicLoss& one) { return one.topic.empty(); });
    return is_known ? there : there + " as far as is known";
  }
  const std::uint64_t lost = loss.ticks() + loss.samples(), outages = loss.outages.number;
  std::uint64_t lost_here = 0, outages_here = 0;
  for (const auto& [name, source] : sources) {
    if (name.first != loss.topic) continue;
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

/// The same, with the number of rows that are not there and no loss.
std::string verdict_of(const RunReport& account, const TopicLoss& loss, const Sources& sources, bool is_whole) {
  std::uint64_t held_back = 0, pruned = 0;
  for (const auto& [name, source] : sources) {
    if (name.first != loss.topic) continue;
    held_back += source.held_back;
    pruned += source.pruned;
  }
  const char* const there = pruned == 0 ? "all there" : "nothing lost";
  std::string text = loss_verdict_of(account, loss, sources, is_whole, there);
  if (pruned != 0) text += ", " + std::to_string(pruned) + " pruned";
  if (held_back != 0) text += ", " + std::to_string(held_back) + " held back";
  return text;
}

/// "lost of room/climate in run 1: missed 4, failed 2"; none: nothing was.
void add_notes(std::vector<std::string>& notes, const RunReport& account, const TopicLoss& loss) {
  const std::string of = loss.topic + " in run " + std::to_string(account.info.run);
  const auto add = [&](std::string note) {  // a topic may be itself in the picture, and several be made of it
    if (std::find(notes.begin(), notes.end(), note) == notes.end()) notes.push_back(std::move(note));
  };
  std::string parts;
  for (const auto& [what, count] : {std::pair{"missed", loss.missed},
                                    {"failed", loss.failed},
                                    {"of them unreadable", loss.failed_unreadable},
                                    {"lost by the source", loss.by_source},
                                    {"unreadable", loss.unreadable - loss.failed_unreadable},
                                    {"dropped by the queue", loss.dropped_newest + loss.dropped_oldest},
                                    {"refused on storing", loss.refused},
                                    {"not saved", loss.not_saved}})
    if (count != 0) parts += (parts.empty() ? "" : ", ") + std::string(what) + " " + std::to_string(count);
  if (loss.outages.number != 0) parts += (parts.empty() ? "" : ", ") + to_string(loss.outages);
  if (!parts.empty()) add("lost of " + of + ": " + parts);
  const auto& blind = account.not_detectable;
  if (std::find(blind.begin(), blind.end(), loss.topic) != blind.end())
    add("not detectable: what the source of " + loss.topic + " lost itself");
}

Plot empty_plot(const Recording& recording, const RecordedRange& range, Duration step) {
  Plot plot;
  plot.title = recording.path() + ", run " + std::to_string(range.run.run) +
               (range.run.name.empty() ? "" : " \"" + range.run.name + "\"");
  plot.from = range.from;
  plot.until = range.until;
  plot.step = step;
  return plot;
}

/// Adds the gaps and the verdict of the account to the curves of one topic.
void finish(Sources& sources, const std::string& topic, const RunReport& account, bool is_whole, Plot& plot) {
  const auto first = sources.lower_bound({topic, ""});
  const auto end = std::find_if(first, sources.end(), [&](const auto& one) { return one.first.first != topic; });
  const bool has_several = std::distance(first, end) > 1;
  std::set<std::string> made_of;
  for (auto source = first; source != end; ++source)
    made_of.insert(source->second.made_of.begin(), source->second.made_of.end());
  const std::vector<TopicLoss> losses = losses_of(account, topic, made_of);
  TopicLoss loss;
  loss.topic = topic;
  for (const TopicLoss& one : losses) loss.add(one);
  const std::string verdict = verdict_of(account, loss, sources, is_whole);
  for (auto source = first; source != end; ++source) {
    std::stable_sort(source->second.gaps.begin(), source->second.gaps.end(),
                     [](const CurveGap& a, const CurveGap& b) { return a.first < b.first; });
    for (auto& curves : source->second.curves) {
      for (Curve& curve : curves) {
        if (has_several) curve.name += " of " + curve.origin;
        curve.gaps = source->second.gaps;
        curve.verdict = verdict;
        curve.has_loss = loss.has_loss();
      }
    }
  }
  std::string others;
  for (const TopicLoss& one : losses) {
    add_notes(plot.notes, account, one);
    if (one.topic != topic) others += (others.empty() ? "" : ", ") + one.topic;
  }
  if (!others.empty())
    plot.notes.push_back(topic + " is made of " + others + ": what these lost is missing in it, too");
}

/// In the order of the fields. `index`: which of its topic a field is.
void take_curves(Sources& sources, const std::string& topic, std::size_t index, Plot& plot) {
  for (auto source = sources.lower_bound({topic, ""}); source != sources.end() && source->first.first == topic;
       ++source)
    for (Curve& curve : source->second.curves[index]) plot.curves.push_back(std::move(curve));
}

void add_unknown(const RunReport& account, Plot& plot) {
  for (const std::string& what : account.not_known) plot.notes.push_back("not known: " + what);
  for (const TopicLoss& loss : account.losses)
    if (loss.topic.empty())
      plot.notes.push_back("not known: the sensors, which had only begun, of " + std::to_string(loss.not_saved) +
                           " lost events");
}

}  // namespace

Plot curves_of(const Recording& recording, const RecordedRange& range, const std::vector<ChosenField>& fields,
               const std::optional<std::string>& origin, Duration step) {
  Plot plot = empty_plot(recording, range, step);
  const RunReport account = account_of(recording, range.run.run).or_throw();
  std::map<std::string, Sources> sources;       // by topic
  std::map<std::string, std::size_t> of_topic;  // fields that were taken
  for (const ChosenField& field : fields) {
    if (sources.contains(field.topic)) continue;
    std::vector<ChosenField> alike;
    std::copy_if(fields.begin(), fields.end(), std::back_inserter(alike),
                 [&](const ChosenField& one) { return one.topic == field.topic; });
    Reader reader(recording, range, alike, origin, {step, step, RowFilter::Times::utc});
    if (reader.sources().empty()) refuse_run(recording, range.run.run, field.topic, origin);
    finish(reader.sources(), field.topic, account, range.is_whole, plot);
    sources[field.topic] = std::move(reader.sources());
  }
  for (const ChosenField& field : fields) take_curves(sources[field.topic], field.topic, of_topic[field.topic]++, plot);
  add_unknown(account, plot);
  return plot;
}

std::vector<ChosenField> fields_of_run(const Recording& recording, const RunInfo& run) {
  std::set<std::string> topics;
  for (const LedgerEntry& entry : recording.ledger(run.run).or_throw()) topics.insert(entry.topic);
  std::vector<ChosenField> fields;
  for (const RecordedTopic& topic : recording.topics().or_throw()) {
    // A running or killed run may have topics that no account has yet.
    if (!topics.contains(topic.topic) && run.state == RunState::closed) continue;
    if (topic.topic.starts_with('$') || is_of_course(*topic.description)) continue;
    for (const Leaf& leaf : topic.description->leaves()) {
      ChosenField field{topic.topic, leaf.path};
      const bool is_known = topic.version > 1 && std::find(fields.begin(), fields.end(), field) != fields.end();
      if (is_number(leaf.kind) && !is_known) fields.push_back(std::move(field));
    }
  }
  return fields;
}

Plot curves_of_run(const Recording& recording, const RecordedRange& range, const RunReport& account,
                   std::size_t columns) {
  const std::vector<ChosenField> fields = fields_of_run(recording, range.run);
  constexpr std::size_t most_values = 150'000, least_columns = 120;
  columns = std::min(columns, std::max(most_values / std::max<std::size_t>(fields.size(), 1), least_columns));
  using namespace std::chrono_literals;
  const std::int64_t least = (range.until - range.from).count() / static_cast<std::int64_t>(columns) + 1;
  const auto sampling_of = [&](Duration step) {
    return Sampling{step, step * ((least + step.count() - 1) / step.count()), RowFilter::Times::recorded};
  };
  Sampling sampling;
  if (Duration{least} > 1min) {
    sampling = sampling_of(1min);
  } else if (Duration{least} > 1s) {
    sampling = sampling_of(1s);
  } else {
    sampling.step = sampling.column = distance_of_marks(Duration{least});
  }
  Plot plot = empty_plot(recording, range, sampling.column);
  plot.read_step = sampling.step;
  Reader reader(recording, range, fields, std::nullopt, sampling);
  std::set<std::string> topics;
  for (const auto& [name, source] : reader.sources()) topics.insert(name.first);
  for (const std::string& topic : topics) finish(reader.sources(), topic, account, true, plot);
  std::map<std::string, std::size_t> of_topic;  // fields that were taken
  for (const ChosenField& field : fields) take_curves(reader.sources(), field.topic, of_topic[field.topic]++, plot);
  add_unknown(account, plot);
  return plot;
}

}  // namespace rtdata::app
