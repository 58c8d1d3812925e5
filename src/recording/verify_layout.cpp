// The part of verify that checks columns, views and triggers of a recording.
#include <algorithm>
#include <map>
#include <set>

#include "recording/database.hpp"
#include "recording/recording_file.hpp"
#include "recording/schema.hpp"
#include "recording/utc_line.hpp"
#include "recording/verify_run.hpp"

namespace rtdata::detail {

namespace {

/// Rows are hashed by position, so only the columns show the name of each value. A run with more fields adds columns at
/// the end, wherever the fields are; otherwise sets `is_changed`.
void check_columns_of(const RecordingFile& file, const RecordedTopic& topic, bool is_changed,
                      std::vector<std::string>& problems) {
  auto columns = sqlite::columns_of(file.database, topic.table);
  std::vector<std::string> wanted{"run", "time", "origin", "sequence", sqlite::checksum_column};
  for (const Leaf& leaf : topic.description->leaves()) wanted.push_back(leaf.path);
  const std::set<std::string> there(columns.begin(), columns.end());
  const std::set<std::string> described(wanted.begin(), wanted.end());
  for (const std::string& column : columns) {
    if (!described.contains(column))
      problems.push_back(topic.topic + ": the table has a column \"" + column + "\", which is not one of the topic's.");
  }
  for (const std::string& column : wanted) {
    if (!there.contains(column)) problems.push_back(topic.topic + ": the table has no column \"" + column + "\".");
  }
  if (there != described || columns.size() != wanted.size()) return;
  for (std::size_t i = 0; is_changed && i < wanted.size(); ++i) {
    if (columns[i] == wanted[i]) continue;
    problems.push_back(topic.topic + ": column " + std::to_string(i + 1) + " of the table is \"" + columns[i] +
                       "\", where \"" + wanted[i] + "\" was recorded: names of columns were exchanged.");
    break;
  }
}

/// Checks senders' positions: the tables and runs exist, and a position is not beyond the rows of a closed run.
void check_positions(const RecordingFile& file, std::vector<std::string>& problems) {
  auto query = file.prepare(
      "SELECT p.sink, p.table_name, p.run, p.origin, p.sequence FROM rtdata_position p "
      "LEFT JOIN rtdata_topic t ON t.table_name = p.table_name LEFT JOIN rtdata_run r ON r.run = p.run "
      "WHERE p.table_name <> '' AND (t.topic IS NULL OR p.run > max((SELECT coalesce(max(run), 0) FROM rtdata_run), "
      "(SELECT coalesce(max(last_run), 0) FROM rtdata_deleted)) OR "
      "(r.state = 'closed' AND NOT EXISTS(SELECT 1 FROM rtdata_ledger l WHERE l.run = p.run AND l.topic = t.topic AND "
      "l.origin = p.origin AND l.last_sequence >= p.sequence)))");
  while (query.step()) {
    problems.push_back("rtdata_position: sink " + std::string(query.text(0)) + " has table \"" +
                       std::string(query.text(1)) + "\" up to sequence " + std::to_string(query.integer(4)) +
                       " of origin " + std::string(query.text(3)) + " in run " + std::to_string(query.integer(2)) +
                       ", which was never recorded.");
  }
}

}  // namespace

void check_layout(const RecordingFile& file, const std::vector<RecordedTopic>& topics, bool are_topics_changed,
                  std::vector<std::string>& problems) {
  auto query = file.prepare("SELECT type, name, sql FROM sqlite_schema ORDER BY name");
  std::map<std::string, std::string, std::less<>> views;  // and their SQL
  while (query.step()) {
    const std::string_view type = query.text(0), name = query.text(1);
    if (type == "trigger") {
      problems.push_back("There is a trigger, " + std::string(name) +
                         ", which does not belong to the recording: it may change what is recorded.");
    } else if (type == "view") {
      views.emplace(name, query.text(2));
    }
  }
  const std::size_t before = problems.size();
  for (const RecordedTopic& topic : topics) check_columns_of(file, topic, are_topics_changed, problems);
  if (are_topics_changed && problems.size() == before)
    problems.push_back("rtdata_topic: the checksum of its " + plural(topics.size(), "row") +
                       " is not the same as when they were written: a row was changed, added or deleted.");
  const bool are_columns_right = problems.size() == before;  // otherwise SQLite may have changed the views with them
  check_positions(file, problems);
  std::vector<sqlite::View> wanted = sqlite::account_views();
  for (const RecordedTopic& topic : topics) wanted.push_back(sqlite::utc_view(topic.table, *topic.description));
  for (const sqlite::View& view : wanted) {
    const auto there = views.find(view.name);
    if (there == views.end()) {
      problems.push_back("The view " + view.name + " is not there.");
      continue;
    }
    try {
      (void)file.prepare("SELECT * FROM " + sqlite::quoted(view.name));
      if (there->second != view.sql && are_columns_right)
        problems.push_back("The view " + view.name + " differs from that of a recording.");
    } catch (const SetupError& error) {
      problems.push_back("The view " + view.name + " is damaged: " + error.error().why + ".");
    }
  }
}

}  // namespace rtdata::detail
