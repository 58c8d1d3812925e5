// A verify report for people and for programs.
#include <algorithm>
#include <nlohmann/json.hpp>

#include "data/wrap.hpp"
#include "rtdata/sinks/verify.hpp"

namespace rtdata {
namespace {

using detail::wrap;

std::string times_of(const RunInfo& info) {
  std::string text = to_iso8601(info.started).substr(0, 19) + "Z";
  if (info.ended) text += " to " + to_iso8601(*info.ended).substr(0, 19) + "Z";
  return text;
}

std::string conclusion(Verdict verdict) {
  switch (verdict) {
    case Verdict::balanced:
      return "balanced: rows, gaps and schedule agree with the account.";
    case Verdict::sealed:
      return "sealed: a run was not closed, or a tier hung; what is there agrees with the account, and what is known "
             "of the rest is written down.";
    case Verdict::recording:
      return "recording: what is there agrees with the last account; look again when it is closed.";
    case Verdict::unsealed:
      return "not sealed: a run ended without closing, and what it lost is not written down yet.";
    default:
      return "not balanced: see above.";
  }
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
  json["origins"] = run.origins;
  json["rows"] = run.rows;
  json["values_checked"] = run.values_checked;
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
  json["gaps"] = run.gaps;
  json["outages"] = nlohmann::ordered_json::array();
  for (const OriginOutages& one : run.outages) json["outages"].push_back(json_of(one));
  json["lost_by_source"] = run.lost_by_source ? nlohmann::ordered_json(*run.lost_by_source) : nlohmann::ordered_json();
  json["problems"] = run.problems;
  json["more_problems"] = run.more_problems;
  json["notes"] = run.notes;
  return json;
}

}  // namespace

std::string VerifyReport::text() const {
  std::string out = path + "\n";
  for (const RunReport& run : runs) {
    out += "\nrun " + std::to_string(run.info.run) + (run.info.name.empty() ? "" : " \"" + run.info.name + "\"") +
           "  " + times_of(run.info) + "  " + std::string(name_of(run.verdict)) + "\n";
    const auto n = [](std::uint64_t value) { return std::to_string(value); };
    wrap(out, "  ",
         n(run.rows) + " rows of " + n(run.origins) + (run.origins == 1 ? " origin" : " origins") + "; " +
             n(run.offered) + " offered = " + n(run.stored) + " stored + " + n(run.dropped) + " dropped" +
             (run.unsaved != 0 ? " + " + n(run.unsaved) + " not saved" : "") +
             (run.pruned != 0 ? "; " + n(run.pruned) + " pruned" : ""));
    std::size_t gaps = run.gaps;
    for (const OriginOutages& one : run.outages) gaps -= std::min(gaps, one.gaps);
    if (run.scheduled != 0) {
      wrap(out, "  ",
           n(run.scheduled) + " ticks scheduled; " + n(run.missed) + " missed, " + n(run.failed) + " failed, " +
               n(run.late) + " late; " + n(gaps) + (gaps == 1 ? " gap" : " gaps"));
    }
    if (!run.outages.empty()) wrap(out, "  ", outages_text(run.outages));
    if (run.unreadable != 0)
      wrap(out, "  ", n(run.received) + " received, " + n(run.unreadable) + " of them unreadable");
    for (const std::string& problem : run.problems) wrap(out, "  ! ", problem);
    if (run.more_problems != 0) wrap(out, "  ! ", n(run.more_problems) + " more problems.");
    for (const std::string& note : run.notes) wrap(out, "  - ", note);
  }
  for (const std::string& problem : problems) wrap(out, "! ", problem);
  out += "\n";
  if (runs.empty() && problems.empty()) out += "No run was recorded yet.\n";
  wrap(out, "", conclusion(verdict()));
  if (verdict() == Verdict::balanced || verdict() == Verdict::sealed) {
    wrap(out, "", "This shows that the recording is consistent with itself; it does not prove that nobody forged it.");
  }
  return out;
}

std::string VerifyReport::to_json() const {
  nlohmann::ordered_json json;
  json["path"] = path;
  json["verdict"] = name_of(verdict());
  json["exit_code"] = exit_code();
  json["proves"] = "consistency, not that nobody forged it";
  json["problems"] = problems;
  json["runs"] = nlohmann::ordered_json::array();
  for (const RunReport& run : runs) json["runs"].push_back(json_of(run));
  return json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}

}  // namespace rtdata
