/// FileSink: events into a file: JSON lines, CSV, CBOR, lines of InfluxDB, raw bytes, or any format of a CodecRegistry.
///
///     rtdata::FileSink recording(loop, {.path = "run.jsonl"});
///     rtdata::FileSink table(loop, {.path = "run-{topic}.csv", .format = "csv"});
///
/// A file holds one run: when a sink starts, it renames an existing file to the next number ("run-00000001.jsonl",
/// which sorts before "run.jsonl") and starts a new one. With `rotate` the sink continues the existing file. A kill or
/// a power failure may leave half an event at the end of a file. The next start reports it and moves it to FILE.half,
/// because half an event could look like wrong values. (To find the end, the sink reads CSV and raw files once at the
/// start.)
///
/// In the file's name, `{topic}` is the topic with `-` for `/`, which gives a file for each topic. `{date}` is the day
/// of the start (UTC), `{run}` one more than the largest such number among the files of the folder. A format with a
/// header (CSV) holds one topic in a file: a second topic on the same path is an error. If `rotate` would continue a
/// file with another header, that is an error: choose another name.
///
/// Only one process writes a file: it is locked (flock), and a second start is refused with the process id of the
/// first. If the disk is full, the events wait in the queue; a batch continues where it stopped, so each event is in
/// the file once. A batch that is still half-written at the deadline of closing counts as lost. An event that does not
/// fit the format (raw: a value over 255 bytes, an absent optional) is dropped as refused, counted and reported. If the
/// file is deleted or moved, the next batch makes it again and reports this.
///
/// With `rotate` a file at its size or time limit is renamed to the next number, and a new one starts with the header.
/// No event is split between files. If no new file can be made, the sink continues the old one and reports this. After
/// a restart, the time of an existing file is that of its last change.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's; files are written on the sink's lane.
/// Errors of the constructor (SetupError): not-found (no such directory, no such format), not-permitted, busy,
/// bad-argument (a directory, a device; two topics in one CSV), description-differs (another header), damaged (a file
/// of another format); those of `Sink`.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "rtdata/data/codec.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata {

class ConfigItem;
class Problems;

/// When the sink forces written data to the disk (fdatasync). Without it, a power failure loses the data that the
/// kernel still holds (usually about 30 s); a kill loses nothing that was written.
enum class FileSync {
  never,
  batch,     ///< after each batch: the safest, the slowest
  at_close,  ///< once, when the sink is closed
};
constexpr auto describe(type_tag<FileSync>) {
  return enumeration("sync", value("never", FileSync::never), value("batch", FileSync::batch),
                     value("close", FileSync::at_close));
}

/// When to rename the file and start a new one; the first limit reached counts.
struct FileRotation {
  static constexpr std::uint64_t least_bytes = 4096;
  static constexpr Duration least_time = std::chrono::seconds{1};
  std::optional<std::uint64_t> bytes = {};  ///< before the event that would make it larger
  std::optional<Duration> time = {};        ///< at the first event after each multiple of it (UTC: 1 h, 1 d)
  bool is_on() const noexcept { return bytes || time; }

  friend constexpr auto parameters(type_tag<FileRotation>) {
    return parameter_list(
        parameter("bytes", &FileRotation::bytes, "largest size of a file; then a new one begins", unit("By"),
                  range(least_bytes, std::uint64_t{1} << 50)),
        parameter("time", &FileRotation::time, "a new file begins at each multiple of this time, such as 1 h or 1 d",
                  range(least_time, Duration{std::chrono::hours{24 * 366}})));
  }
};

struct FileConfig {
  std::string path;  ///< may hold {topic}, {date} and {run} in its last part
  /// "jsonl" (or "json"), "csv", "cbor", "influx", "raw", or a name of the registry; empty: csv or cbor where the path
  /// ends with .csv or .cbor, else jsonl
  std::string format = {};
  FileSync sync = FileSync::at_close;
  FileRotation rotate = {};          ///< run.csv is the current file; earlier ones are run-00000001.csv and so on
  std::uint64_t keep = 0;            ///< with `rotate`: how many earlier files are kept; 0: all
  std::string permissions = "0640";  ///< of a new file, minus the umask; an existing file keeps its own
  SinkConfig sink = {};              ///< name: the file's by default

  friend constexpr auto parameters(type_tag<FileConfig>) {
    return parameter_list(
        parameter("path", &FileConfig::path,
                  "the file; {topic} in its name: one file per topic; {date} and {run}: one per run", required,
                  TextIs::output_file, placeholders("topic", "date", "run")),
        parameter(
            "format", &FileConfig::format,
            "jsonl (a JSON object per line), csv, cbor, influx, raw, or a format added by the program; default: by "
            "the end of the path: .csv, .cbor, else jsonl"),
        parameter("sync", &FileConfig::sync,
                  "when the data is forced onto the disk: never, after each batch, at close"),
        parameter("rotate", &FileConfig::rotate, "when a new file begins; earlier files get numbers that sort"),
        parameter("keep", &FileConfig::keep, "how many earlier files are kept; 0: all"),
        parameter("permissions", &FileConfig::permissions,
                  "permissions of a new file, in octal digits, minus the umask", TextIs::permissions),
        include_member(&FileConfig::sink));
  }
  friend void check_config(const FileConfig& config, const ConfigItem& item, Problems& problems);
};

/// Returns an error for each topic that the files cannot store: a second topic on one path in a format with a header,
/// or an existing file with another header or other content. `where` is the topic or file. Reads files, makes none.
/// Ignores formats that are not in `formats`.
std::vector<Error> refused_topics(const FileConfig& config, std::span<const TopicToRecord> topics,
                                  const CodecRegistry& formats = CodecRegistry::standard());

/// The name of its format, from `format` or the end of `path`.
std::string format_of(const FileConfig& config);
/// The path of a topic's file, with {date} and {run} unreplaced.
std::string file_of_topic(const FileConfig& config, std::string_view topic);
/// True if `other` belongs to the sink's `file`: FILE.half and the earlier files.
bool is_companion_file(const FileConfig& config, const std::string& file, const std::string& other);

/// Checks that the sink could start writing `file` now, whether it exists or not, and that no other process writes it.
/// Creates and changes nothing. Any thread; blocks on the disk. Errors: not-permitted, busy, bad-argument, as of the
/// constructor.
Result<void> check_openable(const FileConfig& config, const std::string& file);

class FileSink : public Sink {
 public:
  FileSink() noexcept = default;
  /// `formats` is used during the call only.
  FileSink(Loop& loop, FileConfig config, const CodecRegistry& formats = CodecRegistry::standard());
};

}  // namespace rtdata
