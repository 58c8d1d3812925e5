#include "rtdata/recording/export.hpp"

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <fstream>
#include <map>
#include <ostream>

#include "recording/recording_file.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata {
namespace {

constexpr std::size_t flush_bytes = std::size_t{1} << 18;

bool is_csv(const ExportConfig& config) { return config.format == "csv"; }

std::unique_ptr<Codec> codec_of(const ExportConfig& config, const CodecRegistry& registry) {
  if (is_csv(config)) {
    return make_csv_codec({config.time_text == ExportConfig::TimeText::iso8601 ? CsvConfig::TimeFormat::iso8601
                                                                               : CsvConfig::TimeFormat::nanoseconds});
  }
  auto codec = registry.make(config.format == "jsonl" ? "json" : config.format);
  if (codec) return *std::move(codec);
  if (registry.find("json") == nullptr) throw SetupError(codec.error());
  Error error = std::move(codec).error();
  error.advice += " (json and jsonl are one: an object a line)";
  throw SetupError(std::move(error));
}

std::string cell(const std::string& text) {
  if (text.find_first_of("\",\r\n") == std::string::npos) return text;
  std::string in_quotes = "\"";
  for (const char c : text) in_quotes.append(c == '"' ? 2 : 1, c);
  return in_quotes + '"';
}

/// The runs of the recording, by number, with their uuids; empty if all rows belong to one run.
using NamedRuns = std::map<std::int64_t, std::string>;
NamedRuns named_runs(const Recording& recording, const ExportConfig& config) {
  NamedRuns named;
  if (config.filter.run) return named;
  auto runs = recording.runs().or_throw();
  if (runs.size() > 1)
    for (const RunInfo& run : runs) named.emplace(run.run, run.uuid);
  return named;
}

/// For CSV: the heading says what the times are. `fields`: null when there are none.
std::string csv_head(const ExportConfig& config, const NamedRuns& runs, const Description* fields) {
  const bool is_utc = config.time == ExportTime::utc;
  const bool has_units = config.header == ExportConfig::Header::names_and_units;
  std::string head = is_utc ? "utc" : "time";
  if (has_units && config.time_text == ExportConfig::TimeText::nanoseconds) head += " [ns]";
  head += ",origin,sequence";
  const std::string end = runs.empty() ? "\n" : ",run\n";
  if (fields == nullptr) return head + end;
  for (const Leaf& leaf : fields->leaves()) {
    std::string name = leaf.path;
    std::transform(name.begin(), name.end(), name.begin(),
                   [](char c) { return c >= 'A' && c <= 'Z' ? c - 'A' + 'a' : c; });
    name = leaf.path + (is_utc && name == "utc" ? "~" : "");  // as in the view
    if (has_units && !leaf.unit.empty()) name += " [" + leaf.unit + "]";
    head += ',' + cell(name);
  }
  return head + end;
}

/// The UTC lines of the runs, read when they are first needed.
class UtcLines {
 public:
  explicit UtcLines(const Recording& recording) : recording_(recording) {}
  Time utc(std::int64_t run, Time recorded) {
    auto found = lines_.find(run);
    if (found == lines_.end()) {
      auto line = detail::utc_line_of(*recording_.file(), run);
      found = lines_.emplace(run, std::move(line)).first;
    }
    return found->second.utc(recorded);
  }

 private:
  const Recording& recording_;
  std::map<std::int64_t, UtcLine> lines_;
};

[[noreturn]] void cannot_write(const std::string& path) {
  throw SetupError(system_error(errno == 0 ? EIO : errno, "cannot write the export", path,
                                "check the folder, its permissions and the room left"));
}

void put(std::ostream& out, std::string_view text, const std::string& path) {
  errno = 0;
  if (!out.write(text.data(), static_cast<std::streamsize>(text.size()))) cannot_write(path);
}

/// `before`: rows of the files before this one.
void tell(const ExportConfig& config, std::uint64_t before, std::uint64_t rows, Time at) {
  if (config.on_progress) config.on_progress({before + rows, at});
}

/// Writes the rows through a codec, and skips rows that do not fit. `topic`: the only one; null: all.
ExportCount write_rows(const Recording& recording, const ExportConfig& config, const NamedRuns& runs,
                       const RecordedTopic* topic, Codec& codec, std::ostream& out, const std::string& path,
                       std::uint64_t before = 0) {
  RowFilter unlimited = config.filter;  // rows of another description do not count
  unlimited.limit = 0;
  if (topic != nullptr) unlimited.topic = topic->topic;
  const bool is_in_steps = config.step > Duration{0};
  const bool is_utc = config.time == ExportTime::utc;
  if (is_in_steps && is_utc) unlimited.times = RowFilter::Times::utc;
  auto rows = (is_in_steps ? recording.steps(unlimited, config.step) : recording.rows(unlimited)).or_throw();
  UtcLines lines(recording);
  std::vector<std::byte> bytes;
  ExportCount count;
  const auto flush = [&] {
    put(out, {reinterpret_cast<const char*>(bytes.data()), bytes.size()}, path);
    bytes.clear();
  };
  bool is_headed = false;
  const auto write_head = [&](const Description* of) {
    if (std::exchange(is_headed, true)) return;
    const std::string text = is_csv(config) ? csv_head(config, runs, of) : of != nullptr ? codec.header(*of) : "";
    const auto* begin = reinterpret_cast<const std::byte*>(text.data());
    bytes.insert(bytes.end(), begin, begin + text.size());
  };
  if (is_csv(config) && !is_in_steps && topic != nullptr) write_head(topic->description.get());
  while (config.filter.limit == 0 || count.rows + count.refused < config.filter.limit) {
    auto row = rows.next();
    if (!row) {  // what came before it is good
      flush();
      out.flush();
      throw SetupError(row.error());
    }
    if (*row == nullptr) break;
    const RecordedRow& given = **row;
    if (topic != nullptr && given.topic().version != topic->version) continue;
    EventHeader header = given.header();
    if (is_utc && !is_in_steps) header.time = lines.utc(given.run(), header.time);
    write_head(given.topic().description.get());
    const EventView event = given.event();
    const auto run = runs.find(given.run());
    const std::string_view uuid = run == runs.end() ? std::string_view() : std::string_view(run->second);
    if (auto encoded = codec.encode(EventView(event.topic(), header, event.description(), event.payload(), uuid),
                                    bytes);
        !encoded) {
      if (count.refused++ > 0) continue;
      count.refusal = std::move(encoded).error();
      count.refusal.where = "topic " + given.topic().topic + ", origin " + std::string(header.origin) + ", sequence " +
                            std::to_string(header.sequence) + ", " + count.refusal.where;
      continue;
    }
    if (is_csv(config) && !runs.empty()) {
      bytes.pop_back();
      for (const char c : "," + std::to_string(given.run())) bytes.push_back(static_cast<std::byte>(c));
    }
    if (codec.is_text() && (bytes.empty() || bytes.back() != std::byte{'\n'})) bytes.push_back(std::byte{'\n'});
    ++count.rows;
    if (bytes.size() < flush_bytes) continue;
    flush();
    tell(config, before, count.rows, header.time);
  }
  write_head(nullptr);
  flush();
  if (!out.flush()) cannot_write(path);
  return count;
}

/// The topics and descriptions that a filter takes and that have rows; when none has, those that it takes.
std::vector<RecordedTopic> taken_topics(const Recording& recording, const RowFilter& filter) {
  if (!is_topic_pattern(filter.topic)) {
    throw SetupError({Errc::bad_name, "cannot export", "topic " + filter.topic, "it is neither a topic nor a pattern",
                      "write room/climate, room/+ or room/#"});
  }
  auto topics = recording.topics().or_throw();
  std::vector<RecordedTopic> taken, empty;
  for (RecordedTopic& topic : topics) {
    if (!topic_matches(filter.topic, topic.topic)) continue;
    auto statement = recording.file()->prepare("SELECT 1 FROM " + sqlite::quoted(topic.table) + " t WHERE " +
                                               (filter.run ? "t.run = " + std::to_string(*filter.run) : "1") +
                                               " LIMIT 1");
    if (statement.step()) {
      taken.push_back(std::move(topic));
    } else {
      if (!empty.empty() && empty.back().topic == topic.topic) empty.pop_back();  // the last description is the one
      empty.push_back(std::move(topic));
    }
  }
  return taken.empty() ? empty : taken;
}

/// Where the rows of one description go.
std::filesystem::path file_of(const RecordedTopic& topic, const Codec& codec, const std::string& folder) {
  std::filesystem::path path(folder);
  for (const auto& segment : std::filesystem::path(topic.topic)) {
    if (segment == "." || segment == "..") {
      throw SetupError({Errc::bad_name, "cannot export into a folder", "topic " + topic.topic,
                        "its name would leave the folder", "export it by itself"});
    }
    path /= segment;
  }
  if (topic.version > 1) path += "~" + std::to_string(topic.version);
  path += "." + std::string(codec.extension());
  return path;
}

void look_for_files(const std::vector<std::filesystem::path>& paths) {
  const auto exists = [](const std::filesystem::path& path) {
    std::error_code ignored;
    return std::filesystem::exists(std::filesystem::symlink_status(path, ignored));
  };
  const auto first = std::find_if(paths.begin(), paths.end(), exists);
  if (first == paths.end()) return;
  const auto others = std::count_if(first + 1, paths.end(), exists);
  throw SetupError({Errc::bad_argument, "cannot export into the folder", first->string(),
                    others == 0 ? "the file exists"
                                : "the file exists, and so " + std::string(others == 1 ? "does " : "do ") +
                                      std::to_string(others) + " more",
                    "choose another folder, or have them replaced (--overwrite)"});
}

}  // namespace

Result<ExportCount> export_rows(const Recording& recording, const ExportConfig& config, std::ostream& out) try {
  auto codec = codec_of(config, CodecRegistry::standard());
  const detail::Snapshot snapshot(recording.file());
  auto topics = taken_topics(recording, config.filter);
  if (is_csv(config) && topics.size() > 1) {
    const bool is_one_topic = topics.front().topic == topics.back().topic;
    std::string names;
    for (std::size_t i = 0; i < topics.size() && i < 5; ++i) names += (i == 0 ? "" : ", ") + topics[i].topic;
    if (topics.size() > 5) names += ", ...";
    throw SetupError(
        {Errc::bad_argument, "cannot export to one CSV text", recording.path(),
         is_one_topic
             ? "the fields of " + topics.front().topic + " changed between runs"
             : "one CSV text can hold only one topic, and " + std::to_string(topics.size()) + " were chosen: " + names,
         is_one_topic ? "choose a run, or export into a folder" : "choose a topic, or export into a folder"});
  }
  auto runs = named_runs(recording, config);
  return write_rows(recording, config, runs, is_csv(config) && !topics.empty() ? &topics.front() : nullptr, *codec, out,
                    "standard output");
} catch (const SetupError& error) {
  return error.error();
}

Result<std::vector<ExportCount>> export_files(const Recording& recording, const ExportConfig& config,
                                              const std::string& folder, const CodecRegistry& registry) try {
  auto codec = codec_of(config, registry);
  const detail::Snapshot snapshot(recording.file());
  auto topics = taken_topics(recording, config.filter);
  std::vector<std::filesystem::path> paths;
  for (const RecordedTopic& topic : topics) {
    auto path = file_of(topic, *codec, folder);
    paths.push_back(std::move(path));
  }
  if (config.existing == ExportConfig::Existing::refuse) look_for_files(paths);
  auto runs = named_runs(recording, config);
  std::vector<ExportCount> counts;
  std::uint64_t before = 0;
  for (std::size_t i = 0; i < topics.size(); ++i) {
    const RecordedTopic& topic = topics[i];
    const std::filesystem::path& path = paths[i];
    std::error_code failed;
    std::filesystem::create_directories(path.parent_path(), failed);
    if (failed)
      throw SetupError(
          system_error(failed.value(), "cannot make the folder", path.parent_path().string(), "check its permissions"));
    errno = 0;
    std::ofstream file(path, std::ios::binary | std::ios::trunc);
    if (!file) cannot_write(path.string());
    ExportCount written;
    try {
      written = write_rows(recording, config, runs, &topic, *codec, file, path.string(), before);
    } catch (const SetupError&) {
      // The file is incomplete; for a damaged recording it has the rows before the damage.
      if (!file && std::filesystem::is_regular_file(path, failed)) std::filesystem::remove(path, failed);
      throw;
    }
    written.path = path.string();
    before += written.rows;
    counts.push_back(std::move(written));
  }
  return counts;
} catch (const SetupError& error) {
  return error.error();
}

}  // namespace rtdata
