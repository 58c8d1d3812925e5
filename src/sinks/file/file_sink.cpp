#include "rtdata/sinks/file.hpp"

#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <climits>
#include <filesystem>
#include <map>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "data/permissions.hpp"
#include "data/setting_mistake.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/data/problem.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/sinks/recording_writer.hpp"
#include "sinks/core/escaped_texts.hpp"
#include "sinks/file/output_file.hpp"
#include "sinks/file/rotation.hpp"

namespace rtdata {

using detail::EscapedTexts;
using detail::OutputFile;
using detail::Rotation;

namespace {

constexpr std::string_view topic_mark = "{topic}";
constexpr std::string_view date_mark = "{date}";
constexpr std::string_view run_mark = "{run}";
constexpr std::size_t piece_bytes = std::size_t{1} << 20;  // a batch is written in pieces of this size

std::string replaced(std::string path, std::string_view mark, std::string_view part) {
  for (std::size_t at = path.find(mark); at != std::string::npos; at = path.find(mark, at + part.size()))
    path.replace(at, mark.size(), part);
  return path;
}

std::string path_of(const std::string& path, std::string_view topic) {
  std::string part(topic);
  std::replace(part.begin(), part.end(), '/', '-');
  return replaced(path, topic_mark, part);
}

/// One more than the largest number in a file's name at the place of the mark in the path, for any topic.
std::uint64_t next_run(const std::filesystem::path& path) {
  const std::string name = path.filename().string();
  const std::string before = name.substr(0, name.find(run_mark));
  const std::size_t topic = before.find(topic_mark);
  const std::string begin = before.substr(0, topic);
  const std::string behind = topic == std::string::npos ? "" : before.substr(topic + topic_mark.size());
  std::uint64_t last = 0;
  std::error_code failed;  // opening a file reports what is wrong
  const std::filesystem::path folder = path.has_parent_path() ? path.parent_path() : ".";
  for (std::filesystem::directory_iterator entry(folder, failed), end; entry != end; entry.increment(failed)) {
    const std::string there = entry->path().filename().string();
    if (!there.starts_with(begin)) continue;
    for (std::size_t at = there.find(behind, begin.size()); at != std::string::npos; at = there.find(behind, at + 1)) {
      std::uint32_t number = 0;  // a larger number is not in a name that this sink gave
      std::from_chars(there.data() + at + behind.size(), there.data() + there.size(), number);
      last = std::max<std::uint64_t>(last, number);
      if (topic == std::string::npos) break;
    }
    if (failed) break;
  }
  return last + 1;
}

/// The path of this run: all but the topic is in it. Blocks on the disk.
std::string path_of_run(const std::string& pattern) {
  const std::string today = to_iso8601(wall_clock_now()).substr(0, 10);
  const std::string path = replaced(pattern, date_mark, today);
  if (path.find(run_mark) == std::string::npos) return path;
  return replaced(path, run_mark, std::to_string(next_run(path)));
}

/// True if the path is too long for every Linux file system. Does not access the disk, which might hold the loop.
bool is_too_long(std::string_view path) noexcept {
  if (path.size() >= PATH_MAX) return true;
  while (!path.empty()) {
    const std::size_t end = std::min(path.find('/'), path.size());
    if (end > NAME_MAX) return true;
    path.remove_prefix(std::min(end + 1, path.size()));
  }
  return false;
}

/// A file holds one topic: this one, unless there is another already, or the topic makes its name too long.
Result<void> take_path(std::map<std::string, std::string>& topic_by_path, const std::string& pattern,
                       const std::string& path, std::string_view topic) {
  if (is_too_long(path)) {
    return Error{Errc::bad_argument, "cannot record topic " + std::string(topic), path,
                 "the name of its file is too long", "choose a shorter `path`, or give it a sink of its own"};
  }
  const auto [other, is_new] = topic_by_path.try_emplace(path, topic);
  if (is_new || other->second == topic) return {};
  const bool is_pattern = pattern.find(topic_mark) != std::string::npos;
  return Error{Errc::bad_argument, "cannot record topic " + std::string(topic), path,
               (is_pattern ? "the file holds topic " : "a file has the columns of one topic, here ") + other->second,
               is_pattern ? "give one of them a sink of its own" : "write {topic} into the path: a file each"};
}

class FileWriter final : public RecordingWriter {
 public:
  FileWriter(const FileConfig& config, std::unique_ptr<Codec> codec, std::unique_ptr<Codec> header_codec)
      : config_(config),
        codec_(std::move(codec)),
        header_codec_(std::move(header_codec)),
        is_text_(codec_->is_text()),
        permissions_(detail::permissions_of(config.permissions, config.path).or_throw()),
        is_pattern_(config.path.find(topic_mark) != std::string::npos),
        rotation_(config) {
    if (config_.path.empty()) {
      throw SetupError({Errc::bad_argument, "cannot make file sink", "", "`path` is empty", "name a file"});
    }
    if (!is_pattern_) files_.emplace_back();
  }

  Opening opening() const override { return Opening::at_set_up; }

  Result<void> add_topic(std::uint32_t number, std::string_view topic, const Description& description) override {
    const std::string path = path_of(config_.path, topic);
    const std::string header = header_codec_->header(description);
    if (is_pattern_ || !header.empty()) {
      if (auto taken = take_path(topic_by_path_, config_.path, path, topic); !taken) return taken;
    }
    const std::lock_guard lock(known_mutex_);
    if (!is_opened_) known_.push_back({number, std::string(topic), header});
    return {};
  }

  /// Opens the files of all present topics, so that errors are reported at the start. Later, a topic's file is opened
  /// for its next event, and its errors do not affect other topics.
  Result<void> open() override {
    if (is_opened_) return {};
    if (path_.empty()) path_ = path_of_run(config_.path);
    if (!is_pattern_) {
      if (auto opened = open(files_.front(), path_); !opened) return opened;
    } else if (const auto directory = std::filesystem::path(config_.path).parent_path();
               !directory.empty() && !std::filesystem::is_directory(directory)) {
      return Error{Errc::not_found, "cannot make file sink", config_.path,
                   "there is no directory " + directory.string(), "make it first"};
    }
    std::vector<KnownTopic> known;
    {
      const std::lock_guard lock(known_mutex_);
      known.swap(known_);
      is_opened_ = true;
    }
    for (const KnownTopic& topic : known) {
      if (auto ready = prepare(topic.number, path_of(path_, topic.name), topic.header); !ready) return ready;
    }
    return {};
  }

  Result<void> write(Batch& batch) override {
    for (OutputFile& file : files_) {
      switch (file.close_if_gone()) {
        case OutputFile::Gone::no:
          continue;
        case OutputFile::Gone::deleted:
          return Error{Errc::not_found, "the file was deleted", file.path(), "the data written into it is lost with it",
                       "a new one is made"};
        case OutputFile::Gone::unmounted:
          return Error{Errc::not_found, "the disk of the file was removed", file.path(),
                       "the disk is no longer mounted there", "mount it again: events wait in memory until then"};
        case OutputFile::Gone::moved:
          return Error{Errc::not_found, "the file was moved", file.path(),
                       "the data written into it is in the moved file", "a new one is made"};
        case OutputFile::Gone::cut_off:
          return Error{Errc::damaged, "the file was cut off", file.path(),
                       "the file is shorter than the data written into it: the rest is lost, unless there is a copy",
                       "the sink continues at the end of the file; `rotate` divides files without a loss"};
      }
    }
    for (OutputFile& file : files_) file.begin_batch();
    escaped_.begin_batch();
    for (const Record& record : batch) {
      const std::uint32_t number = record.info->topic_number;
      if (!is_ready(number)) {
        if (const auto untaken = untaken_.find(number); untaken != untaken_.end()) {
          batch.refuse_topic(record, untaken->second);
          continue;
        }
        auto done = prepare(number, path_of(path_, record.info->topic), codec_->header(*record.info->description));
        if (!done && is_for_good(done.error())) {
          batch.refuse_topic(record, untaken_.emplace(number, done.error()).first->second);
          continue;
        }
        if (!done) return done;
      }
      if (!repairs_.empty()) return take_repairs();
      OutputFile& file = files_[by_topic_[number]];
      if (is_text_) escaped_.look_at(record);
      const std::size_t from = file.buffer.size();
      if (auto encoded = codec_->encode(record.view(), file.buffer); !encoded) {
        batch.refuse(record, encoded.error());
      } else if (rotation_.is_on()) {
        if (auto done = rotation_.see_to(file, by_topic_[number], from, record.header.time); !done) return done;
      }
      if (file.buffer.size() < piece_bytes) continue;
      if (auto done = file.write_out(); !done) return done;
    }
    for (OutputFile& file : files_) {
      if (auto done = file.write_out(); !done) return done;
    }
    if (config_.sync == FileSync::batch) {
      if (auto done = sync_files(); !done) return done;
    }
    for (OutputFile& file : files_) file.end_batch();
    escaped_.end_batch(batch);
    return {};
  }

  std::optional<Error> take_warning() override {
    if (!repairs_.empty()) return take_repairs();
    if (std::string trouble = rotation_.take_trouble(); !trouble.empty()) {
      return Error{Errc::io_failed, "files are not rotated as set", config_.path, std::move(trouble),
                   "the file continues to grow; rotation is tried again with each event"};
    }
    std::optional<Error> warning = escaped_.take_warning();
    if (!is_closed_ || escaped_.total() <= 1 || std::exchange(has_reported_total_, true)) return warning;
    if (!warning) warning = Error{Errc::bad_data, "", config_.path, "their wrong bytes are written as \\xHH", ""};
    warning->what = std::to_string(escaped_.total()) + " texts were not UTF-8";
    return warning;
  }

  Result<void> close() override {
    Result<void> done;
    if (config_.sync != FileSync::never) done = sync_files();
    if (!done) return done;
    for (OutputFile& file : files_) file.close();
    is_closed_ = true;
    return {};
  }

 private:
  static constexpr std::size_t none = static_cast<std::size_t>(-1);
  struct KnownTopic {
    std::uint32_t number;
    std::string name;
    std::string header;
  };

  /// Reports repairs at the ends of files since the last call.
  Error take_repairs() {
    std::string all;
    for (const std::string& repair : repairs_) all += (all.empty() ? "" : "; ") + repair;
    repairs_.clear();
    return Error{Errc::damaged, "an event was cut off", config_.path, all, "the previous run did not end properly"};
  }

  /// True if the error is permanent (the file exists with other content): waiting does not help.
  static bool is_for_good(const Error& error) {
    return error.code == Errc::description_differs || error.code == Errc::damaged || error.code == Errc::bad_argument;
  }

  bool is_ready(std::uint32_t number) const noexcept {
    return number < by_topic_.size() && by_topic_[number] != none && files_[by_topic_[number]].is_open();
  }

  Result<void> open(OutputFile& file, const std::string& path) {
    if (file.is_open()) return {};
    if (auto done = file.open(path, permissions_); !done) return done;
    std::string repair;
    auto done = file.repair(*codec_, repair);
    if (!done) file.close();
    if (!repair.empty()) repairs_.push_back(path + ": " + repair);
    return done;
  }

  /// Makes sure that the topic has an open file with this header.
  Result<void> prepare(std::uint32_t number, const std::string& path, const std::string& header) {
    if (by_topic_.size() <= number) by_topic_.resize(number + 1, none);
    if (by_topic_[number] == none) {
      if (is_pattern_) files_.emplace_back();
      by_topic_[number] = files_.size() - 1;
    }
    OutputFile& file = files_[by_topic_[number]];
    if (auto done = open(file, path); !done) return done;
    if (file.has_begun()) return {};
    Result<void> done;
    if (!rotation_.is_on() && file.holds_earlier_run(header)) done = Rotation::set_aside(file);
    if (done) done = file.begin(header);
    if (!done) {
      file.close();
      return done;
    }
    file.begin_batch();
    return {};
  }

  Result<void> sync_files() {
    for (OutputFile& file : files_) {
      if (auto done = file.sync(); !done) return done;
    }
    return {};
  }

  const FileConfig config_;
  std::unique_ptr<Codec> codec_;         // for all files
  std::unique_ptr<Codec> header_codec_;  // loop
  const bool is_text_;                   // texts that are not UTF-8 are escaped, and reported
  const mode_t permissions_;
  const bool is_pattern_;
  // loop
  std::map<std::string, std::string> topic_by_path_;
  // both
  std::mutex known_mutex_;
  std::vector<KnownTopic> known_;  // before it was opened
  bool is_opened_ = false;         // changed with the mutex
  // lane
  std::string path_;  // of this run
  Rotation rotation_;
  std::vector<OutputFile> files_;
  std::vector<std::size_t> by_topic_;
  std::vector<std::string> repairs_;
  std::map<std::uint32_t, Error> untaken_;  // topics whose files exist with other content
  EscapedTexts escaped_;
  bool is_closed_ = false;
  bool has_reported_total_ = false;
};

std::string codec_name(const FileConfig& config, const CodecRegistry& formats) {
  const std::string format = format_of(config);
  return format == "jsonl" && formats.find("jsonl") == nullptr ? "json" : format;
}

std::unique_ptr<Writer> make_writer(const FileConfig& config, const CodecRegistry& formats) {
  for (const std::string_view mark : {topic_mark, date_mark, run_mark}) {
    const std::size_t at = config.path.find(mark);
    if (at == std::string::npos || config.path.find('/', at) == std::string::npos) continue;
    throw SetupError({Errc::bad_argument, "cannot make file sink", config.path,
                      std::string(mark) + " is in the name of a directory", "put it into the file's name"});
  }
  const std::string format = codec_name(config, formats);
  auto codec = formats.make(format).or_throw();
  return std::make_unique<FileWriter>(config, std::move(codec), formats.make(format).or_throw());
}

SinkConfig with_name(const FileConfig& config) {
  SinkConfig sink = config.sink;
  if (sink.name.empty()) sink.name = std::filesystem::path(config.path).filename().string();
  return sink;
}

}  // namespace

std::vector<Error> refused_topics(const FileConfig& config, std::span<const TopicToRecord> topics,
                                  const CodecRegistry& formats) {
  std::vector<Error> refused;
  auto codec = formats.make(codec_name(config, formats));
  if (!codec) return refused;
  const bool is_pattern = config.path.find(topic_mark) != std::string::npos;
  std::map<std::string, std::string> topic_by_path;
  for (const TopicToRecord& topic : topics) {
    const std::string header = topic.description != nullptr ? (*codec)->header(*topic.description) : "";
    if (!is_pattern && header.empty()) continue;
    const std::string path = path_of(config.path, topic.name);
    Result<void> taken = take_path(topic_by_path, config.path, path, topic.name);
    if (taken && is_pattern) taken = OutputFile::check_content(path, **codec);
    if (taken && !header.empty() && config.rotate.is_on()) taken = OutputFile::check_header(path, header);
    if (!taken) refused.push_back(std::move(taken).error());
  }
  return refused;
}

std::string format_of(const FileConfig& config) {
  if (!config.format.empty()) return config.format;
  std::string ending = std::filesystem::path(config.path).extension();
  for (char& c : ending) c = c >= 'A' && c <= 'Z' ? static_cast<char>(c | 0x20) : c;
  return ending == ".csv" ? "csv" : ending == ".cbor" ? "cbor" : "jsonl";
}

std::string file_of_topic(const FileConfig& config, std::string_view topic) { return path_of(config.path, topic); }

bool is_companion_file(const FileConfig&, const std::string& file, const std::string& other) {
  return (other.starts_with(file) && std::string_view(other).substr(file.size()) == ".half") ||
         Rotation::is_numbered(file, other);
}

Result<void> check_openable(const FileConfig& config, const std::string& file) {
  auto openable = OutputFile::check_openable(file);
  std::error_code absent;
  const bool is_set_aside = !config.rotate.is_on() && std::filesystem::file_size(file, absent) > 0 && !absent;
  if (!openable || !is_set_aside) return openable;
  const std::string folder = std::filesystem::canonical(file, absent).parent_path().string();
  if (absent || ::access(folder.c_str(), W_OK | X_OK) == 0) return {};
  return Error{Errc::not_permitted, "cannot begin a new file", file,
               "an earlier run wrote this file, and no new file can be made in " + folder,
               "choose a folder where this user may write"};
}

void check_config(const FileConfig& config, const ConfigItem& item, Problems& problems) {
  const auto codec = CodecRegistry::standard().make(codec_name(config, CodecRegistry::standard()));
  const bool is_pattern = config.path.find(topic_mark) != std::string::npos;  // see `refused_topics`
  if (const auto fits = codec && !is_pattern ? OutputFile::check_content(config.path, **codec) : Result<void>{};
      !fits) {
    const Error& error = fits.error();
    problems.add(detail::item_of(item, "path").problem("cannot-record", error.why + "; " + error.advice));
  }
  detail::add_mistake({config.keep != 0 ? "keep" : "rotate", Rotation::mistake(config)}, item, problems);
}

FileSink::FileSink(Loop& loop, FileConfig config, const CodecRegistry& formats)
    : Sink(loop, with_name(config), make_writer(config, formats)) {}

}  // namespace rtdata
