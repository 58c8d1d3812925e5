#include "sinks/file/rotation.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstdio>
#include <filesystem>
#include <iterator>
#include <vector>

namespace rtdata::detail {
namespace {

constexpr std::size_t least_digits = 8;

struct Parts {
  std::filesystem::path folder;
  std::string stem, extension;
};

Parts parts_of(const std::string& path) {
  const std::filesystem::path whole(path);
  return {whole.parent_path(), whole.stem().string(), whole.extension().string()};
}

/// The number in "run-00000001.csv"; 0: it is not one of ours.
std::uint64_t number_in(const std::string& name, const Parts& parts) {
  const std::string start = parts.stem + "-";
  if (name.size() < start.size() + least_digits + parts.extension.size() || !name.starts_with(start) ||
      !name.ends_with(parts.extension)) {
    return 0;
  }
  const char* const begin = name.data() + start.size();
  const char* const end = name.data() + name.size() - parts.extension.size();
  std::uint64_t number = 0;
  const auto read = std::from_chars(begin, end, number);
  return read.ec == std::errc{} && read.ptr == end ? number : 0;
}

/// True if the file was made for a name that it did not get, because the program was killed in between.
bool is_left_over(const std::string& path) {
  struct stat about {};
  return ::lstat(path.c_str(), &about) == 0 && S_ISREG(about.st_mode) && about.st_size == 0 &&
         (about.st_mode & 07777) == 0 && about.st_uid == ::geteuid();
}

/// Removes a file that no process writes.
Result<bool> remove_unless_held(const std::string& path) {
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOCTTY | O_NONBLOCK | O_NOFOLLOW);
  if (fd < 0) return false;
  const bool is_free = ::flock(fd, LOCK_EX | LOCK_NB) == 0;
  const int reason = is_free && ::unlink(path.c_str()) != 0 ? errno : 0;
  ::close(fd);
  if (reason != 0) return system_error(reason, "cannot remove the oldest file", path, "");
  return is_free;
}

std::int64_t period_of(std::int64_t time, Duration length) {
  const std::int64_t whole = time / length.count();
  return time % length.count() < 0 ? whole - 1 : whole;
}

}  // namespace

std::string Rotation::mistake(const FileConfig& config) {
  const FileRotation& rotate = config.rotate;
  if (rotate.bytes && *rotate.bytes < FileRotation::least_bytes)
    return "`rotate.bytes` is less than " + std::to_string(FileRotation::least_bytes);
  if (rotate.time && *rotate.time < FileRotation::least_time) return "`rotate.time` is less than 1 s";
  if (config.keep != 0 && !rotate.is_on()) return "`keep` needs `rotate`: without it there is only one file";
  return "";
}

Rotation::Rotation(const FileConfig& config) : config_(config) {
  if (const std::string wrong = mistake(config); !wrong.empty())
    throw SetupError({Errc::bad_argument, "cannot make file sink", config.path, wrong, "see `rotate` and `keep`"});
}

std::string Rotation::name(const std::string& path, std::uint64_t number) {
  const Parts parts = parts_of(path);
  std::string digits = std::to_string(number);
  if (digits.size() < least_digits) digits.insert(0, least_digits - digits.size(), '0');
  return (parts.folder / (parts.stem + "-" + digits + parts.extension)).string();
}

bool Rotation::is_numbered(const std::string& path, const std::string& other) {
  const Parts parts = parts_of(path);
  const std::filesystem::path whole(other);
  return whole.parent_path() == parts.folder && number_in(whole.filename().string(), parts) != 0;
}

std::map<std::uint64_t, std::string> Rotation::numbered(const std::string& path) {
  const Parts parts = parts_of(path);
  std::map<std::uint64_t, std::string> found;
  std::error_code ignored;
  const std::filesystem::path folder = parts.folder.empty() ? std::filesystem::path(".") : parts.folder;
  for (std::filesystem::directory_iterator entry(folder, ignored), end; entry != end; entry.increment(ignored)) {
    const std::string name = entry->path().filename().string();
    if (const std::uint64_t number = number_in(name, parts); number != 0)
      found[number] = (parts.folder / name).string();
    if (ignored) break;
  }
  return found;
}

std::uint64_t Rotation::last_number(const std::string& path) {
  auto files = numbered(path);
  if (!files.empty() && is_left_over(files.rbegin()->second) && ::unlink(files.rbegin()->second.c_str()) == 0)
    files.erase(std::prev(files.end()));
  return files.empty() ? 0 : files.rbegin()->first;
}

Result<void> Rotation::set_aside(OutputFile& file) {
  return file.go_on_as_new(name(file.path(), last_number(file.path()) + 1));
}

void Rotation::tell(const Error& error) {
  if (!std::exchange(is_in_trouble_, true)) trouble_ = error.text();
}

void Rotation::remove_old(const std::string& path) {
  if (config_.keep == 0) return;
  auto files = numbered(path);
  for (auto oldest = files.begin(); files.size() > config_.keep && oldest != files.end();) {
    auto removed = remove_unless_held(oldest->second);
    if (!removed) tell(removed.error());
    oldest = files.erase(oldest);
  }
}

Result<void> Rotation::see_to(OutputFile& file, std::size_t index, std::size_t from, Time time) {
  if (states_.size() <= index) states_.resize(index + 1);
  State& state = states_[index];
  const FileRotation& rotate = config_.rotate;
  const bool is_by_time = rotate.time.has_value();
  const std::int64_t period = is_by_time ? period_of(to_nanoseconds(time), *rotate.time) : 0;
  const bool has_events = file.has_events(file.size_with(from));
  if (!state.is_known) {
    state.is_known = true;
    state.period = is_by_time && has_events && from == 0 ? period_of(file.changed_at(), *rotate.time) : period;
  } else if (!has_events) {
    state.period = std::max(state.period, period);
  }
  if (!file.is_new(from) || !has_events) return {};
  const bool is_over = is_by_time && period > state.period;
  const bool is_full = rotate.bytes && file.size_with(file.buffer.size()) > *rotate.bytes;
  if (!is_over && !is_full) return {};
  const std::vector<std::byte> event(file.buffer.begin() + static_cast<std::ptrdiff_t>(from), file.buffer.end());
  file.buffer.resize(from);
  auto done = file.write_out();
  if (done && config_.sync != FileSync::never) done = file.sync();
  if (done) {
    state.last_number = std::max(state.last_number, last_number(file.path()));
    if (auto renamed = file.go_on_as_new(name(file.path(), state.last_number + 1)); renamed) {
      ++state.last_number;
      is_in_trouble_ = false;
      remove_old(file.path());
      state.period = period;
    } else {
      tell(renamed.error());  // the file continues to grow, so that no event is lost
    }
  }
  // A write that failed comes again with its batch.
  if (done) file.buffer.insert(file.buffer.end(), event.begin(), event.end());
  return done;
}

}  // namespace rtdata::detail
