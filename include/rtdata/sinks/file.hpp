/// FileSink: events into a file: JSON lines, CSV, CBOR, lines of InfluxDB, raw bytes, or any format of a CodecRegistry.
///
///     rtdata::FileSink recording(loop, {.path = "run.jsonl"});
///     rtdata::FileSink table(loop, {.path = "run-{topic}.csv", .format = "csv"});
///
/// A file holds one run: each time that a sink begins, a file that is there already is given the next number
/// ("run-00000001.jsonl", which sorts before "run.jsonl"), and a new one takes its name. With `rotate` the sink goes on
/// in the file that is there. Half an event that a kill or a power cut left at its end is seen to at the next start,
/// and reported: half an event could be taken for values that were never measured, so it is moved to FILE.half. (To
/// find the end, CSV and raw bytes are read through once at the start.)
///
/// In the file's name, `{topic}` stands for the topic, its `/` written as `-`: a file each. `{date}` is the day of the
/// start (UTC), `{run}` one more than the largest number there is at its place among the files of the folder. A format
/// with a header (CSV) holds one topic a file: a second topic on one path is an error that says so. Where `rotate` goes
/// on in a file with another header, that is an error: choose another name.
///
/// One process at a time writes a file: it is locked (flock), and a second start is refused with the holder's process
/// id. When the disk is full the events wait in the queue; a batch goes on where it stopped, so that each event is
/// there once. A batch that stays half-written until the deadline of closing counts as lost as a whole. An event that
/// does not fit the format (raw: a value over 255 bytes, an absent optional) is dropped as refused, counted and
/// reported. A file that is deleted or moved is made anew, and that is reported, at the next batch.
///
/// With `rotate` a file that is full, or whose time is over, is given the next number, and a new one takes its name and
/// its header. Each event is in one of them as a whole.
/// When no new file can be made, the old one grows on, and that is reported. After a restart, the time of a file from
/// before is that of its last change.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's; files are written on the sink's lane.
/// Errors of the constructor (SetupError): not_found (no such directory, no such format), not_permitted, busy,
/// bad_argument (a directory, a device; two topics in one CSV), description_differs (another header), damaged (a file
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

/// When what was written is forced onto the disk (fdatasync). Without it, a power cut loses what the kernel still holds
/// (some 30 s, usually); a kill loses nothing that was written.
enum class FileSync {
  never,
  batch,     ///< after each batch: the safest, the slowest
  at_close,  ///< once, when the sink is closed
};
constexpr auto describe(type_tag<FileSync>) {
  return enumeration("sync", value("never", FileSync::never), value("batch", FileSync::batch),
                     value("close", FileSync::at_close));
}

/// When a file is given a number and a new one begun: at whichever comes first.
struct FileRotation {
  static constexpr std::uint64_t least_bytes = 4096;
  static constexpr Duration least_time = std::chrono::seconds{1};
  std::optional<std::uint64_t> bytes = {};  ///< before the event that would make it larger
  std::optional<Duration> time = {};        ///< at the first event after each multiple of it (UTC: 1 h, 1 d)
  bool is_on() const noexcept { return bytes || time; }

  friend constexpr auto parameters(type_tag<FileRotation>) {
    return parameter_list(
        parameter("bytes", &FileRotation::bytes, "a new file before this one becomes larger", unit("By"),
                  range(least_bytes, std::uint64_t{1} << 50)),
        parameter("time", &FileRotation::time, "a new file at each multiple of it, such as 1 h or 1 d",
                  range(least_time, Duration{std::chrono::hours{24 * 366}})));
  }
};

struct FileConfig {
  std::string path;  ///< may hold {topic}, {date} and {run} in its last part
  /// "jsonl" (or "json"), "csv", "cbor", "influx", "raw", or a name of the registry; empty: csv or cbor where the path
  /// ends with .csv or .cbor, else jsonl
  std::string format = {};
  FileSync sync = FileSync::at_close;
  FileRotation rotate = {};  ///< run.csv is the file that is written; those before are run-00000001.csv and so on
  std::uint64_t keep = 0;    ///< with `rotate`: how many earlier files are kept; 0: all
  std::string permissions = "0640";  ///< of a file that is made, less the umask; one that is there keeps its own
  SinkConfig sink = {};              ///< name: the file's by default

  friend constexpr auto parameters(type_tag<FileConfig>) {
    return parameter_list(
        parameter("path", &FileConfig::path,
                  "the file; {topic} in its name makes a file a topic, {date} and {run} one a run", required,
                  TextIs::output_file, placeholders("topic", "date", "run")),
        parameter(
            "format", &FileConfig::format,
            "jsonl (a JSON object a line), csv, cbor, influx, raw, or a format added by the program; without it as "
            "the path ends: .csv, .cbor, else jsonl"),
        parameter("sync", &FileConfig::sync,
                  "when the data is forced onto the disk: never, after each batch, at close"),
        parameter("rotate", &FileConfig::rotate, "when a new file is begun; those before get numbers that sort"),
        parameter("keep", &FileConfig::keep, "how many of those before are kept; 0: all"),
        parameter("permissions", &FileConfig::permissions,
                  "who may read and write a file that is made, in octal digits, less the umask", TextIs::permissions),
        include_member(&FileConfig::sink));
  }
  friend void check_config(const FileConfig& config, const ConfigItem& item, Problems& problems);
};

/// Of these, which the files cannot take: a second one on one path of a format with a header, one whose file is there
/// with another header, or with something else. An error each, `where` its topic or file. Files are read, none is made.
/// A format that is not among `formats` is not looked at.
std::vector<Error> refused_topics(const FileConfig& config, std::span<const TopicToRecord> topics,
                                  const CodecRegistry& formats = CodecRegistry::standard());

/// The name of its format, which `format` or the end of `path` says.
std::string format_of(const FileConfig& config);
/// The path of the file that this topic's events go to, {date} and {run} as they are written.
std::string file_of_topic(const FileConfig& config, std::string_view topic);
/// Whether `other` goes with `file`, one of the sink's: FILE.half, and those before it.
bool is_companion_file(const FileConfig& config, const std::string& file, const std::string& other);

/// Whether the sink can begin now to write `file`, which may be there or not, and no other process writes it. Makes and
/// changes nothing. Any thread; blocks on the disk. Errors: not_permitted, busy, bad_argument, as of the constructor.
Result<void> check_openable(const FileConfig& config, const std::string& file);

class FileSink : public Sink {
 public:
  FileSink() noexcept = default;
  /// `formats` is used during the call only.
  FileSink(Loop& loop, FileConfig config, const CodecRegistry& formats = CodecRegistry::standard());
};

}  // namespace rtdata
