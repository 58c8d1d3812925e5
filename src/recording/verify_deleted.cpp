// The part of verify that checks the totals of deleted runs.
#include <algorithm>
#include <map>
#include <set>

#include "recording/account_text.hpp"
#include "recording/verify_run.hpp"

namespace rtdata::detail {

TopicLoss loss_of(const LedgerEntry& entry, const Outages& outages) {
  const SensorCounts& of = entry.sensor;
  return {entry.topic,
          of.missed,
          of.failed,
          of.unreadable,
          of.lost,
          entry.dropped_newest,
          entry.dropped_oldest,
          entry.dropped_refused,
          entry.dropped_unsaved,
          outages,
          {},
          failed_unreadable(of)};
}

void verify_deleted(DeletedRuns runs, VerifyReport& report) {
  if (runs.runs == 0 && runs.origins.empty()) return;
  if (runs.runs == 0) report.problems.push_back("rtdata_deleted: the row of the runs themselves is not there.");
  DeletedReport& deleted = report.deleted.emplace();
  std::map<std::string, TopicLoss> by_topic;
  std::set<std::string> not_detectable;
  for (const DeletedOrigin& of : runs.origins) {
    const LedgerEntry& account = of.account;
    deleted.offered += account.offered;
    deleted.stored += account.stored;
    deleted.dropped += account.dropped() - account.dropped_unsaved;
    deleted.unsaved += account.dropped_unsaved;
    if (account.offered != account.stored + account.dropped() || account.stored != account.pruned ||
        account.offered > account.sensor.published) {
      report.problems.push_back("rtdata_deleted: " + place_of(account.topic, account.origin) + ": " +
                                std::to_string(account.sensor.published) + " published, " +
                                std::to_string(account.offered) + " offered, " + std::to_string(account.stored) +
                                " stored, " + std::to_string(account.dropped()) + " dropped and " +
                                std::to_string(account.pruned) + " pruned do not agree.");
    }
    if (!account.sensor.lost_is_known) not_detectable.insert(account.topic);
    TopicLoss loss = loss_of(account, of.outages);
    if (!loss.has_loss()) continue;
    const auto [known, is_new] = by_topic.try_emplace(account.topic, std::move(loss));
    if (!is_new) known->second.add(loss_of(account, of.outages));
  }
  for (auto& [topic, loss] : by_topic) deleted.losses.push_back(std::move(loss));
  if (runs.unsaved != 0) deleted.losses.emplace_back().not_saved = runs.unsaved;
  most_first(deleted.losses);
  deleted.not_detectable.assign(not_detectable.begin(), not_detectable.end());
  if (runs.sealed != 0) {
    deleted.not_known.push_back("what " + plural(runs.sealed, "run") +
                                " that were deleted missed or lost at their end: they were not closed");
  }
  deleted.runs = std::move(runs);
}

void check_run_numbers(VerifyReport& report) {
  const DeletedRuns none, &deleted = report.deleted ? report.deleted->runs : none;
  const std::int64_t first_deleted = std::max<std::int64_t>(deleted.first_run, 1), last_deleted = deleted.last_run;
  std::uint64_t missing = 0;  // of those from the first to the last that was deleted
  std::size_t told = 0;
  const auto tell = [&](std::int64_t first, std::int64_t last) {
    if (first > last || told++ >= Findings::most_sentences) return;
    const std::string runs = first == last ? "Run " + std::to_string(first) + " is"
                                           : "Runs " + std::to_string(first) + " to " + std::to_string(last) + " are";
    report.problems.push_back(runs + " not there, and not among the runs that rtdata_deleted counts.");
  };
  const auto miss = [&](std::int64_t first, std::int64_t last) {
    if (first > last) return;
    if (deleted.runs == 0 || first > last_deleted || last < first_deleted) return tell(first, last);
    tell(first, first_deleted - 1);
    missing += static_cast<std::uint64_t>(std::min(last, last_deleted) - std::max(first, first_deleted)) + 1;
    if (last > last_deleted) tell(last_deleted + 1, last);
  };
  std::int64_t newest = 0;
  for (const RunReport& run : report.runs) {
    if (run.info.run <= newest) continue;
    miss(newest + 1, run.info.run - 1);
    newest = run.info.run;
  }
  if (deleted.runs == 0) return;
  if (newest < last_deleted) miss(newest + 1, last_deleted);
  if (missing == deleted.runs) return;
  report.problems.push_back("rtdata_deleted counts " + plural(deleted.runs, "run") + " from " +
                            std::to_string(first_deleted) + " to " + std::to_string(last_deleted) + ", of which " +
                            plural(missing, "run") + (missing == 1 ? " is" : " are") + " not there.");
}

}  // namespace rtdata::detail
