#include "recording/verify_run.hpp"

#include <algorithm>
#include <array>
#include <set>

#include "recording/account_text.hpp"
#include "recording/recorded_outages.hpp"
#include "recording/recording_file.hpp"

namespace rtdata::detail {
namespace {

std::string number(std::uint64_t value) { return std::to_string(value); }

/// The missing sequences, at most a few: "sequence 417 is missing".
std::string missing_text(const LedgerEntry& entry, const OriginRows& rows) {
  std::vector<OriginRows::Hole> holes;
  std::uint64_t count = rows.missing;
  const bool has_rows = rows.rows + rows.rows_after != 0;
  if (has_rows && entry.pruned == 0 && entry.first_sequence != 0 && rows.first_sequence > entry.first_sequence) {
    holes.push_back({entry.first_sequence, rows.first_sequence - 1});
    count += rows.first_sequence - entry.first_sequence;
  }
  std::uint64_t listed = 0;
  holes.insert(holes.end(), rows.holes.begin(), rows.holes.end());
  if (has_rows && entry.last_sequence > rows.last_sequence) {
    holes.push_back({rows.last_sequence + 1, entry.last_sequence});
    count += entry.last_sequence - rows.last_sequence;
  }
  if (!has_rows && entry.last_sequence != 0) {
    holes.push_back({entry.first_sequence, entry.last_sequence});
    count += entry.last_sequence - entry.first_sequence + 1;
  }
  if (holes.empty()) return "";
  std::string text = holes.size() == 1 && holes[0].first == holes[0].last ? "sequence " : "sequences ";
  for (std::size_t i = 0; i < holes.size(); ++i) {
    if (i != 0) text += i + 1 == holes.size() ? " and " : ", ";
    text += number(holes[i].first);
    if (holes[i].last != holes[i].first) text += " to " + number(holes[i].last);
    listed += holes[i].last - holes[i].first + 1;
  }
  if (count > listed) text += " and " + number(count - listed) + " more";
  return text + (count == 1 ? " is missing" : " are missing");
}

void check_lateness(const Findings& found, const std::string& place, const SensorCounts& s, const TickCheck& ticks) {
  const auto lateness = ticks.lateness();
  if (!lateness) return;
  if (lateness->late != s.late)
    found.problem(place + plural(lateness->late, "late row") + ", the ledger says " + number(s.late) + " were late.");
  if (lateness->sum != s.lateness) {
    found.problem(place + "its rows are late by " + number(lateness->sum) + " ns in all, the ledger says " +
                  number(s.lateness) + " ns: a gap, or rows, are not where they were.");
  }
}

void check_rows(const Findings& found, const LedgerEntry& entry, const OriginRows& rows) {
  const std::string place = place_of(entry.topic, entry.origin) + ": ";
  const std::uint64_t expected = entry.stored - entry.pruned;
  if (entry.pruned > entry.stored) {
    found.problem(place + "the ledger says " + number(entry.pruned) + " pruned of only " + number(entry.stored) +
                  " stored.");
  }
  for (const std::string& sentence : rows.sentences) found.problem(place + sentence + ".");
  if (rows.not_ascending + rows.times_back > rows.sentences.size()) {
    found.problem(place + number(rows.not_ascending + rows.times_back - rows.sentences.size()) +
                  " more rows are out of order.");
  }
  for (const std::string& sentence : rows.early_sentences) found.note(place + sentence + ".");
  for (const std::string& sentence : rows.outside_sentences) {
    // An origin with times of its own (a GPS receiver) may be outside.
    entry.sensor.has_schedule ? found.problem(place + sentence + ".") : found.note(place + sentence + ".");
  }
  if (rows.outside > rows.outside_sentences.size()) {
    found.note(place + number(rows.outside - rows.outside_sentences.size()) + " more times lie outside of the run.");
  }
  if (rows.ticks) {
    for (const std::string& sentence : rows.ticks->sentences()) found.problem(place + sentence + ".");
    if (rows.ticks->more() != 0)
      found.problem(place + plural(rows.ticks->more(), "more row") + " or gaps do not agree with the schedule.");
    check_lateness(found, place, entry.sensor, *rows.ticks);
  }
  if (rows.rows_after != 0) {
    found.note(place + plural(rows.rows_after, "row") + " came after the last account and cannot be checked.");
  }

  const std::string missing = missing_text(entry, rows);
  const std::string which = missing.empty() ? "" : "; " + missing;
  const bool is_beyond = rows.rows_after == 0 && rows.rows != 0 && rows.last_sequence > entry.last_sequence;
  if (rows.rows != expected) {
    std::string text = place + plural(rows.rows, "row") + ", the ledger says " + number(entry.stored) + " stored";
    if (entry.pruned != 0) text += " and " + number(entry.pruned) + " pruned again";
    if (entry.dropped() != 0 && !missing.empty()) text += " and " + number(entry.dropped()) + " dropped";
    text += which;
    if (is_beyond)
      text += "; sequence " + number(rows.last_sequence) + " was never offered, the last was " +
              number(entry.last_sequence);
    found.problem(text + ".");
  } else if (is_beyond) {
    found.problem(place + "its last sequence is " + number(rows.last_sequence) + ", the ledger says " +
                  number(entry.last_sequence) + which + ".");
  } else if (rows.rows != 0 && rows.first_sequence < entry.first_sequence) {
    found.problem(place + "its first sequence is " + number(rows.first_sequence) + ", the ledger says " +
                  number(entry.first_sequence) + which + ".");
  } else if (found.is_exact || found.report.info.state == RunState::sealed) {
    const std::uint64_t span = entry.last_sequence == 0 ? 0 : entry.last_sequence - entry.first_sequence + 1;
    const std::uint64_t absent = span - std::min(span, rows.rows);
    std::uint64_t explained = entry.dropped() + entry.pruned;
    // Uncommitted rows at the end may be beyond the account's last sequence.
    if (!found.is_exact && span == entry.offered - entry.dropped_unsaved) explained -= entry.dropped_unsaved;
    if (absent < explained || (absent > explained && is_account_known(found.report.info))) {
      found.problem(place + plural(absent, "sequence") + " of " + number(entry.first_sequence) + " to " +
                    number(entry.last_sequence) + (absent == 1 ? " is" : " are") + " not there, the ledger says " +
                    number(entry.dropped()) + " dropped" +
                    (entry.pruned != 0 ? " and " + number(entry.pruned) + " pruned" : "") + which + ".");
    } else if (absent > explained) {
      found.note(place + number(absent - explained) + " were dropped after the last account" + which + ".");
    }
  } else if (rows.missing > entry.dropped() + entry.pruned) {
    found.problem(place + "the ledger says " + number(entry.dropped()) + " dropped" + which + ".");
  }
}

/// One equation of the ledger.
struct Term {
  const char* name;
  std::uint64_t value;
};
void check_sum(const Findings& found, const std::string& place, Term whole, std::initializer_list<Term> parts) {
  std::uint64_t sum = 0;
  std::string names, values;
  for (const Term& part : parts) {
    sum += part.value;
    names += (names.empty() ? "" : " + ") + std::string(part.name);
    values += (values.empty() ? "" : " + ") + number(part.value);
  }
  if (sum == whole.value) return;
  found.inexact(place + whole.name + " is " + number(whole.value) + ", but " + names + " is " + values + " = " +
                number(sum) + ".");
}

void check_account(const Findings& found, const LedgerEntry& entry) {
  const std::string place = place_of(entry.topic, entry.origin) + ": ";
  const SensorCounts& s = entry.sensor;
  if (s.has_schedule) {
    const Term scheduled = entry.carried == 0 ? Term{"scheduled", s.scheduled}
                                              : Term{"scheduled + carried", s.scheduled + entry.carried};
    check_sum(found, place, scheduled,
              {{"taken", s.taken}, {"missed", s.missed}, {"failed", s.failed}, {"in flight", s.in_flight}});
    if (s.in_flight > 1)
      found.inexact(place + number(s.in_flight) + " reads are in flight, but at most one is possible.");
    if (s.late > s.taken) found.inexact(place + number(s.late) + " were late of only " + number(s.taken) + " taken.");
  } else if ((s.scheduled | s.taken | s.missed | s.failed | s.in_flight | s.late) != 0) {
    found.problem(place + "it has no schedule, but reads are counted.");
  }
  check_sum(
      found, place, {"received", s.received},
      {{"published", s.published}, {"repeated", s.repeated}, {"filtered", s.filtered}, {"unreadable", s.unreadable}});
  if (entry.carried > 1) {
    found.problem(place + number(entry.carried) + " reads were under way when it began, but at most one is possible.");
  }
  if (s.published != entry.offered) {
    found.inexact(place + number(s.published) + " published, but " + number(entry.offered) +
                  " offered to the recording.");
  }
  const Term dropped{"dropped", entry.dropped()}, stored{"stored", entry.stored};
  if (found.is_exact || found.report.info.state == RunState::sealed) {
    check_sum(Findings{found.report, true, found.open}, place, {"offered", entry.offered}, {stored, dropped});
  } else if (entry.offered > entry.stored + entry.dropped()) {
    found.note(place + number(entry.offered - entry.stored - entry.dropped()) + " of " + number(entry.offered) +
               " offered were still queued at the last account.");
  }
  const std::uint64_t span = entry.last_sequence == 0 ? 0 : entry.last_sequence - entry.first_sequence + 1;
  if (span != entry.offered) {
    found.inexact(place + number(entry.offered) + " offered, but sequences " + number(entry.first_sequence) + " to " +
                  number(entry.last_sequence) + " are " + number(span) + ".");
  }
}

void check_schedule(const Findings& found, const LedgerEntry& entry,
                    const std::vector<const RecordedSegment*>& segments) {
  const std::string place = place_of(entry.topic, entry.origin) + ": ";
  std::uint64_t sum = 0;
  const Segment* before = nullptr;
  for (const RecordedSegment* recorded : segments) {
    const Segment& segment = recorded->segment;
    const std::string since = "the schedule since " + found.utc(segment.first_due);
    sum += segment.scheduled;
    if (segment.period.count() <= 0) {
      found.problem(place + since + " has no period.");
    } else if (segment.computed() != segment.scheduled) {
      found.inexact(place + since + " has " + plural(segment.scheduled, "tick") + ", but every " +
                    to_string(segment.period) + " up to " + found.utc(segment.end) + " makes " +
                    number(segment.computed()) + ".");
    }
    if (before != nullptr && segment.first_due < before->end) {
      found.problem(place + since + " overlaps the one before, which ended at " + found.utc(before->end) + ".");
    }
    before = &segment;
  }
  if (sum != entry.sensor.scheduled) {
    found.inexact(place + "the schedule has " + plural(sum, "tick") + ", the ledger says " +
                  number(entry.sensor.scheduled) + " scheduled.");
  }
}

/// True if a gap before the schedule is the failure of the read that was under way when the recording began, with the
/// failures right after it.
bool is_of_carried(const LedgerEntry& entry, const RecordedGap& gap, const std::vector<const RecordedGap*>& gaps,
                   const std::vector<const RecordedSegment*>& segments) {
  if (entry.carried == 0 || &gap != gaps.front() || gap.kind != "failed") return false;
  if (segments.empty() || gap.last < segments.front()->segment.first_due)
    return gap.count == 1 && gap.first == gap.last;
  Segment after = segments.front()->segment;
  const bool is_one_schedule = after.period.count() > 0 && (after.first_due - gap.first) % after.period == Duration{0};
  after.end = gap.last;
  return is_one_schedule && gap.count <= after.computed() + 1;
}

void check_gap_without_schedule(const Findings& found, const std::string& which, const RecordedGap& gap) {
  if (gap.kind != "disconnected" && gap.kind != "silent" && gap.kind != "joined") {
    found.problem(which + " is neither disconnected nor silent nor joined.");
  } else if ((gap.count > 1) != (gap.kind == "joined") || gap.count == 1) {
    found.problem(which + " has a count of " + number(gap.count) + ".");
  }
  if (gap.last < gap.first) found.problem(which + " ends at " + found.utc(gap.last) + ".");
}

void check_gaps(const Findings& found, const LedgerEntry& entry, const std::vector<const RecordedSegment*>& segments,
                const std::vector<const RecordedGap*>& gaps) {
  const std::string place = place_of(entry.topic, entry.origin) + ": ";
  std::uint64_t missed = 0, failed = 0, joined = 0;
  for (const RecordedGap* gap : gaps) {
    const std::string which = "the gap of " + found.utc(gap->first) + " (" + gap->kind + ", " + gap->reason + ")";
    if (!entry.sensor.has_schedule) {
      check_gap_without_schedule(found, place + which, *gap);
      continue;
    }
    if (gap->kind == "missed") {
      missed += gap->count;
    } else if (gap->kind == "failed") {
      failed += gap->count;
    } else if (gap->kind == "joined") {
      joined += gap->count;
    } else {
      found.problem(place + which + " has an unknown kind: a gap is missed, failed or joined.");
    }
    if (gap->count == 0 || gap->last < gap->first) {
      found.problem(place + which + " has " + plural(gap->count, "tick") + " and ends at " + found.utc(gap->last) +
                    ".");
      continue;
    }
    const auto after = std::upper_bound(
        segments.begin(), segments.end(), gap->first,
        [](Time time, const RecordedSegment* s) { return time < s->segment.first_due; });
    if (after == segments.begin()) {
      if (is_of_carried(entry, *gap, gaps, segments)) continue;
      found.inexact(place + which + " lies before the schedule.");
      continue;
    }
    const Segment& segment = (*std::prev(after))->segment;
    if (segment.period.count() <= 0) continue;
    const std::uint64_t ticks = static_cast<std::uint64_t>((gap->last - gap->first) / segment.period) + 1;
    if ((gap->first - segment.first_due) % segment.period != Duration{0}) {
      found.problem(place + which + " does not begin at a tick of its schedule.");
    } else if (gap->count > ticks) {
      found.problem(place + which + " has " + plural(gap->count, "tick") + ", up to " + found.utc(gap->last) +
                    " there are " + number(ticks) + ".");
    } else if (gap->count < ticks && gap->kind != "joined") {
      found.problem(place + which + " has " + number(gap->count) + " of the " + plural(ticks, "tick") + " up to " +
                    found.utc(gap->last) + ".");
    }
  }
  const SensorCounts& s = entry.sensor;
  const auto compare = [&](std::uint64_t in_gaps, std::uint64_t counted, const char* kind) {
    if (in_gaps == counted) return;
    const std::string text = place + "the gaps have " + number(in_gaps) + " " + kind + ", the ledger says " +
                             number(counted) + ".";
    if (in_gaps > counted) return found.inexact(text);
    if (found.is_exact) {
      found.problem(text);
    } else {
      found.note(place + number(counted - in_gaps) + " " + kind +
                 " are in no gap: one was under way at the last account.");
    }
  };
  if (s.has_schedule && joined != 0) {
    if (missed > s.missed) compare(missed, s.missed, "missed");
    if (failed > s.failed) compare(failed, s.failed, "failed");
    compare(missed + failed + joined, s.missed + s.failed, "missed or failed");
  } else if (s.has_schedule) {
    compare(missed, s.missed, "missed");
    compare(failed, s.failed, "failed");
  } else if (missed != 0 || failed > s.failed) {
    found.inexact(place + "the gaps have " + number(missed) + " missed and " + number(failed) +
                  " failed, the ledger says " + number(s.failed) + " failed.");
  }
}

void add_up(RunReport& report, const LedgerEntry& entry) {
  ++report.origins;
  report.offered += entry.offered;
  report.stored += entry.stored;
  report.dropped += entry.dropped() - entry.dropped_unsaved;
  report.unsaved += entry.dropped_unsaved;
  report.pruned += entry.pruned;
  report.scheduled += entry.sensor.scheduled;
  report.missed += entry.sensor.missed;
  report.failed += entry.sensor.failed;
  report.late += entry.sensor.late;
  report.received += entry.sensor.received;
  report.unreadable += entry.sensor.unreadable;
  if (entry.sensor.first_lines != 0) report.first_lines[entry.topic] += entry.sensor.first_lines;
  if (entry.sensor.lost_is_known) report.lost_by_source = report.lost_by_source.value_or(0) + entry.sensor.lost;
}

/// Fills the report from the account alone, without the rows: everything except `rows`, problems and notes, and
/// `not_known` and `lines`, which follow at the end.
void read_account(const OfRun& of_run, RunReport& report) {
  const RunInfo& info = report.info;
  report.verdict = info.state == RunState::closed       ? Verdict::balanced
                   : info.state == RunState::sealed     ? Verdict::sealed
                   : of_run.recorder == Recorder::there ? Verdict::recording
                                                        : Verdict::unsealed;
  report.gaps = of_run.gaps.size();
  std::map<std::string, TopicLoss> by_topic;
  std::set<std::string> not_detectable;
  const auto unrecorded = made_of_unrecorded(of_run.ledger);
  for (const LedgerEntry& entry : of_run.ledger) {
    add_up(report, entry);
    const auto& gaps = of_run.gaps_in(origin_key(entry.topic, entry.origin));
    const SensorCounts& s = entry.sensor;
    const Outages outages = s.has_schedule ? Outages{} : outages_of(gaps);
    // Of a topic that is not recorded itself, `filtered` has the events.
    const bool has_event = s.published + entry.offered != 0 || (s.filtered != 0 && unrecorded.contains(entry.topic));
    if (!has_event && !entry.topic.starts_with('$')) report.mute.push_back(entry.origin);
    if (outages.number != 0) report.outages.push_back({entry.topic, entry.origin, outages, gaps.size()});
    if (!s.has_schedule && !s.lost_is_known && s.published + s.repeated + s.filtered != 0)
      not_detectable.insert(entry.topic);
    TopicLoss loss = loss_of(entry, outages);
    if (!loss.has_loss()) continue;
    const auto [known, is_new] = by_topic.try_emplace(entry.topic, loss);
    if (!is_new) known->second.add(loss);
  }
  std::stable_sort(report.outages.begin(), report.outages.end(),
                   [](const auto& a, const auto& b) { return a.outages.time > b.outages.time; });
  for (auto& [topic, loss] : by_topic) {
    if (const auto made = unrecorded.find(topic); made != unrecorded.end()) loss.made_of_it = made->second;
    report.losses.push_back(std::move(loss));
  }
  report.not_detectable.assign(not_detectable.begin(), not_detectable.end());
  if (info.state == RunState::sealed && info.lost && *info.lost > report.unsaved)
    report.losses.emplace_back().not_saved = *info.lost - report.unsaved;
  most_first(report.losses);
}

/// Notes the known facts about the end of a run that was not closed.
void note_end(const Findings& found, Recorder recorder) {
  const RunInfo& info = found.report.info;
  if (!info.remark.empty()) found.note(info.remark);
  if (info.state == RunState::sealed) {
    found.note(info.lost ? "It ended without closing: " + plural(*info.lost, "event") +
                               " that were published could not be stored."
                         : "Its account is not complete: its losses are not known.");
    // Losses of sensors that had just started are in no ledger; they are counted separately.
    if (info.lost && *info.lost > found.report.unsaved) {
      found.note(plural(*info.lost - found.report.unsaved, "event") + " of " + number(*info.lost) +
                 " lost were of sensors that had only begun, whose names are unknown.");
    } else if (info.lost && *info.lost != found.report.unsaved) {
      found.problem("The run says " + number(*info.lost) + " lost, its ledger says " + number(found.report.unsaved) +
                    " not saved.");
    }
  } else if (info.state == RunState::recording) {
    const std::string up_to = info.ended ? " up to the last account, " + found.utc(*info.ended) : "";
    const std::string process = "Process " + std::to_string(info.pid);
    if (recorder == Recorder::there) {
      found.note(process + " is still recording: this holds" + up_to + ", and is approximate.");
    } else if (recorder == Recorder::of_another_file) {
      found.note(process +
                 " records this run into another file, of which this is a copy without its WAL file (-wal): it holds" +
                 up_to + ", without the content of that file. Copy the two together, or with sqlite3: .backup");
    } else {
      found.note("It ended without closing and is not sealed: this holds" + up_to +
                 ". `rtdata seal`, or the next recording into the file, seals it and reports the losses.");
    }
  }
}

}  // namespace

void verify_run(const OfRun& of_run, const RunRows& run_rows, RunReport& report) {
  const OriginMap& rows = run_rows.origins;
  const RunInfo& info = report.info;
  std::vector<std::string> left_open;
  const Findings found{report, info.state == RunState::closed, left_open};
  read_account(of_run, report);
  std::unordered_map<std::string, bool> has_account;
  for (const LedgerEntry& entry : of_run.ledger) {
    const std::string key = origin_key(entry.topic, entry.origin);
    has_account[key] = true;
    check_rows(found, entry, rows.at(key));
    check_account(found, entry);
    const auto& segments = of_run.segments(key);
    if (entry.sensor.has_schedule || !segments.empty()) check_schedule(found, entry, segments);
    check_gaps(found, entry, segments, of_run.gaps_in(key));
  }
  std::vector<std::string> unaccounted;
  for (const auto& [key, origin] : rows) {
    report.rows += origin.rows + origin.rows_after;
    if (!has_account.contains(key)) {
      unaccounted.push_back(place_of(origin.topic, origin.origin) + ": " +
                            plural(origin.rows + origin.rows_after, "row") + ", but the ledger does not know it.");
    }
  }
  std::sort(unaccounted.begin(), unaccounted.end());
  for (std::string& sentence : unaccounted) {
    info.state == RunState::recording ? found.note(sentence + " It began after the last account.")
                                      : found.problem(sentence);
  }
  const auto strays = [&](const auto& of, const char* what) {
    std::vector<std::string> sentences;
    for (const auto& [key, list] : of) {
      if (!list.empty() && !has_account.contains(key)) {
        sentences.push_back(place_of(list.front()->topic, list.front()->origin) + ": " + plural(list.size(), what) +
                            ", but the ledger does not know it.");
      }
    }
    std::sort(sentences.begin(), sentences.end());
    for (std::string& sentence : sentences) found.problem(std::move(sentence));
  };
  strays(of_run.segments_of, "segment");
  strays(of_run.gaps_of, "gap");
  report.values_checked = run_rows.checked;
  report.checksum += run_rows.sum;
  for (const std::string& sentence : run_rows.changed) found.problem(sentence);
  report.more_problems += run_rows.more_changed;
  if (info.state == RunState::closed && !info.ended) found.problem("The run is closed, but its end is not recorded.");
  note_end(found, of_run.recorder);
  if (!left_open.empty()) {
    found.note(
        "Its last account is older than its end, since the power was cut, or it could not be written any more. "
        "Later counts are checked only against limits; this loses no row. " +
        plural(left_open.size(), "equation") + " left open, for example " + left_open.front());
  }
  if (!report.problems.empty()) report.verdict = Verdict::not_balanced;
  report.has_open_equations = !left_open.empty();
}

std::map<std::string, std::vector<std::string>> made_of_unrecorded(const std::vector<LedgerEntry>& ledger) {
  std::map<std::string, std::set<std::string>> made_of_it;
  std::map<std::string, std::uint64_t> offered, not_taken;
  for (const LedgerEntry& entry : ledger) {
    offered[entry.topic] += entry.offered;
    not_taken[entry.topic] += entry.sensor.filtered;
    for (const std::string& source : entry.made_of) made_of_it[source].insert(entry.topic);
  }
  std::map<std::string, std::vector<std::string>> unrecorded;
  for (const auto& [source, direct] : made_of_it) {
    if (offered[source] != 0 || not_taken[source] == 0) continue;  // recorded, or it had no event
    std::set<std::string> all(direct);
    for (std::vector<std::string> next(direct.begin(), direct.end()); !next.empty();) {
      const auto further = made_of_it.find(next.back());
      next.pop_back();
      if (further == made_of_it.end()) continue;
      for (const std::string& topic : further->second)
        if (all.insert(topic).second) next.push_back(topic);
    }
    for (const std::string& topic : all)
      if (topic != source && (offered[topic] != 0 || !made_of_it.contains(topic))) unrecorded[source].push_back(topic);
  }
  return unrecorded;
}

RunReport account_of_run(const Recording& recording, const RunInfo& info) {
  auto of_run = OfRun::load(recording, info.run);
  of_run.recorder = recorder_of(info, *recording.file());
  RunReport report;
  report.info = info;
  report.line = of_run.line;
  read_account(of_run, report);
  for (const LedgerEntry& entry : of_run.ledger) report.rows += entry.stored - entry.pruned;
  finish_account(recording, of_run, report);
  return report;
}

/// A tier that hung when its program was killed: the missed ticks of its sensors were not counted.
static void add_hanging(const std::vector<RecordedHealth>& health, RunReport& run) {
  std::map<std::string, const RecordedHealth*> last;
  for (const RecordedHealth& one : health)
    if (one.kind == "tier") last[one.name] = &one;
  for (const auto& [name, one] : last)
    if (one->state == "faulted")
      run.not_known.push_back("what the sensors of tier " + name + " lost from " +
                              to_iso8601(run.line.utc(std::max(one->time, one->last))) +
                              " on: it hung, and the program was ended");
}

void finish_account(const Recording& recording, const OfRun& of_run, RunReport& report) {
  const RunInfo& info = report.info;
  if (report.verdict == Verdict::not_balanced)
    report.not_known.emplace_back("what it lost besides, since it does not agree with its account (! below)");
  if (info.state == RunState::recording) {
    report.not_known.emplace_back(
        of_run.recorder == Recorder::there ? "what it loses after its last account: it is being recorded"
        : of_run.recorder == Recorder::of_another_file
            ? "what it lost after its last account: this is a copy, made while it was recorded"
            : "what it lost after its last account: it is not sealed yet; `rtdata seal` seals it");
  } else if (info.state == RunState::sealed && !info.lost) {
    report.not_known.emplace_back("what it lost at its end, since its account is not complete");
  } else if (info.state == RunState::sealed && report.has_open_equations) {
    report.not_known.emplace_back("which ticks it missed after its last account");
  }
  if (info.state == RunState::sealed) {
    auto health = recording.health(info.run).or_throw();
    add_hanging(health, report);
  }
  report.lines = account_lines(report);
}

}  // namespace rtdata::detail
