/// export_rows: writes recorded rows as CSV, JSON lines or any other format of a CodecRegistry.
///
///     rtdata::export_rows(recording, {.format = "csv", .filter = {.topic = "room/climate"}}, std::cout).or_throw();
///     rtdata::export_files(recording, {.format = "csv", .time = rtdata::ExportTime::utc}, "out").or_throw();
///
/// Functions without state. Thread: that of the recording. Errors: not-found (format), bad-argument, those of `Rows`,
/// those of files.
#pragma once

#include <cstdint>
#include <functional>
#include <iosfwd>
#include <string>
#include <vector>

#include "rtdata/data/codec.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata {

/// How far an export has got.
struct ExportProgress {
  std::uint64_t rows = 0;  ///< written so far, of all files
  Time at{};               ///< the time of the last one, as it is written
};

enum class ExportTime {
  recorded,  ///< as stored: never jumps within a run
  utc,       ///< see UtcLine
};

struct ExportConfig {
  std::string format = "csv";  ///< name of a codec; "jsonl" is "json", an object per line
  RowFilter filter = {};
  ExportTime time = ExportTime::recorded;
  enum class TimeText { nanoseconds, iso8601 };
  TimeText time_text = TimeText::nanoseconds;  ///< for CSV; the other formats have their own
  enum class Header { names, names_and_units };
  Header header = Header::names;  ///< of CSV
  enum class Existing { refuse, replace };
  Existing existing = Existing::refuse;  ///< if a file exists already
  /// Not 0: reduces the rows to steps of this length, see `Recording::steps`. With UTC times, the steps are aligned to
  /// UTC.
  Duration step{0};
  /// Called after about each 256 KiB written; empty: not called.
  std::function<void(const ExportProgress&)> on_progress = {};
};

struct ExportCount {
  std::string path;  ///< empty for a stream
  std::uint64_t rows = 0;
  std::uint64_t refused = 0;  ///< rows left out because they do not fit the format
  Error refusal = {};         ///< the error of the first of them
};

/// Writes all rows to one stream; CSV always has a header. A format without topic names (CSV) can hold rows of only one
/// description: otherwise bad-argument, before anything is written.
Result<ExportCount> export_rows(const Recording& recording, const ExportConfig& config, std::ostream& out);

/// Writes a file for each topic into a folder, which is made: room/climate.csv, then room/climate~2.csv for a second
/// description; for JSON lines room/climate.jsonl. An existing file is an error (bad-argument), and nothing is written,
/// unless `existing` allows to replace it.
Result<std::vector<ExportCount>> export_files(const Recording& recording, const ExportConfig& config,
                                              const std::string& folder,
                                              const CodecRegistry& registry = CodecRegistry::standard());

}  // namespace rtdata
