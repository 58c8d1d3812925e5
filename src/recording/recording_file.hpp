// The open file and snapshots of it, shared by Recording, Rows, verify and summary.
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "recording/database.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata::detail {

struct RecordingFile {
  sqlite::Database database;
  int snapshots = 0;
  bool is_of_server = false;  // made of what a server has

  /// Like Database::prepare; a mismatch with the schema is reported as damaged.
  sqlite::Statement prepare(const std::string& sql) const;
  Error damaged(std::string where, std::string why) const;
};

/// While it lives, all reads see the same state of the file. May be nested.
class Snapshot {
 public:
  explicit Snapshot(std::shared_ptr<RecordingFile> file);
  Snapshot(Snapshot&& other) noexcept = default;
  Snapshot& operator=(Snapshot&&) = delete;
  ~Snapshot();

 private:
  std::shared_ptr<RecordingFile> file_;
};

/// Columns of `rows_in_order`, before those of the fields.
enum FixedColumn { run_column, time_column, origin_column, sequence_column, fixed_columns };
/// A filter, with its times converted to each run's clock.
struct Selection {
  /// Errors: bad-name, bad-argument, those of reading.
  static Selection make(const Recording& recording, const RowFilter& filter);
  RowFilter filter;
  struct Bounds {
    std::int64_t run;
    std::optional<Time> from, until;
  };
  std::vector<Bounds> bounds;  // of each run when the filter's are in UTC
};
/// The SQL conditions of a time range for a table with the alias t: `from_column` >= from, `until_column` < until. For
/// rows both are t.time; for gaps they are t.last and t.first, so that a gap that overlaps the range is in it.
std::string conditions(const Selection& selection, const char* from_column, const char* until_column);
/// The same of the rows of a topic's table.
std::string row_conditions(const Selection& selection);
/// Binds the parameters of these conditions.
void bind_conditions(sqlite::Statement& statement, const Selection& selection);
/// A statement that gives the rows of a topic's table, run by run, each in order of time. `columns`: SQL of those after
/// the fixed ones, as `RowReader::columns` has it.
sqlite::Statement rows_in_order(const RecordingFile& file, const RecordedTopic& topic, const Selection& selection,
                                const std::string& columns);
/// The UTC conversion of a recorded run's boot; none for an unlisted run, whose times do not change.
UtcLine utc_line_of(const RecordingFile& file, std::int64_t run);
/// An error with the place of its row.
Error at_row(const RecordingFile& file, const RecordedTopic& topic, std::int64_t run, std::string_view origin,
             std::uint64_t sequence, Error error);

/// An error after the row with this sequence, the last readable one; 0: none.
Error behind_row(const RecordingFile& file, const RecordedTopic& topic, std::int64_t run, std::uint64_t sequence,
                 Error error);

/// Reads the columns of a topic's rows into payloads.
class RowReader {
 public:
  explicit RowReader(const RecordedTopic& topic) : topic_(&topic) {}
  /// ", t."temperature", t."position.x"": what follows other columns in a SELECT from the table called t.
  std::string columns() const;
  /// `first`: the column where those begin. Errors: damaged, which names the field.
  void read(sqlite3_stmt* row, int first, std::byte* payload) const;

 private:
  const RecordedTopic* topic_;
};

}  // namespace rtdata::detail
