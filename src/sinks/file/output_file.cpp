#include "sinks/file/output_file.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <span>
#include <utility>

#include "data/sqlite_magic.hpp"
#include "data/utf8.hpp"
#include "sinks/core/lock_holder.hpp"

namespace rtdata::detail {
namespace {

constexpr std::size_t window_bytes = std::size_t{1} << 20;

/// Line ends divide the events, whatever is between them.
bool is_by_lines(const Codec& codec) {
  constexpr std::array lines{std::byte{'"'}, std::byte{'\n'}};
  return codec.first_event(lines) == lines.size();
}

/// Nearly any bytes are items of CBOR: an event is one that begins so.
bool is_another_cbor(const Codec& codec, std::span<const std::byte> begin) {
  if (codec.name() != "cbor" || begin.empty()) return false;
  constexpr std::string_view key("\x65topic");  // the first one of a map of 5, or of 6
  const auto head = static_cast<unsigned>(begin[0]);
  const std::string_view rest(reinterpret_cast<const char*>(begin.data()) + 1, std::min(begin.size() - 1, key.size()));
  return (head != 0xa5 && head != 0xa6) || !key.starts_with(rest);
}

/// True if a file that begins with these bytes (half an event or more) has this format.
bool is_of_format(const Codec& codec, std::vector<std::byte> begin) {
  if (is_another_cbor(codec, begin)) return false;
  begin.resize(begin.size() + window_bytes);
  for (const char end : {'\n', '"', '\n'})
    begin.push_back(static_cast<std::byte>(end));  // of a row, and of an open quote
  return codec.first_event(begin) != 0;
}

Error no_such_format(const std::string& path, const Codec& codec) {
  return {Errc::damaged, "cannot append to", path, "its content is not a valid " + std::string(codec.name()),
          "check `format`, or choose another path"};
}

Error database_there(const std::string& path) {
  return {Errc::bad_argument, "cannot record into", path, "it is a recording, or another SQLite database",
          "choose another path"};
}

Result<void> compare_header(int fd, const std::string& path, const std::string& header) {
  using detail::byte_order_mark;
  std::string there(byte_order_mark.size() + header.size(), '\0');
  const ssize_t got = ::pread(fd, there.data(), there.size(), 0);
  if (got < 0) return system_error(errno, "cannot read the file's header", path, "");
  there.resize(static_cast<std::size_t>(got));
  if (there.starts_with(byte_order_mark)) {  // an editor may have put it there
    there.erase(0, byte_order_mark.size());
  } else if (there.size() > header.size()) {
    there.resize(header.size());
  }
  if (there == header) return {};
  if (got == 0 || (header.starts_with(there) && !there.ends_with('\n'))) return {};  // half a header is moved aside
  there.resize(std::min(there.find('\n'), there.size()));
  return Error{Errc::description_differs, "cannot append to", path,
               "its header is \"" + there + "\", not \"" + header.substr(0, header.find('\n')) + "\"",
               "choose another path"};
}

Error cannot_open(int reason, const std::string& path) {
  if (reason == EISDIR)
    return {Errc::bad_argument, "cannot open the file", path, "it is a directory", "give the name of a file in it"};
  const char* advice = "";
  if (reason == ENOENT) advice = "make its directory first";
  if (reason == EACCES || reason == EPERM || reason == EROFS) advice = "choose a place where this user may write";
  return system_error(reason, "cannot open the file", path, advice);
}

Error no_regular_file(const std::string& path) {
  return {Errc::bad_argument, "cannot record into", path, "it is not a regular file", "give the path of a file"};
}

Error held(const std::string& path, const std::string& holder) {
  return {Errc::busy, "cannot record into", path, holder + " writes it", "stop that one, or choose another path"};
}

/// Where the disk of the file's folder is mounted; empty: at the root, or not to be found out.
std::string mount_point_of(const std::string& path) {
  std::error_code failed;
  std::filesystem::path at = std::filesystem::canonical(path, failed).parent_path();
  if (failed) return "";
  struct stat here {};
  struct stat above {};
  if (::stat(at.c_str(), &here) != 0) return "";  // the folder's: that of a file in an overlay may be another
  for (; at.has_relative_path(); at = at.parent_path()) {
    if (::stat(at.parent_path().c_str(), &above) != 0) return "";
    if (above.st_dev != here.st_dev) return at.string();
  }
  return "";
}

}  // namespace

OutputFile::OutputFile(OutputFile&& other) noexcept
    : buffer(std::move(other.buffer)),
      path_(std::move(other.path_)),
      mounted_at_(std::move(other.mounted_at_)),
      permissions_(other.permissions_),
      fd_(std::exchange(other.fd_, -1)),
      size_at_open_(other.size_at_open_),
      header_(std::move(other.header_)),
      header_left_(other.header_left_),
      has_begun_(other.has_begun_),
      has_ever_begun_(other.has_ever_begun_),
      size_(other.size_),
      passed_(other.passed_),
      done_(other.done_),
      done_before_(other.done_before_) {}

OutputFile::~OutputFile() {
  // A batch that was given up counts as lost: removes its part from the file.
  if (fd_ >= 0 && done_ > done_before_) (void)!::ftruncate(fd_, batch_begins());
  close();
}

void OutputFile::close() noexcept {
  if (fd_ >= 0) ::close(fd_);
  fd_ = -1;
}

Error OutputFile::failed(int errno_value, const char* what) const { return system_error(errno_value, what, path_, ""); }

Result<void> OutputFile::open(const std::string& path, mode_t permissions) {
  if (fd_ >= 0) return {};
  // If the path is a symbolic link, its target gets the other name, not the link.
  std::error_code no_link;
  path_ = std::filesystem::is_symlink(path, no_link) ? std::filesystem::canonical(path, no_link).string() : path;
  if (no_link) path_ = path;
  permissions_ = permissions;
  if (is_unmounted()) {  // a new file would be on another disk
    return Error{Errc::not_found, "cannot open the file", path, "what was mounted at " + mounted_at_ + " is not there",
                 "mount it again: events wait in memory until then"};
  }
  // Non-blocking for the sake of a pipe without a reader, which is refused below.
  fd_ = ::open(path.c_str(), O_RDWR | O_APPEND | O_CREAT | O_CLOEXEC | O_NOCTTY | O_NONBLOCK, permissions);
  if (fd_ < 0) return cannot_open(errno, path);
  struct stat about {};
  Result<void> result;
  if (::fstat(fd_, &about) != 0) {
    result = failed(errno, "cannot look at the file");
  } else if (!S_ISREG(about.st_mode)) {
    result = no_regular_file(path);
  } else if (::flock(fd_, LOCK_EX | LOCK_NB) != 0) {
    const int reason = errno;
    result = reason == EWOULDBLOCK ? held(path, lock_holder(about)) : failed(reason, "cannot lock the file");
  }
  if (result && detail::is_sqlite_file(fd_)) {
    result = database_there(path);
  }
  if (result && mounted_at_.empty()) mounted_at_ = mount_point_of(path);
  if (!result) close();
  size_at_open_ = about.st_size;
  passed_ = 0;
  done_ = done_before_;
  has_begun_ = false;
  return result;
}

Result<void> OutputFile::repair(Codec& codec, std::string& what) {
  what.clear();
  if (size_at_open_ == 0) return {};
  if (is_by_lines(codec)) return repair_lines(what);
  std::vector<std::byte> tail;  // from the last event's start on
  for (off_t at = 0;;) {
    const std::size_t kept = tail.size();
    tail.resize(kept + window_bytes);
    const ssize_t got = ::pread(fd_, tail.data() + kept, window_bytes, at);
    if (got < 0) return failed(errno, "cannot read the file");
    tail.resize(kept + static_cast<std::size_t>(got));
    if (at == 0 && is_another_cbor(codec, tail)) return no_such_format(path_, codec);
    if (got == 0) break;
    at += got;
    std::size_t used = 0;
    while (const std::size_t size = codec.first_event(std::span(tail).subspan(used))) used += size;
    tail.erase(tail.begin(), tail.begin() + static_cast<std::ptrdiff_t>(used));
    if (tail.size() > 2 * window_bytes) break;
  }
  if (tail.empty()) return {};
  if (tail.size() > 2 * window_bytes || !is_of_format(codec, tail)) return no_such_format(path_, codec);
  return move_aside(tail, what);
}

Result<void> OutputFile::repair_lines(std::string& what) {
  std::vector<std::byte> tail;  // the end of the file, back to its last line end
  for (off_t begin = size_at_open_; begin > 0;) {
    const auto size = static_cast<std::size_t>(std::min<off_t>(begin, window_bytes));
    begin -= static_cast<off_t>(size);
    std::vector<std::byte> window(size);
    if (::pread(fd_, window.data(), size, begin) != static_cast<ssize_t>(size))
      return failed(errno, "cannot read the file's end");
    const auto last = std::find(window.rbegin(), window.rend(), std::byte{'\n'});
    tail.insert(tail.begin(), last.base(), window.end());
    if (last != window.rend()) break;
    if (tail.size() > 2 * window_bytes) {
      return Error{Errc::damaged, "cannot append to", path_, "its last megabytes have no line end",
                   "check `format`, or choose another path"};
    }
  }
  if (tail.empty()) return {};
  return move_aside(tail, what);
}

Result<void> OutputFile::move_aside(std::span<const std::byte> tail, std::string& what) {
  OutputFile aside;
  aside.path_ = path_ + ".half";
  aside.fd_ = ::open(aside.path_.c_str(), O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC | O_NOCTTY, permissions_);
  if (aside.fd_ < 0) return aside.failed(errno, "cannot move half an event aside");
  for (std::size_t written = 0; written < tail.size();) {
    if (auto done = aside.append(tail.data() + written, tail.size() - written, written); !done) return done;
  }
  size_at_open_ -= static_cast<off_t>(tail.size());
  if (::ftruncate(fd_, size_at_open_) != 0) return failed(errno, "cannot cut half an event off");
  what = "the file ended in half an event, whose " + std::to_string(tail.size()) + " bytes were moved to " +
         aside.path_;
  return {};
}

Result<void> OutputFile::begin(const std::string& header) {
  header_ = header;
  header_left_ = size_at_open_ == 0 ? header.size() : 0;
  size_ = static_cast<std::uint64_t>(size_at_open_);
  has_begun_ = has_ever_begun_ = true;
  if (size_at_open_ == 0 || header.empty()) return {};
  return compare_header(fd_, path_, header);
}

bool OutputFile::holds_earlier_run(const std::string& header) const {
  if (has_ever_begun_ || size_at_open_ == 0) return false;
  return static_cast<std::size_t>(size_at_open_) != header.size() || !compare_header(fd_, path_, header);
}

Result<void> OutputFile::check_header(const std::string& path, const std::string& header) {
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOCTTY | O_NONBLOCK);
  if (fd < 0) return {};  // opening it reports what is wrong
  struct stat about {};
  const bool has_content = ::fstat(fd, &about) == 0 && S_ISREG(about.st_mode) && about.st_size > 0;
  Result<void> same = has_content ? compare_header(fd, path, header) : Result<void>{};
  ::close(fd);
  return same;
}

Result<void> OutputFile::check_content(const std::string& path, const Codec& codec) {
  struct stat about {};
  if (::stat(path.c_str(), &about) != 0 || !S_ISREG(about.st_mode) || about.st_size == 0) return {};
  // The log of one that is open: to open and close that here would drop the locks that SQLite has on it in this
  // process.
  struct stat log {};
  std::error_code failed;
  const std::string real = std::filesystem::canonical(path, failed).string();
  if (::stat((real + "-wal").c_str(), &log) == 0) return database_there(path);
  OutputFile file;
  file.path_ = path;
  file.fd_ = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOCTTY | O_NONBLOCK);
  if (file.fd_ < 0) return {};  // opening it reports what is wrong
  if (detail::is_sqlite_file(file.fd_)) return database_there(path);
  if (is_by_lines(codec)) return {};
  std::vector<std::byte> begin(static_cast<std::size_t>(std::min<off_t>(about.st_size, window_bytes)));
  const ssize_t got = ::pread(file.fd_, begin.data(), begin.size(), 0);
  if (got <= 0) return {};
  begin.resize(static_cast<std::size_t>(got));
  if (!is_of_format(codec, std::move(begin))) return no_such_format(path, codec);
  return {};
}

Result<void> OutputFile::check_openable(const std::string& path) {
  OutputFile file;
  file.fd_ = ::open(path.c_str(), O_RDWR | O_APPEND | O_CLOEXEC | O_NOCTTY | O_NONBLOCK);
  if (file.fd_ < 0 && errno == ENOENT) return {};  // it will be made
  if (file.fd_ < 0) return cannot_open(errno, path);
  struct stat about {};
  if (::fstat(file.fd_, &about) == 0 && !S_ISREG(about.st_mode)) return no_regular_file(path);
  auto holder = other_lock_holder(file.fd_, path);
  if (!holder) return std::move(holder).error();
  if (holder->empty()) return {};
  return held(path, *holder);
}

void OutputFile::begin_batch() {
  buffer.clear();
  passed_ = 0;
}

std::uint64_t OutputFile::size_with(std::size_t up_to) const noexcept {
  const std::uint64_t end = passed_ + up_to;
  return size_ + header_left_ + (end > done_ ? end - done_ : 0);
}

Result<void> OutputFile::append(const std::byte* data, std::size_t size, std::size_t& written) {
  for (;;) {
    const ssize_t count = ::write(fd_, data, size);
    if (count > 0) {
      written += static_cast<std::size_t>(count);
      return {};
    }
    if (count < 0 && errno == EINTR) continue;
    const int reason = count == 0 ? ENOSPC : errno;
    Error error = failed(reason, "cannot write the file");
    if (reason == ENOSPC || reason == EDQUOT) error.advice = "make room: events wait in the queue and are written then";
    return error;
  }
}

Result<void> OutputFile::write_out() {
  std::size_t at = static_cast<std::size_t>(
      std::min<std::uint64_t>(done_ > passed_ ? done_ - passed_ : 0, buffer.size()));
  while (at < buffer.size() && header_left_ > 0) {
    const std::size_t begin = header_.size() - header_left_;
    std::size_t written = 0;
    auto done = append(reinterpret_cast<const std::byte*>(header_.data()) + begin, header_left_, written);
    header_left_ -= written;
    size_ += written;
    if (!done) return done;
  }
  while (at < buffer.size()) {
    const std::size_t before = at;
    if (auto done = append(buffer.data() + at, buffer.size() - at, at); !done) return done;
    done_ += at - before;
    size_ += at - before;
  }
  passed_ += buffer.size();
  buffer.clear();
  return {};
}

void OutputFile::end_batch() noexcept { passed_ = done_ = done_before_ = 0; }

std::int64_t OutputFile::changed_at() const noexcept {
  struct stat about {};
  if (fd_ < 0 || ::fstat(fd_, &about) != 0) return 0;
  return std::int64_t{about.st_mtim.tv_sec} * 1'000'000'000 + about.st_mtim.tv_nsec;
}

Result<void> OutputFile::go_on_as_new(const std::string& name_of_old) {
  struct stat old {};
  if (::fstat(fd_, &old) != 0) return failed(errno, "cannot look at the file");
  const auto make = [&](const std::string& path, mode_t mode) -> Result<int> {
    const int made = ::open(path.c_str(), O_RDWR | O_APPEND | O_CREAT | O_EXCL | O_CLOEXEC | O_NOCTTY, mode);
    if (made < 0) return system_error(errno, "cannot begin a new file", path, "");
    if (::flock(made, LOCK_EX | LOCK_NB) == 0 && ::fchmod(made, old.st_mode & 07777) == 0) return made;
    const int reason = errno;
    ::close(made);
    ::unlink(path.c_str());
    return system_error(reason, "cannot begin a new file", path, "");
  };
  auto made = make(name_of_old, 0);  // which says what it is, when the program is killed before it gets its name
  if (!made) return std::move(made).error();
  if (::renameat2(AT_FDCWD, name_of_old.c_str(), AT_FDCWD, path_.c_str(), RENAME_EXCHANGE) != 0) {
    // On FAT and some network file systems, the path has no file for a moment.
    ::close(*made);
    if (::rename(path_.c_str(), name_of_old.c_str()) != 0) {
      const int reason = errno;
      ::unlink(name_of_old.c_str());
      return failed(reason, "cannot give the file its new name");
    }
    made = make(path_, 0600);
    if (!made) {
      ::rename(name_of_old.c_str(), path_.c_str());
      return std::move(made).error();
    }
  }
  ::close(std::exchange(fd_, *made));
  size_at_open_ = 0;
  size_ = 0;
  header_left_ = header_.size();
  done_before_ = done_;
  return {};
}

Result<void> OutputFile::sync() {
  if (fd_ >= 0 && ::fdatasync(fd_) != 0) return failed(errno, "cannot force the file onto the disk");
  return {};
}

bool OutputFile::is_unmounted() const {
  struct stat about {};
  struct stat above {};
  return !mounted_at_.empty() &&
         (::stat(mounted_at_.c_str(), &about) != 0 || (::stat((mounted_at_ + "/..").c_str(), &above) == 0 &&
                                                       above.st_dev == about.st_dev && above.st_ino != about.st_ino));
}

OutputFile::Gone OutputFile::close_if_gone() {
  struct stat about {};
  if (fd_ < 0 || ::fstat(fd_, &about) != 0) return Gone::no;
  struct stat there {};
  const bool is_there = ::stat(path_.c_str(), &there) == 0 && there.st_dev == about.st_dev &&
                        there.st_ino == about.st_ino;
  const bool is_cut_off = has_begun_ && about.st_nlink > 0 && is_there && about.st_size < static_cast<off_t>(size_);
  if (about.st_nlink > 0 && is_there && !is_cut_off) return Gone::no;
  // The batch under way is written again from its start; what is there of it would be twice.
  if (is_cut_off && about.st_size > batch_begins()) (void)!::ftruncate(fd_, batch_begins());
  close();
  if (is_cut_off) return Gone::cut_off;
  return about.st_nlink == 0 ? Gone::deleted : is_unmounted() ? Gone::unmounted : Gone::moved;
}

}  // namespace rtdata::detail
