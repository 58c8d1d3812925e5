#include "rtdata/sinks/export.hpp"

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <fstream>
#include <map>
#include <ostream>

#include "rtdata/loop/topic.hpp"
#include "sinks/sqlite/recording_file.hpp"

namespace rtdata {
namespace {

constexpr std::size_t flush_bytes = std::size_t{1} << 16;

Result<std::unique_ptr<Codec>> codec_of(const ExportConfig& config, const CodecRegistry& registry) {
  if (config.format == "csv") {
    return make_csv_codec({config.time_text == ExportConfig::TimeText::iso8601 ? CsvConfig::TimeFormat::iso8601
                                                                               : CsvConfig::TimeFormat::nanoseconds});
  }
  return registry.make(config.format == "jsonl" ? "json" : config.format);
}

std::string header_of(const ExportConfig& config, const Codec& codec, const Description& description) {
  if (config.format == "csv" && config.header == ExportConfig::Header::names_and_units)
    return csv_header_with_units(description);
  return codec.header(description);
}

/// The UTC lines of the runs, read when they are first needed.
class UtcLines {
 public:
  explicit UtcLines(const Recording& recording) : recording_(recording) {}
  Result<Time> utc(std::int64_t run, Time recorded) {
    auto found = lines_.find(run);
    if (found == lines_.end()) {
      auto line = recording_.utc_line(run);
      if (!line && line.error().code != make_error_code(Errc::not_found)) return std::move(line).error();
      found = lines_.emplace(run, line ? std::move(*line) : UtcLine({})).first;  // rows of a run that is not listed stay
    }
    return found->second.utc(recorded);
  }

 private:
  const Recording& recording_;
  std::map<std::int64_t, UtcLine> lines_;
};

Error cannot_write(const std::string& path) {
  return system_error(errno == 0 ? EIO : errno, "cannot write the export", path,
                      "check the folder, its permissions and the room left");
}

/// Writes the rows; a header first, unless there are none.
Result<std::uint64_t> write_rows(const Recording& recording, const ExportConfig& config, const RowFilter& filter,
                                 std::int64_t version, Codec& codec, std::ostream& out, const std::string& path) {
  RowFilter unlimited = filter;  // rows of another description do not count
  unlimited.limit = 0;
  auto rows = recording.rows(unlimited);
  if (!rows) return std::move(rows).error();
  UtcLines lines(recording);
  std::vector<std::byte> bytes;
  std::uint64_t written = 0;
  const auto flush = [&] {
    out.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    bytes.clear();
    return out.good();
  };
  while (filter.limit == 0 || written < filter.limit) {
    auto row = rows->next();
    if (!row) return std::move(row).error();
    if (*row == nullptr) break;
    const RecordedRow& given = **row;
    if (version != 0 && given.topic().version != version) continue;
    EventHeader header = given.header();
    if (config.time == ExportTime::utc) {
      auto utc = lines.utc(given.run(), header.time);
      if (!utc) return std::move(utc).error();
      header.time = *utc;
    }
    if (written == 0) {
      const std::string text = header_of(config, codec, *given.topic().description);
      const auto* begin = reinterpret_cast<const std::byte*>(text.data());
      bytes.insert(bytes.end(), begin, begin + text.size());
    }
    const EventView event = given.event();
    if (auto encoded = codec.encode(EventView(event.topic(), header, event.description(), event.payload()), bytes);
        !encoded) {
      Error error = std::move(encoded).error();
      error.where = "topic " + given.topic().topic + ", origin " + std::string(header.origin) + ", sequence " +
                    std::to_string(header.sequence) + ", " + error.where;
      return error;
    }
    // JSON objects are lines of their own.
    if (codec.name() == "json" && (bytes.empty() || bytes.back() != std::byte{'\n'})) bytes.push_back(std::byte{'\n'});
    ++written;
    errno = 0;
    if (bytes.size() >= flush_bytes && !flush()) return cannot_write(path);
  }
  errno = 0;
  if (!flush() || !out.flush()) return cannot_write(path);
  return written;
}

/// The topics and descriptions that a filter takes and that have rows.
Result<std::vector<RecordedTopic>> taken_topics(const Recording& recording, const RowFilter& filter) {
  if (!is_topic_pattern(filter.topic)) {
    return Error{Errc::bad_name, "cannot export", "topic " + filter.topic, "it is neither a topic nor a pattern",
                 "write room/climate, room/+ or room/#"};
  }
  auto topics = recording.topics();
  if (!topics) return std::move(topics).error();
  std::vector<RecordedTopic> taken;
  for (RecordedTopic& topic : *topics) {
    if (!topic_matches(filter.topic, topic.topic)) continue;
    auto statement = recording.file()->prepare("SELECT 1 FROM " + sqlite::quoted(topic.table) + " t WHERE " +
                                               (filter.run ? "t.run = " + std::to_string(*filter.run) : "1") +
                                               " LIMIT 1");
    if (!statement) return std::move(statement).error();
    auto row = statement->step();
    if (!row) return std::move(row).error();
    if (*row) taken.push_back(std::move(topic));
  }
  return taken;
}

}  // namespace

Result<ExportCount> export_rows(const Recording& recording, const ExportConfig& config, std::ostream& out) {
  auto codec = codec_of(config, CodecRegistry::standard());
  if (!codec) return std::move(codec).error();
  auto snapshot = detail::Snapshot::take(recording.file());
  if (!snapshot) return std::move(snapshot).error();
  auto topics = taken_topics(recording, config.filter);
  if (!topics) return std::move(topics).error();
  if (config.format == "csv" && topics->size() > 1) {
    const bool is_one_topic = topics->front().topic == topics->back().topic;
    std::string names;
    for (std::size_t i = 0; i < topics->size() && i < 5; ++i) names += (i == 0 ? "" : ", ") + (*topics)[i].topic;
    if (topics->size() > 5) names += ", ...";
    return Error{Errc::bad_argument, "cannot export to one CSV text", recording.path(),
                 is_one_topic ? "the fields of " + topics->front().topic + " changed between runs"
                              : "it holds one topic, and there are " + std::to_string(topics->size()) + ": " + names,
                 is_one_topic ? "choose a run, or export into a folder" : "choose a topic, or export into a folder"};
  }
  auto written = write_rows(recording, config, config.filter, 0, **codec, out, "standard output");
  if (!written) return std::move(written).error();
  return ExportCount{"", *written};
}

Result<std::vector<ExportCount>> export_files(const Recording& recording, const ExportConfig& config,
                                              const std::string& folder, const CodecRegistry& registry) {
  auto snapshot = detail::Snapshot::take(recording.file());
  if (!snapshot) return std::move(snapshot).error();
  auto topics = taken_topics(recording, config.filter);
  if (!topics) return std::move(topics).error();
  std::vector<ExportCount> counts;
  for (const RecordedTopic& topic : *topics) {
    auto codec = codec_of(config, registry);
    if (!codec) return std::move(codec).error();
    std::filesystem::path path(folder);
    for (const auto& segment : std::filesystem::path(topic.topic)) {
      if (segment == "." || segment == "..") {
        return Error{Errc::bad_name, "cannot export into a folder", "topic " + topic.topic,
                     "its name would leave the folder", "export it by itself"};
      }
      path /= segment;
    }
    if (topic.version > 1) path += "~" + std::to_string(topic.version);
    path += "." + config.format;
    std::error_code failed;
    std::filesystem::create_directories(path.parent_path(), failed);
    if (failed)
      return system_error(failed.value(), "cannot make the folder", path.parent_path().string(),
                          "check its permissions");
    errno = 0;
    std::ofstream file(path, std::ios::binary | std::ios::trunc);
    if (!file) return cannot_write(path.string());
    RowFilter filter = config.filter;
    filter.topic = topic.topic;
    auto written = write_rows(recording, config, filter, topic.version, **codec, file, path.string());
    if (!written) return std::move(written).error();
    counts.push_back({path.string(), *written});
  }
  return counts;
}

}  // namespace rtdata
