#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <climits>
#include <cstring>
#include <filesystem>
#include <system_error>

#include "data/first_line.hpp"
#include "data/sqlite_magic.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "recording/recording_lock.hpp"
#include "recording/schema.hpp"
#include "recording/sqlite_writer.hpp"
#include "recording/topic_table.hpp"
#include "rtdata/recording/sqlite.hpp"

namespace rtdata {
namespace {

constexpr Duration card_batch_time = std::chrono::seconds{10};

SinkConfig named(const SqliteConfig& config) {
  SinkConfig sink = config.sink;
  if (sink.name.empty()) sink.name = config.path;
  sink.batch_time = batch_time(config);
  return sink;
}

std::unique_ptr<Writer> make_writer(Loop& loop, const SqliteConfig& config) {
  detail::RuntimeCore& runtime = loop.runtime().core();
  return std::make_unique<sqlite::SqliteWriter>(
      config, sqlite::RunInfo{runtime.main().uuid_for_recording(), runtime.config.name, runtime.config.notes,
                              runtime.configurations.whole(), runtime.clock().boot_id(),
                              runtime.exchange.begins_at(loop.time()),
                              runtime.clock_log.start().realtime.time_since_epoch() -
                                  runtime.clock_log.start().monotonic.time_since_epoch(),
                              ::getpid()});
}

}  // namespace

namespace sqlite {

/// Reads the first bytes of a file through SQLite: closing the file directly would drop the fcntl locks of SQLite in
/// the same process.
static bool read_head(const std::string& path, void* head, int size) try {
  const auto database = Database::open(path, Database::Mode::read);
  sqlite3_file* file = nullptr;
  return sqlite3_file_control(database.raw(), "main", SQLITE_FCNTL_FILE_POINTER, &file) == SQLITE_OK &&
         file != nullptr && file->pMethods != nullptr && file->pMethods->xRead(file, head, size, 0) == SQLITE_OK;
} catch (const SetupError&) {  // opening it says why
  return false;
}

Result<void> check_path(const std::string& path) {
  constexpr std::string_view longest_ending = "-journal";
  const auto refuse = [&](std::string why, const char* advice) {
    return Error{Errc::bad_argument, "cannot record into", path, std::move(why), advice};
  };
  if (path == ":memory:" || path.starts_with("file:"))
    return refuse("to SQLite this is not a path of a file", "write ./ before it, or choose another path");
  std::error_code failed;
  const std::filesystem::path whole = std::filesystem::absolute(path, failed);
  const long limit = ::pathconf(whole.parent_path().c_str(), _PC_NAME_MAX);
  const std::size_t longest_name = limit > 0 ? static_cast<std::size_t>(limit) : NAME_MAX;
  if (whole.filename().native().size() + longest_ending.size() > longest_name)
    return refuse("its name is longer than " + std::to_string(longest_name - longest_ending.size()) + " bytes",
                  "choose a shorter one");
  const sqlite3_vfs* files = ::sqlite3_vfs_find(nullptr);
  const auto longest_path = static_cast<std::size_t>(files != nullptr ? files->mxPathname : PATH_MAX);
  if (std::filesystem::weakly_canonical(whole, failed).native().size() + longest_ending.size() > longest_path)
    return refuse(
        "it is longer, with its folders, than " + std::to_string(longest_path - longest_ending.size()) + " bytes",
        "choose a shorter one");
  struct stat about {};
  if (::stat(path.c_str(), &about) == 0 && S_ISREG(about.st_mode) && about.st_nlink > 1) {
    return Error{Errc::not_permitted, "cannot record into", path,
                 "it has several names (hard links), and its newest data may lie beside another one, in its -wal file",
                 "remove all names but the one with a -wal file beside it, or record into another file"};
  }
  return {};
}

}  // namespace sqlite

Duration batch_time(const SqliteConfig& config) {
  return config.profile == SqliteProfile::card ? std::max<Duration>(config.sink.batch_time, card_batch_time)
                                               : config.sink.batch_time;
}

std::vector<Error> refused_topics(const SqliteConfig&, std::span<const TopicToRecord> topics) {
  std::vector<Error> refused;
  for (const TopicToRecord& topic : topics) {
    if (topic.description == nullptr) continue;
    if (auto fits = sqlite::check_columns(topic.name, *topic.description); !fits)
      refused.push_back(std::move(fits).error());
  }
  return refused;
}

bool is_companion_file(const SqliteConfig&, const std::string& file, const std::string& other) {
  if (!other.starts_with(file)) return false;
  const std::string_view ending = std::string_view(other).substr(file.size());
  return std::find(sqlite::companion_endings.begin(), sqlite::companion_endings.end(), ending) !=
         sqlite::companion_endings.end();
}

Result<void> check_recordable(const std::string& path) {
  if (auto is_path = sqlite::check_path(path); !is_path) return is_path;
  std::array<unsigned char, 100> head{};
  struct stat about {};
  if (::stat(path.c_str(), &about) != 0 || !S_ISREG(about.st_mode) || about.st_size == 0) return {};  // opening tells
  const auto got = std::min(about.st_size, static_cast<off_t>(head.size()));
  if (!sqlite::read_head(path, head.data(), static_cast<int>(got))) return {};
  const auto number_at = [&](std::size_t at) {
    std::uint32_t number = 0;
    for (std::size_t i = 0; i < 4; ++i) number = number << 8 | head[at + i];
    return number;
  };
  const auto refuse = [&](Errc code, std::string why, const char* advice) {
    return Error{code, "cannot record into", path, std::move(why), advice};
  };
  if (got < static_cast<off_t>(head.size()) ||
      std::memcmp(head.data(), detail::sqlite_magic.data(), detail::sqlite_magic.size()) != 0)
    return refuse(Errc::not_a_recording, "it is not an SQLite file", "choose another path");
  struct stat log {};
  if (::stat((path + "-wal").c_str(), &log) == 0 && log.st_size > 0) return {};  // the newest data is in there
  const std::uint32_t page = number_at(14) & 0xffff;                             // 1 means 65536
  const bool may_be_empty = about.st_size <= static_cast<off_t>(page == 1 ? 65536 : page);
  const std::uint32_t id = number_at(68);
  if (id == sqlite::application_id_before)
    return refuse(Errc::not_a_recording, sqlite::written_before, sqlite::advice_before);
  if (id != sqlite::application_id && (id != 0 || !may_be_empty))
    return refuse(Errc::not_a_recording, "it is another program's SQLite database", "choose another path");
  if (id == sqlite::application_id && number_at(60) > sqlite::schema_version)
    return refuse(Errc::newer_version,
                  "a newer version wrote it (format " + std::to_string(number_at(60)) + ", this one knows " +
                      std::to_string(sqlite::schema_version) + ")",
                  "update rt-data, or choose another path");
  return {};
}

Result<void> check_openable(const SqliteConfig&, const std::string& file) {
  if (auto recordable = check_recordable(file); !recordable) return recordable;
  std::error_code failed;
  const std::filesystem::path real = std::filesystem::canonical(file, failed);
  if (failed) return {};  // there is none, or opening it tells
  return sqlite::RecordingLock::check_free(real.string());
}

SqliteSink::SqliteSink(Loop& loop, SqliteConfig config) : Sink(loop, named(config), make_writer(loop, config)) {}

}  // namespace rtdata
