#include "sinks/sqlite/verify_sums.hpp"

#include <algorithm>

#include "sinks/sqlite/verify_run.hpp"

namespace rtdata::detail {

void RangeCheck::add(sqlite3_stmt* row, std::uint64_t sequence, sqlite::RowHash& hash) {
  if (current_ == ranges.size() || sequence < ranges[current_].first_sequence ||
      sequence > ranges[current_].last_sequence) [[unlikely]] {
    // Sequences ascend, or something is wrong anyway.
    const auto at = std::lower_bound(ranges.begin(), ranges.end(), sequence,
                                     [](const Range& range, std::uint64_t s) { return range.last_sequence < s; });
    current_ = static_cast<std::size_t>(at - ranges.begin());
    if (at == ranges.end() || sequence < at->first_sequence) {
      if (outside++ == 0) first_outside = sequence;
      return;
    }
  }
  Range& range = ranges[current_];
  if (range.found.rows == 0) range.first_found = sequence;
  range.last_found = sequence;
  if (range.is_known) {
    const int end = sqlite3_column_count(row);
    const int hashed = std::clamp(range.columns + 1, 2, end);
    range.found.add(sqlite::hash_of(hash, row, 2, hashed));
    for (int column = hashed; column < end; ++column) {
      if (sqlite3_column_type(row, column) == SQLITE_NULL) continue;
      ++beyond;
      break;
    }
  } else {
    ++range.found.rows;
  }
}

Result<Checksums> Checksums::load(const RecordingFile& file) {
  Checksums checksums;
  auto query = file.prepare(
      "SELECT run, table_name, origin, first_sequence, last_sequence, columns, rows, sum FROM rtdata_checksum");
  if (!query) return std::move(query).error();
  for (;;) {
    auto row = query->step();
    if (!row) return std::move(row).error();
    if (!*row) break;
    const std::int64_t run = query->integer(0);
    const bool has_texts = sqlite3_column_type(query->raw(), 1) == SQLITE_TEXT &&
                           sqlite3_column_type(query->raw(), 2) == SQLITE_TEXT;  // reading makes them texts
    const std::string table(query->text(1)), origin(query->text(2));
    const bool is_known = !query->is_null(7);
    const sqlite::RowSum said{static_cast<std::uint64_t>(query->integer(6)),
                              static_cast<std::uint64_t>(query->integer(7))};
    const int columns = static_cast<int>(query->integer(5));
    for (const int column : {0, 3, 4, 5, 6, 7}) {
      const int type = sqlite3_column_type(query->raw(), column);
      if (type != SQLITE_INTEGER && !(column == 7 && type == SQLITE_NULL))
        checksums.strays.push_back("A checksum of " + table + " of run " + std::to_string(run) +
                                   " has something else in it than numbers.");
    }
    if (!has_texts)
      checksums.strays.push_back("A checksum of " + table + " of run " + std::to_string(run) +
                                 " has no text as its table or its origin.");
    const bool is_account = table == sqlite::topic_table_name ||
                            std::find(sqlite::account_tables.begin(), sqlite::account_tables.end(), table) !=
                                sqlite::account_tables.end();
    const bool is_of_all = table == sqlite::topic_table_name;
    if (is_account) {
      Line& line = checksums.accounts[table][run];
      ++line.count;
      line.columns = columns;
      line.said = said;
      if (!origin.empty() || !is_known || is_of_all != (run == sqlite::all_runs) || query->integer(3) != 0 ||
          query->integer(4) != 0)
        checksums.strays.push_back("The checksum of " + table + " of run " + std::to_string(run) +
                                   " is not what a checksum of this table is.");
    } else {
      checksums.values[table][run][origin].ranges.push_back({static_cast<std::uint64_t>(query->integer(3)),
                                                             static_cast<std::uint64_t>(query->integer(4)), columns,
                                                             said, is_known});
    }
  }
  for (auto& [table, runs] : checksums.values) {
    for (auto& [run, origins] : runs) {
      for (auto& [origin, check] : origins) {
        std::sort(check.ranges.begin(), check.ranges.end(),
                  [](const auto& a, const auto& b) { return a.first_sequence < b.first_sequence; });
      }
    }
  }
  return checksums;
}

Result<void> Checksums::scan_accounts(const RecordingFile& file, const std::vector<std::int64_t>& runs,
                                      std::vector<std::string>& problems) {
  sqlite::RowHash hash;
  const auto scan = [&](std::string_view table, bool is_of_all) -> Result<void> {
    auto query = file.prepare("SELECT * FROM " + std::string(table));
    if (!query) return std::move(query).error();
    const int columns = sqlite3_column_count(query->raw());
    auto& lines_of = accounts[std::string(table)];
    std::map<std::int64_t, std::uint64_t> unknown;
    for (;;) {
      auto row = query->step();
      if (!row) return std::move(row).error();
      if (!*row) break;
      const std::int64_t run = is_of_all ? sqlite::all_runs : query->integer(0);
      const bool has_run = is_of_all || (sqlite3_column_type(query->raw(), 0) == SQLITE_INTEGER &&
                                         std::binary_search(runs.begin(), runs.end(), run));
      if (!has_run) ++unknown[run];
      const auto line = lines_of.find(run);
      if (line == lines_of.end()) continue;
      line->second.found.add(
          sqlite::hash_of(hash, query->raw(), is_of_all ? 0 : 1, std::min(line->second.columns, columns)));
    }
    for (const auto& [run, line] : lines_of) {
      if (line.columns == columns) continue;
      problems.push_back(std::string(table) + ": a checksum is of " + std::to_string(line.columns) + " of its " +
                         std::to_string(columns) + " columns.");
    }
    for (const auto& [run, rows] : unknown) {
      problems.push_back(std::string(table) + ": " + plural(rows, "row") + " of run " + std::to_string(run) +
                         ", which is not in the list of runs.");
    }
    return {};
  };
  if (accounts.empty()) return {};
  for (const std::string_view table : sqlite::account_tables) {
    if (auto scanned = scan(table, false); !scanned) return scanned;
  }
  if (accounts.contains(sqlite::topic_table_name)) return scan(sqlite::topic_table_name, true);
  return {};
}

void Checksums::check_widths(const std::string& table, int columns) {
  constexpr int least = 4;  // run, time, origin and sequence
  for (const auto& [run, origins] : values[table]) {
    for (const auto& [origin, check] : origins) {
      for (const RangeCheck::Range& range : check.ranges) {
        if (range.columns >= least && range.columns <= columns) continue;
        strays.push_back("A checksum of " + table + " of run " + std::to_string(run) + " is of " +
                         std::to_string(range.columns) + " of its " + std::to_string(columns) + " columns.");
      }
    }
  }
}

RangeCheck* Checksums::find(std::string_view table, std::int64_t run, const std::string& origin) {
  const auto of_table = values.find(table);
  if (of_table == values.end()) return nullptr;
  const auto of_run = of_table->second.find(run);
  if (of_run == of_table->second.end()) return nullptr;
  const auto of_origin = of_run->second.find(origin);
  return of_origin == of_run->second.end() ? nullptr : &of_origin->second;
}

void check_topics(const Checksums& checksums, const std::vector<RecordedTopic>& topics,
                  const std::vector<std::int64_t>& runs, std::vector<std::string>& problems) {
  problems.insert(problems.end(), checksums.strays.begin(), checksums.strays.end());
  const auto of_topics = checksums.accounts.find(sqlite::topic_table_name);
  if (of_topics == checksums.accounts.end() || !of_topics->second.contains(sqlite::all_runs)) {
    problems.push_back("rtdata_topic: its checksum is not there.");
  } else {
    const Checksums::Line& line = of_topics->second.at(sqlite::all_runs);
    if (line.count != 1 || line.said != line.found) {
      problems.push_back("rtdata_topic: " + plural(line.found.rows, "row") + ", the checksum is of " +
                         plural(line.said.rows, "row") + " and another: a row was changed, added or deleted.");
    }
  }
  const auto has_run = [&](std::int64_t run) { return std::binary_search(runs.begin(), runs.end(), run); };
  for (const RecordedTopic& topic : topics) {
    if (topic.first_run > (runs.empty() ? 0 : runs.back()))
      problems.push_back(topic.topic + ": it came with run " + std::to_string(topic.first_run) +
                         ", which is newer than all that are there.");
  }
  for (const auto& [table, of_runs] : checksums.values) {
    const bool is_there = std::any_of(topics.begin(), topics.end(),
                                      [&name = table](const RecordedTopic& topic) { return topic.table == name; });
    if (!is_there) problems.push_back("There are checksums of the table \"" + table + "\", which no topic has.");
    for (const auto& [run, origins] : of_runs) {
      if (!has_run(run))
        problems.push_back(table + ": there are checksums of run " + std::to_string(run) +
                           ", which is not in the list of runs.");
    }
  }
  for (const auto& [table, of_runs] : checksums.accounts) {
    for (const auto& [run, line] : of_runs) {
      if (run != sqlite::all_runs && !has_run(run))
        problems.push_back(table + ": there is a checksum of run " + std::to_string(run) +
                           ", which is not in the list of runs.");
    }
  }
}

namespace {

void check_accounts(const Findings& found, const Checksums& checksums) {
  const bool is_ended = found.report.info.state != RunState::recording;
  for (const std::string_view table : sqlite::account_tables) {
    const Checksums::Line* line = nullptr;
    if (const auto of_table = checksums.accounts.find(table); of_table != checksums.accounts.end()) {
      const auto of_run = of_table->second.find(found.report.info.run);
      if (of_run != of_table->second.end() && of_run->second.count != 0) line = &of_run->second;
    }
    const std::string place = std::string(table) + ": ";
    if (line == nullptr) {
      if (is_ended) found.problem(place + "its checksum is not there.");
    } else if (!is_ended) {
      found.problem(place + "it has a checksum, as only the tables of a run that has ended have.");
    } else if (line->count != 1) {
      found.problem(place + "it has " + plural(line->count, "checksum") + " instead of one.");
    } else if (line->found.rows != line->said.rows) {
      found.problem(place + plural(line->found.rows, "row") + ", the checksum is of " + plural(line->said.rows, "row") +
                    ".");
    } else if (line->found.sum != line->said.sum) {
      found.problem(place + "the checksum of its " + plural(line->found.rows, "row") +
                    " is another than when they were written: a value was changed.");
    }
  }
}

void check_ranges(const Findings& found, const std::string& place, const RangeCheck& check, std::uint64_t& unknown) {
  const auto sequences = [](const RangeCheck::Range& range) {
    return "sequences " + std::to_string(range.first_sequence) + " to " + std::to_string(range.last_sequence);
  };
  const RangeCheck::Range* before = nullptr;
  for (const RangeCheck::Range& range : check.ranges) {
    if (range.last_sequence < range.first_sequence ||
        (before != nullptr && range.first_sequence <= before->last_sequence)) {
      found.problem(place + "the checksum of " + sequences(range) + " does not follow the one before.");
    }
    before = &range;
    if (range.found.rows != range.said.rows) {
      found.problem(place + plural(range.found.rows, "row") + " of " + sequences(range) + ", the checksum is of " +
                    plural(range.said.rows, "row") + ".");
    } else if (range.is_known && (range.last_found != range.last_sequence ||
                                  (range.first_found != range.first_sequence &&
                                   (&range != &check.ranges.front() || found.report.pruned == 0)))) {
      found.problem(place + "the checksum of " + sequences(range) + " is of rows up to " +
                    std::to_string(range.last_found) + ", the first of which is " + std::to_string(range.first_found) +
                    ".");
    } else if (!range.is_known) {
      unknown += range.found.rows;
    } else if (range.found.sum != range.said.sum) {
      found.problem(place + "the checksum of " + sequences(range) +
                    " is another than when they were written: a value was changed.");
    } else {
      found.report.values_checked += range.found.rows;
    }
  }
}

}  // namespace

void check_checksums(const Findings& found, const OriginMap& rows, const Checksums& checksums) {
  const RunInfo& info = found.report.info;
  check_accounts(found, checksums);
  std::uint64_t unknown = 0, open = 0;
  std::map<std::string, std::uint64_t> outside;  // by place
  for (const auto& [table, of_runs] : checksums.values) {
    const auto of_run = of_runs.find(info.run);
    if (of_run == of_runs.end()) continue;
    std::map<std::string, const RangeCheck*> origins;  // in an order
    for (const auto& [origin, check] : of_run->second) origins[origin] = &check;
    for (const auto& [origin, check] : origins) {
      const std::string place = place_of(table, origin);
      check_ranges(found, place + ": ", *check, unknown);
      if (check->outside != 0) outside[place] += check->outside;
      if (check->beyond != 0) {
        found.problem(place + ": " + plural(check->beyond, "row") + (check->beyond == 1 ? " has" : " have") +
                      " values in columns that came later.");
      }
    }
  }
  for (const auto& [key, origin] : rows) {
    if (origin.not_covered != 0) outside[place_of(origin.topic, origin.origin)] += origin.not_covered;
  }
  for (const auto& [place, count] : outside) {
    if (info.state == RunState::recording) {
      open += count;
    } else {
      found.problem(place + ": " + plural(count, "row") + (count == 1 ? " is" : " are") + " in no checksum.");
    }
  }
  if (open != 0)
    found.note("Values of the last " + plural(open, "row") + " are not checked: their checksums come later.");
  if (unknown != 0 && info.state == RunState::closed) {
    found.problem("The checksums of " + plural(unknown, "row") + " are gone: a run that was closed has all of them.");
  } else if (unknown != 0) {
    found.note("Values of " + plural(unknown, "row") +
               " are not checked: their checksums were not written before it ended.");
  }
}

}  // namespace rtdata::detail
