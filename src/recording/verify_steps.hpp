// The part of verify that compares the recorded steps of a topic with its rows.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "recording/recording_file.hpp"
#include "recording/step.hpp"
#include "recording/verify_run.hpp"

namespace rtdata::detail {

/// Computes the steps from the rows again: each must be recorded, the same to the last bit, and no others. If the first
/// rows of a step were pruned, only its checksum and its end are checked.
class StepCheck {
 public:
  StepCheck(const RecordingFile& file, const RecordedTopic& topic, RunsRows& runs, std::vector<std::string>& problems);
  /// Adds the next row of the topic's table: `row` is at it, and has the table's columns from column `first` on.
  void add(sqlite3_stmt* row, int first, const OriginRows& origin);
  /// After the last row.
  void end();

 private:
  /// The steps of an origin that are recorded, in order of time.
  struct Stored {
    sqlite::Statement steps;
    bool has_row = false;
    std::uint64_t from = 0;  // as in the ledger
  };
  struct Origin {
    explicit Origin(std::size_t fields) : made(fields) {}
    std::string name;
    const UtcLine* line = nullptr;
    std::uint64_t first = 0;  // sequence of its first row
    bool has_steps = false;   // or should have
    sqlite::OriginSteps made;
    std::array<Stored, sqlite::step_lengths.size()> stored;
  };
  Origin& origin_of(const OriginRows& rows);
  void compare(Origin& origin, std::size_t length, const sqlite::Step& made);
  /// Goes to the next one.
  void advance(Stored& stored);
  void end_run();
  void tell(const Origin& origin, std::size_t length, std::int64_t time, const char* what);
  /// Reports steps of runs and origins that have no rows.
  void tell_others(std::size_t length);
  /// True if a table of steps has the columns of the fields, and no others.
  bool has_columns(const std::vector<std::string>& columns, const std::string& table);

  const RecordingFile& file_;
  const RecordedTopic& topic_;
  RunsRows& runs_;
  std::vector<std::string>& problems_;  // problems that belong to no run
  std::vector<sqlite::StepField> fields_;
  std::vector<int> columns_;  // of them, in the topic's table
  enum class Table { none, there, other };
  std::array<Table, sqlite::step_lengths.size()> tables_{};
  sqlite::RowHash hash_;
  std::int64_t run_ = 0;                   // that the origins are of
  std::map<std::string, Origin> origins_;  // by name
  const OriginRows* last_rows_ = nullptr;
  Origin* last_ = nullptr;
  std::set<std::pair<std::int64_t, std::string>> seen_;
};

}  // namespace rtdata::detail
