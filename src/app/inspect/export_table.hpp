// Writes the CSV of a recording for spreadsheets: other marks, rounded numbers, seconds, columns of other
// topics. Private to the program.
#pragma once

#include <iosfwd>
#include <optional>
#include <string>
#include <vector>

#include "rtdata/recording/export.hpp"

namespace rtdata::app {

struct TableFormat {
  char separator = ',';
  char decimal = '.';
  int digits = -1;                      ///< of numbers after the decimal mark; -1: the fewest that read back equal
  bool has_seconds = false;             ///< times are seconds since `start`
  std::optional<Time> start = {};       ///< none: the time of each run's first row
  std::vector<std::string> join = {};   ///< topics whose last event of the run at or before a row is in the row
  std::optional<Duration> within = {};  ///< largest age of that event; none: any
};

/// Writes the rows of a topic, each with the last events of the joined topics, as CSV. Values that are absent, and
/// those of a joined topic that has no such event, are empty. Errors: bad-argument, not-found; those of `Rows` and of
/// the stream.
Result<ExportCount> export_table(const Recording& recording, const ExportConfig& config, const TableFormat& format,
                                 std::ostream& out);

}  // namespace rtdata::app
