#include "recording/verify_steps.hpp"

#include <algorithm>

#include "recording/topic_table.hpp"

namespace rtdata::detail {

using sqlite::step_columns;
using sqlite::step_lengths;

namespace {

// Columns of a table of steps.
enum StepColumn { time_of_step = 1, origin_of_step, events_of_step, first_of_step, last_of_step };

}  // namespace

StepCheck::StepCheck(const RecordingFile& file, const RecordedTopic& topic, RunsRows& runs,
                     std::vector<std::string>& problems)
    : file_(file), topic_(topic), runs_(runs), problems_(problems) {
  fields_ = sqlite::step_fields(sqlite::leaves_in_order(file.database, topic.table, *topic.description));
  std::array<std::vector<std::string>, step_lengths.size()> columns;
  for (std::size_t i = 0; i < step_lengths.size(); ++i) {
    const std::string table = sqlite::step_table(topic.table, step_lengths[i]);
    if (sqlite::has_table(file.database, table)) columns[i] = sqlite::columns_of(file.database, table);
    // A later run may have had more fields than a table of steps takes: it has none, and the columns of the earlier.
    if (fields_.size() > sqlite::most_step_fields && !columns[i].empty())
      fields_.resize((columns[i].size() - std::min(columns[i].size(), step_columns.size())) / sqlite::figures.size());
  }
  for (std::size_t i = 0; i < step_lengths.size(); ++i) {
    const std::string table = sqlite::step_table(topic.table, step_lengths[i]);
    if (!columns[i].empty()) tables_[i] = has_columns(columns[i], table) ? Table::there : Table::other;
  }
  auto of_topic = sqlite::columns_of(file.database, topic.table);
  for (const sqlite::StepField& field : fields_) {
    const auto at = std::find(of_topic.begin(), of_topic.end(), field.leaf->path);
    columns_.push_back(static_cast<int>(at - of_topic.begin()));
  }
}

bool StepCheck::has_columns(const std::vector<std::string>& columns, const std::string& table) {
  std::vector<std::string> wanted(step_columns.begin(), step_columns.end());
  for (const sqlite::StepField& field : fields_)
    for (const std::string_view figure : sqlite::figures) wanted.push_back(field.leaf->path + std::string(figure));
  if (columns == wanted) return true;
  problems_.push_back(table + ": the table has other columns than those of steps of " + topic_.topic + ".");
  return false;
}

void StepCheck::add(sqlite3_stmt* row, int first, const OriginRows& rows) {
  if (&rows != last_rows_ || rows.run != run_) {
    last_ = &origin_of(rows);
    last_rows_ = &rows;
  }
  Origin& origin = *last_;
  if (!origin.has_steps) return;
  const std::int64_t time = sqlite3_column_int64(row, first + 1);
  const auto sequence = static_cast<std::uint64_t>(sqlite3_column_int64(row, first + 3));
  if (origin.first == 0) origin.first = sequence;
  origin.made.go_to(time, fields_,
                    [&](std::size_t length, const sqlite::Step& made) { compare(origin, length, made); });
  sqlite::Step& step = origin.made.second;
  step.add_event(sequence);
  for (std::size_t i = 0; i < fields_.size(); ++i) {
    const int column = first + columns_[i];
    const int type = sqlite3_column_type(row, column);
    if (type != SQLITE_INTEGER && type != SQLITE_FLOAT) continue;  // NULL, or NaN
    switch (fields_[i].type) {
      case sqlite::StepField::Type::real:
        step.add(i, sqlite3_column_double(row, column));
        break;
      case sqlite::StepField::Type::natural:
        step.add(i, static_cast<std::uint64_t>(sqlite3_column_int64(row, column)));
        break;
      default:
        step.add(i, std::int64_t{sqlite3_column_int64(row, column)});
        break;
    }
  }
}

StepCheck::Origin& StepCheck::origin_of(const OriginRows& rows) {
  if (rows.run != run_) end_run();
  run_ = rows.run;
  const auto [found, is_new] = origins_.try_emplace(rows.origin, fields_.size());
  Origin& origin = found->second;
  if (!is_new) return origin;
  origin.name = rows.origin;
  origin.line = rows.line;
  seen_.emplace(run_, rows.origin);
  for (std::size_t i = 0; i < step_lengths.size(); ++i) {
    Stored& stored = origin.stored[i];
    stored.from = rows.steps_from[i];
    origin.has_steps = origin.has_steps || stored.from != 0 || tables_[i] == Table::there;
    if (tables_[i] != Table::there) continue;
    stored.steps = file_.prepare("SELECT * FROM " + sqlite::quoted(sqlite::step_table(topic_.table, step_lengths[i])) +
                                 " WHERE run = ? AND origin = ? ORDER BY time");
    stored.steps.bind(1, run_).bind(2, std::string_view(origin.name));
    advance(stored);
  }
  return origin;
}

void StepCheck::advance(Stored& stored) { stored.has_row = stored.steps.step(); }

void StepCheck::compare(Origin& origin, std::size_t length, const sqlite::Step& made) {
  Stored& stored = origin.stored[length];
  if (tables_[length] == Table::other) return;
  for (; stored.has_row && stored.steps.integer(time_of_step) < made.time; advance(stored))
    tell(origin, length, stored.steps.integer(time_of_step), "is there, and none of its rows is");
  const bool is_wanted = stored.from != 0 && made.last >= stored.from;
  if (!stored.has_row || stored.steps.integer(time_of_step) > made.time) {
    if (is_wanted) tell(origin, length, made.time, "is not there");
    return;
  }
  sqlite3_stmt* const row = stored.steps.raw();
  hash_.begin();
  for (int column = time_of_step; column < sqlite3_column_count(row); ++column)
    if (column != sqlite::step_checksum_column) hash_.column(row, column);
  const std::uint64_t found = hash_.hash_of_values();
  const auto number = [&](int column) { return static_cast<std::uint64_t>(stored.steps.integer(column)); };
  bool is_same = sqlite3_column_type(row, sqlite::step_checksum_column) == SQLITE_INTEGER &&
                 number(sqlite::step_checksum_column) == found;
  if (made.first == origin.first && number(first_of_step) < made.first) {  // its first rows were pruned
    const std::uint64_t pruned = number(events_of_step) - made.events;
    is_same = is_same && number(last_of_step) == made.last && pruned - 1 < made.first - number(first_of_step);
  } else {
    is_same = is_same && found == made.hash(origin.name, fields_, hash_);
  }
  if (!is_wanted) {
    tell(origin, length, made.time, "is there, before the origin has steps");
  } else if (!is_same) {
    tell(origin, length, made.time, "does not agree with its rows: it was changed, or they were");
  }
  advance(stored);
}

void StepCheck::end_run() {
  for (auto& [name, origin] : origins_) {
    origin.made.end(fields_,
                    [&, of = &origin](std::size_t length, const sqlite::Step& made) { compare(*of, length, made); });
    for (std::size_t length = 0; length < step_lengths.size(); ++length) {
      Stored& stored = origin.stored[length];
      for (; stored.has_row; advance(stored))
        tell(origin, length, stored.steps.integer(time_of_step), "is there, and none of its rows is");
    }
  }
  origins_.clear();
}

void StepCheck::end() {
  end_run();
  for (std::size_t length = 0; length < step_lengths.size(); ++length)
    if (tables_[length] == Table::there) tell_others(length);
}

void StepCheck::tell_others(std::size_t length) {
  const std::string table = sqlite::step_table(topic_.table, step_lengths[length]);
  auto steps = file_.prepare("SELECT run, origin, typeof(origin), count(*) FROM " + sqlite::quoted(table) +
                             " GROUP BY run, origin");
  while (steps.step()) {
    const std::string origin(steps.text(1));
    if (steps.text(2) == "text" && seen_.contains({steps.integer(0), origin})) continue;
    problems_.push_back(table + ": " + plural(static_cast<std::uint64_t>(steps.integer(3)), "step") + " of run " +
                        std::to_string(steps.integer(0)) + ", origin " + origin +
                        (steps.integer(3) == 1 ? " is" : " are") + " there, and none of the rows is.");
  }
}

void StepCheck::tell(const Origin& origin, std::size_t length, std::int64_t time, const char* what) {
  RunRows& run = runs_[run_];
  if (run.changed.size() == Findings::most_sentences) {
    ++run.more_changed;
    return;
  }
  const Time at = from_nanoseconds(time);
  run.changed.push_back(sqlite::step_table(topic_.table, step_lengths[length]) + ": the step at " +
                        to_iso8601(origin.line != nullptr ? origin.line->utc(at) : at) + ", origin " + origin.name +
                        ", " + what + ".");
}

}  // namespace rtdata::detail
