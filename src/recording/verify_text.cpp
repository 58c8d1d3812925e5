// A verify report as text and as JSON.
#include <algorithm>
#include <array>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "data/name_in.hpp"
#include "data/wrap.hpp"
#include "recording/account_text.hpp"
#include "recording/verify_run.hpp"
#include "rtdata/recording/verify.hpp"

namespace rtdata {
namespace {

using detail::plural;
using detail::wrap;

std::string times_of(const RunReport& run) {
  std::string text = to_iso8601(run.line.utc(run.info.started)).substr(0, 19) + "Z";
  if (run.info.ended) text += " to " + to_iso8601(run.line.utc(*run.info.ended)).substr(0, 19) + "Z";
  return text;
}

std::string conclusion(Verdict verdict) {
  constexpr std::string_view texts[] = {
      "balanced: rows, gaps and schedule agree with the account.",
      "sealed: it was not closed, or a tier hung; its rows agree with the account, and the known losses are written "
      "down.",
      "recording: its rows agree with the last account; verify it again when it is closed.",
      "not sealed: it ended without closing, and its losses are not written down yet.", "not balanced: see above."};
  return std::string(detail::name_in(texts, verdict));
}

/// "1 outage of 6.3 s without a schedule: board on lab/board".
std::string outages_text(const std::vector<OriginOutages>& all) {
  constexpr std::size_t most = 5;
  Outages sum;
  std::string names;
  for (std::size_t i = 0; i < all.size(); ++i) {
    sum.add(all[i].outages);
    if (i >= most) continue;
    names += (i == 0 ? "" : ", ") + all[i].origin;
    if (all[i].origin != all[i].topic) names += " on " + all[i].topic;
    if (all.size() > 1) names += " (" + to_string(all[i].outages) + ")";
  }
  if (all.size() > most) names += " and " + std::to_string(all.size() - most) + " more";
  return to_string(sum) + ", in which nothing came that could be recorded: " + names;
}

nlohmann::ordered_json json_of(const TopicLoss& loss) {
  return {{"topic", loss.topic},
          {"samples", loss.samples()},
          {"lost_by_source", loss.by_source},
          {"unreadable", loss.unreadable},
          {"dropped_newest", loss.dropped_newest},
          {"dropped_oldest", loss.dropped_oldest},
          {"refused", loss.refused},
          {"not_saved", loss.not_saved},
          {"ticks", loss.ticks()},
          {"missed", loss.missed},
          {"failed", loss.failed},
          {"failed_unreadable", loss.failed_unreadable},
          {"outages", loss.outages.number},
          {"outage_time_ns", loss.outages.time.count()},
          {"made_of_it", loss.made_of_it}};
}

nlohmann::ordered_json json_of(const std::vector<TopicLoss>& losses) {
  auto json = nlohmann::ordered_json::array();
  for (const TopicLoss& loss : losses) json.push_back(json_of(loss));
  return json;
}

nlohmann::ordered_json json_of(const OriginOutages& of) {
  return {{"topic", of.topic},
          {"origin", of.origin},
          {"number", of.outages.number},
          {"time_ns", of.outages.time.count()},
          {"is_at_most", of.outages.is_at_most}};
}

nlohmann::ordered_json json_of(const RunReport& run) {
  nlohmann::ordered_json json;
  json["run"] = run.info.run;
  json["name"] = run.info.name;
  json["verdict"] = name_of(run.verdict);
  json["state"] = name_of(run.info.state);
  json["started"] = to_nanoseconds(run.info.started);
  json["ended"] = run.info.ended ? nlohmann::ordered_json(to_nanoseconds(*run.info.ended)) : nlohmann::ordered_json();
  json["started_utc"] = to_iso8601(run.line.utc(run.info.started));
  json["ended_utc"] = run.info.ended ? nlohmann::ordered_json(to_iso8601(run.line.utc(*run.info.ended)))
                                     : nlohmann::ordered_json();
  json["origins"] = run.origins;
  json["rows"] = run.rows;
  json["values_checked"] = run.values_checked;
  json["checksum"] = run.checksum_text();
  json["offered"] = run.offered;
  json["stored"] = run.stored;
  json["dropped"] = run.dropped;
  json["not_saved"] = run.unsaved;
  json["pruned"] = run.pruned;
  json["scheduled"] = run.scheduled;
  json["missed"] = run.missed;
  json["failed"] = run.failed;
  json["late"] = run.late;
  json["received"] = run.received;
  json["unreadable"] = run.unreadable;
  json["first_lines"] = run.first_lines;
  json["gaps"] = run.gaps;
  json["outages"] = nlohmann::ordered_json::array();
  for (const OriginOutages& one : run.outages) json["outages"].push_back(json_of(one));
  json["nothing_lost"] = !run.losses.empty()     ? nlohmann::ordered_json(false)
                         : run.not_known.empty() ? nlohmann::ordered_json(true)
                                                 : nlohmann::ordered_json();
  json["losses"] = json_of(run.losses);
  json["lines"] = run.lines;
  json["not_known"] = run.not_known;
  json["not_detectable"] = run.not_detectable;
  json["mute"] = run.mute;
  json["lost_by_source"] = run.lost_by_source ? nlohmann::ordered_json(*run.lost_by_source) : nlohmann::ordered_json();
  json["problems"] = run.problems;
  json["more_problems"] = run.more_problems;
  json["notes"] = run.notes;
  return json;
}

nlohmann::ordered_json json_of(const DeletedReport& deleted) {
  return {{"runs", deleted.runs.runs},
          {"first_run", deleted.runs.first_run},
          {"last_run", deleted.runs.last_run},
          {"started", to_nanoseconds(deleted.runs.started)},
          {"ended", to_nanoseconds(deleted.runs.ended)},
          {"not_closed", deleted.runs.sealed},
          {"offered", deleted.offered},
          {"stored", deleted.stored},
          {"dropped", deleted.dropped},
          {"not_saved", deleted.unsaved},
          {"losses", json_of(deleted.losses)},
          {"not_known", deleted.not_known},
          {"not_detectable", deleted.not_detectable}};
}

}  // namespace

std::string RunReport::checksum_text() const {
  std::array<char, 17> text{};
  std::snprintf(text.data(), text.size(), "%016llx", static_cast<unsigned long long>(checksum));
  return text.data();
}

std::string VerifyReport::text() const {
  std::string out = path + "\n";
  if (deleted) {
    const DeletedRuns& of = deleted->runs;
    const auto n = [](std::uint64_t value) { return std::to_string(value); };
    out += "\n";
    wrap(out, "",
         plural(of.runs, "run") + " from run " + std::to_string(of.first_run) + " to " + std::to_string(of.last_run) +
             ", " + to_iso8601(of.started).substr(0, 19) + "Z to " + to_iso8601(of.ended).substr(0, 19) +
             "Z, deleted by a limit or by `rtdata rm`; " + n(deleted->offered) + " offered = " + n(deleted->stored) +
             " stored and pruned + " + n(deleted->dropped) + " dropped" +
             (deleted->unsaved != 0 ? " + " + n(deleted->unsaved) + " not saved" : ""));
    detail::add_lines(out, detail::loss_lines(deleted->losses, deleted->not_known, deleted->not_detectable));
  }
  for (const RunReport& run : runs) {
    out += "\nrun " + std::to_string(run.info.run) + (run.info.name.empty() ? "" : " \"" + run.info.name + "\"") +
           "  " + times_of(run) + "  " + std::string(name_of(run.verdict)) + "\n";
    const auto n = [](std::uint64_t value) { return std::to_string(value); };
    detail::add_lines(out, run.lines);
    wrap(out, "  ",
         n(run.rows) + " rows of " + n(run.origins) + (run.origins == 1 ? " origin" : " origins") + "; " +
             n(run.offered) + " offered = " + n(run.stored) + " stored + " + n(run.dropped) + " dropped" +
             (run.unsaved != 0 ? " + " + n(run.unsaved) + " not saved" : "") +
             (run.pruned != 0 ? "; " + n(run.pruned) + " pruned" : ""));
    const std::string gaps = plural(run.gaps, "gap");
    if (run.scheduled != 0) {
      wrap(out, "  ",
           n(run.scheduled) + " ticks scheduled; " + n(run.missed) + " missed, " + n(run.failed) + " failed, " +
               n(run.late) + " late; " + gaps);
    }
    if (!run.outages.empty()) wrap(out, "  ", (run.scheduled == 0 ? gaps + ": " : "") + outages_text(run.outages));
    if (run.unreadable != 0)
      wrap(out, "  ", n(run.received) + " received, " + n(run.unreadable) + " of them unreadable");
    for (const auto& [topic, count] : run.first_lines)
      wrap(out, "  ",
           plural(count, "first line") + " of " + topic + " discarded: the port was opened in the middle of a line");
    for (const std::string& problem : run.problems) wrap(out, "  ! ", problem);
    if (run.more_problems != 0) wrap(out, "  ! ", n(run.more_problems) + " more problems.");
    for (const std::string& note : run.notes) wrap(out, "  - ", note);
  }
  if (!unsent.empty()) out += "\n";
  for (const auto& [sink, count] : unsent)
    wrap(out, "LOST: ",
         plural(count, "event") + " that `max_bytes`, `max_age` or `rtdata rm` deleted before the peer of sink " +
             sink + " had them");
  for (const std::string& problem : problems) wrap(out, "! ", problem);
  out += "\n";
  if (runs.empty() && problems.empty()) out += deleted ? "No run is left.\n" : "No run was recorded yet.\n";
  const auto is_bad = [](const RunReport& run) { return run.verdict >= Verdict::unsealed; };
  const Verdict newest = !problems.empty() ? Verdict::not_balanced : runs.empty() ? verdict() : runs.back().verdict;
  wrap(out, runs.size() > 1 ? "run " + std::to_string(runs.back().info.run) + ": " : "", conclusion(newest));
  if (const auto bad = std::find_if(runs.begin(), runs.end(), is_bad);
      newest < Verdict::unsealed && bad != runs.end()) {
    wrap(out, "",
         "But run " + std::to_string(bad->info.run) + " is " + std::string(name_of(bad->verdict)) +
             ": see above. So the status is 1; `--run` looks at one run.");
  }
  if (newest == Verdict::balanced || newest == Verdict::sealed) {
    wrap(out, "", "This shows that the recording is consistent with itself; it does not prove that it was not forged.");
  }
  return out;
}

std::string VerifyReport::to_json() const {
  nlohmann::ordered_json json;
  json["path"] = path;
  json["verdict"] = name_of(verdict());
  json["exit_code"] = exit_code();
  json["proves"] = "consistency, not that it was not forged";
  json["problems"] = problems;
  json["deleted_runs"] = deleted ? json_of(*deleted) : nlohmann::ordered_json();
  json["unsent"] = unsent;
  json["runs"] = nlohmann::ordered_json::array();
  for (const RunReport& run : runs) json["runs"].push_back(json_of(run));
  return json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}

}  // namespace rtdata
