// The part of verify that looks at what a recording is made of: versions, views and triggers.
#include <algorithm>
#include <set>

#include "sinks/sqlite/schema.hpp"
#include "sinks/sqlite/value_ranges.hpp"
#include "sinks/sqlite/verify_run.hpp"
#include "sinks/sqlite/verify_sums.hpp"

namespace rtdata::detail {

namespace {

/// Rows are hashed by position: that each value is under its name stands in the columns alone.
Result<void> check_columns_of(const RecordingFile& file, const RecordedTopic& topic,
                              std::vector<std::string>& problems) {
  auto columns = sqlite::columns_of(file.database, topic.table);
  if (!columns) return std::move(columns).error();
  std::vector<std::string> wanted{"run", "time", "origin", "sequence"};
  for (const Leaf& leaf : topic.description->leaves()) wanted.push_back(leaf.path);
  const std::set<std::string> there(columns->begin(), columns->end());
  const std::set<std::string> described(wanted.begin(), wanted.end());
  for (const std::string& column : *columns) {
    if (!described.contains(column))
      problems.push_back(topic.topic + ": the table has a column \"" + column + "\", which is none of the topic's.");
  }
  for (const std::string& column : wanted) {
    if (!there.contains(column)) problems.push_back(topic.topic + ": the table has no column \"" + column + "\".");
  }
  return {};
}

}  // namespace

Result<void> check_layout(const RecordingFile& file, std::int64_t version, const std::vector<RecordedTopic>& topics,
                          std::vector<std::string>& problems) {
  auto query = file.prepare("SELECT type, name FROM sqlite_schema ORDER BY name");
  if (!query) return std::move(query).error();
  std::set<std::string, std::less<>> views;
  for (;;) {
    auto row = query->step();
    if (!row) return std::move(row).error();
    if (!*row) break;
    const std::string_view type = query->text(0), name = query->text(1);
    if (type == "trigger") {
      problems.push_back("There is a trigger, " + std::string(name) +
                         ", which is not of the recording: it may change what is recorded.");
    } else if (type == "view") {
      views.emplace(name);
    } else if (type == "table" && name == "rtdata_checksum" && version < sqlite::first_version_with_checksums) {
      problems.push_back("The file says that its format is " + std::to_string(version) +
                         ", but it has checksums, as files from format " +
                         std::to_string(sqlite::first_version_with_checksums) + " on have.");
    }
  }
  for (const RecordedTopic& topic : topics)
    if (auto checked = check_columns_of(file, topic, problems); !checked) return checked;
  if (version < 1)
    problems.push_back("The file says that its format is " + std::to_string(version) + ": there is none.");
  if (version != sqlite::schema_version) return {};  // those of an older one come when it is recorded into
  std::vector<std::string> wanted{"rtdata_run_utc", "rtdata_gap~utc", "rtdata_health~utc", "rtdata_error~utc",
                                  "rtdata_field"};
  for (const RecordedTopic& topic : topics) wanted.push_back(topic.table + "~utc");
  for (const std::string& view : wanted) {
    if (!views.contains(view)) {
      problems.push_back("The view " + view + " is not there.");
    } else if (auto usable = file.prepare("SELECT * FROM " + sqlite::quoted(view)); !usable) {
      problems.push_back("The view " + view + " is damaged: " + usable.error().why + ".");
    }
  }
  return {};
}

void check_formats(const std::vector<RunReport>& runs, std::int64_t version, std::vector<std::string>& problems) {
  constexpr std::int64_t oldest = 3;  // those before are counted as it
  std::int64_t newest = oldest;
  for (const RunReport& run : runs) {
    const std::int64_t format = run.info.format;
    const std::string says = "Run " + std::to_string(run.info.run) + " says that its format is " +
                             std::to_string(format) + ", ";
    if (format < oldest || format > std::max(version, oldest)) {
      problems.push_back(says + "which is none of a file of format " + std::to_string(version) + ".");
    } else if (format < newest) {
      problems.push_back(says + "but a run before it has format " + std::to_string(newest) + ".");
    }
    newest = std::max(newest, format);
  }
}

void check_format(const Findings& found, const OfRun& of_run, const Checksums& checksums) {
  const std::int64_t format = found.report.info.format;
  const auto newer = [&](const char* what, std::int64_t since) {
    if (format < since) {
      found.problem("It says that its format is " + std::to_string(format) + ", but it has " + what +
                    ", as runs from format " + std::to_string(since) + " on have.");
    }
  };
  const auto has_lines = [run = found.report.info.run](const auto& by_table) {
    return std::any_of(by_table.begin(), by_table.end(), [run](const auto& one) { return one.second.contains(run); });
  };
  if (has_lines(checksums.values) || has_lines(checksums.accounts))
    newer("checksums", sqlite::first_version_with_checksums);
  const auto any_of_ledger = [&](auto is) { return std::any_of(of_run.ledger.begin(), of_run.ledger.end(), is); };
  if (any_of_ledger([](const LedgerEntry& entry) {
        const SensorCounts& s = entry.sensor;
        return s.is_one_a_read || s.lateness != 0 || s.unreadable != 0;
      }) ||
      std::any_of(of_run.schedule.begin(), of_run.schedule.end(),
                  [](const RecordedSegment& one) { return one.segment.late_after != Duration{0}; })) {
    newer("an account of reads and data apart", sqlite::first_version_of_own_data_account);
  }
  if (any_of_ledger([](const LedgerEntry& entry) { return entry.carried != 0; }))
    newer("an account of its own", sqlite::first_version_of_own_account);
}

}  // namespace rtdata::detail
