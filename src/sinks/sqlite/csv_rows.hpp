// Rows of one table as CSV, straight from the columns of the statement.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "rtdata/data/codec.hpp"
#include "rtdata/sinks/export.hpp"
#include "sinks/sqlite/recording_file.hpp"

namespace rtdata::detail {

/// A faster way to the same bytes as those of the CSV codec. A row that is unusual (a missing column, a text from
/// before escapes were introduced, a value that does not fit) is left to that codec and to `RowReader`.
class CsvRows {
 public:
  /// `Runs::named`: the last column is the number of the run.
  enum class Runs { left_out, named };
  static CsvRows make(const Recording& recording, RecordedTopic topic, const ExportConfig& config, Runs runs);

  /// Appends rows to `out` until it has `enough` bytes or no row is left. Returns the number of rows; 0 at the end.
  /// With an error `out` has the rows before it.
  std::uint64_t append(std::string& out, std::size_t enough);
  /// Of the row that was appended last.
  Time last_time() const noexcept { return last_time_; }

 private:
  struct Column {
    Kind kind;
    bool is_optional;
    const Leaf* leaf;
  };
  CsvRows(const Recording& recording, RecordedTopic topic, const ExportConfig& config, Runs runs);
  /// Loads what the rows of this run need: its `line_`, when times are in UTC.
  void begin_run(std::int64_t run);
  /// Appends the current row by means of `codec_`.
  void append_by_codec(std::string& out, Time time);
  char* put_row(char* to, Time time, std::string& out);

  const Recording* recording_;
  RecordedTopic topic_;
  RowFilter filter_;
  Runs runs_;
  bool is_utc_;
  bool is_iso8601_;
  std::unique_ptr<Codec> codec_;
  std::vector<Column> columns_;
  sqlite::Statement statement_;
  std::int64_t run_ = INT64_MIN;
  UtcLine line_{{}};
  std::uint64_t given_ = 0;  // rows appended so far
  Time last_time_{};
  std::uint64_t last_sequence_ = 0;
  bool has_ended_ = false;
  std::size_t longest_ = 0;  // bytes of the longest row, without its texts
  std::vector<std::byte> payload_, bytes_;
};

}  // namespace rtdata::detail
