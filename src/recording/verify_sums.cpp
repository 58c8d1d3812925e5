#include "recording/verify_sums.hpp"

#include <algorithm>

#include "recording/account_sums.hpp"
#include "recording/schema.hpp"

namespace rtdata::detail {

void ValueSums::add(sqlite3_stmt* row, int first, RunsRows& runs) {
  const int fields = first + sqlite::columns_before_fields, checksum = fields - 1, end = sqlite3_column_count(row);
  hash_.begin();
  for (int column = first; column < checksum; ++column) hash_.column(row, column);
  for (int column = fields; column < end; ++column) hash_.column(row, column);
  found_.add(hash_.hash_of_values());
  const int type = sqlite3_column_type(row, checksum);
  if (type == SQLITE_NULL) return;
  if (const auto run = runs.find(sqlite3_column_int64(row, first)); run != runs.end()) {
    run->second.sum += found_.sum;
    if (type == SQLITE_INTEGER && static_cast<std::uint64_t>(sqlite3_column_int64(row, checksum)) == found_.sum) {
      run->second.checked += found_.rows;
    } else {
      tell_changed(row, first, run->second);
    }
  }
  found_ = {};
}

void ValueSums::tell_changed(sqlite3_stmt* row, int first, RunRows& run) const {
  if (run.changed.size() == Findings::most_sentences) {
    ++run.more_changed;
    return;
  }
  std::string origin = "?";
  if (sqlite3_column_type(row, first + 2) == SQLITE_TEXT) {
    origin.assign(static_cast<const char*>(sqlite3_column_blob(row, first + 2)),
                  static_cast<std::size_t>(sqlite3_column_bytes(row, first + 2)));
  }
  run.changed.push_back(table_ + ": the checksum of " + plural(found_.rows, "row") + " up to sequence " +
                        std::to_string(sqlite3_column_int64(row, first + 3)) + " of origin " + origin +
                        " is not the same as when they were written: a value was changed, or a row added or deleted.");
}

bool check_account_sums(const RecordingFile& file, const std::vector<RecordedTopic>& topics, VerifyReport& report) {
  sqlite::AccountSums found;
  for (const std::string_view table : sqlite::account_tables) {
    auto rows = file.prepare("SELECT * FROM " + std::string(table));
    found.run(rows);
  }
  auto newest = file.database.integer("SELECT max(last_run) FROM rtdata_deleted");
  for (const RunReport& run : report.runs) newest = std::max(newest, run.info.run);
  for (const RecordedTopic& topic : topics) {
    found.add_topic(file.database, topic.table);
    if (topic.first_run > newest)
      report.problems.push_back(topic.topic + ": it came with run " + std::to_string(topic.first_run) +
                                ", which is newer than all that are there.");
  }
  for (const std::string_view table : sqlite::sender_tables) {
    auto rows = file.prepare("SELECT -1, * FROM " + std::string(table));
    found.run(rows);
  }
  auto lines = file.prepare(
      "SELECT run, \"checksum~\" FROM rtdata_run UNION ALL SELECT 0, sum FROM rtdata_checksum UNION ALL SELECT -1, "
      "senders FROM rtdata_checksum");
  std::map<std::int64_t, std::optional<std::uint64_t>> said;  // by run; none: no number, or several
  while (lines.step()) {
    const auto [sum, is_new] = said.try_emplace(lines.integer(0));
    sum->second.reset();
    if (is_new && sqlite3_column_type(lines.raw(), 1) == SQLITE_INTEGER)
      sum->second = static_cast<std::uint64_t>(lines.integer(1));
  }
  const auto agrees = [&](std::int64_t run) {
    const auto there = found.changes().find(run);
    const auto of_run = said.find(run);
    return of_run != said.end() && of_run->second == (there != found.changes().end() ? there->second : 0);
  };
  const bool are_topics_changed = !agrees(sqlite::all_runs);
  if (!agrees(sqlite::of_senders))
    report.problems.emplace_back(
        "The checksum of the senders' rows (in rtdata_checksum) does not match: a row of "
        "rtdata_refused, rtdata_refused_before or rtdata_unsent was changed, added or deleted.");
  for (RunReport& run : report.runs) {
    const auto there = found.changes().find(run.info.run);
    run.checksum = there != found.changes().end() ? there->second : 0;
    if (!agrees(run.info.run))
      run.problems.emplace_back(
          "The checksum of its account (in rtdata_run) does not match: a row of the tables of the "
          "account was changed, added or deleted.");
  }
  for (const auto& [run, sum] : found.changes()) {
    const bool is_there = run == sqlite::all_runs || run == sqlite::of_senders ||
                          std::any_of(report.runs.begin(), report.runs.end(),
                                      [number = run](const RunReport& one) { return one.info.run == number; });
    if (!is_there)
      report.problems.push_back("The account has rows of run " + std::to_string(run) +
                                ", which is not in the list of runs.");
  }
  return are_topics_changed;
}

}  // namespace rtdata::detail
