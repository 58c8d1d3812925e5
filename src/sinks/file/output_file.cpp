#include "sinks/file/output_file.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <span>
#include <utility>

#include "sinks/lock_holder.hpp"

namespace rtdata::detail {
namespace {

constexpr std::size_t window_bytes = std::size_t{1} << 20;

/// Line ends divide the events, whatever is between them.
bool is_by_lines(const Codec& codec) {
  constexpr std::array lines{std::byte{'"'}, std::byte{'\n'}};
  return codec.first_event(lines) == lines.size();
}

Result<void> compare_header(int fd, const std::string& path, const std::string& header) {
  std::string there(header.size(), '\0');
  const ssize_t got = ::pread(fd, there.data(), there.size(), 0);
  if (got < 0) return system_error(errno, "cannot read the file's header", path, "");
  there.resize(static_cast<std::size_t>(got));
  if (there == header) return {};
  if (got == 0 || (header.starts_with(there) && !there.ends_with('\n'))) return {};  // half a header is moved aside
  there.resize(std::min(there.find('\n'), there.size()));
  return Error{Errc::description_differs, "cannot append to", path,
               "its header is \"" + there + "\", not \"" + header.substr(0, header.find('\n')) + "\"",
               "choose another path"};
}

}  // namespace

OutputFile::OutputFile(OutputFile&& other) noexcept
    : buffer(std::move(other.buffer)),
      path_(std::move(other.path_)),
      fd_(std::exchange(other.fd_, -1)),
      size_at_open_(other.size_at_open_),
      header_(std::move(other.header_)),
      writes_header_(other.writes_header_),
      has_begun_(other.has_begun_),
      passed_(other.passed_),
      done_(other.done_) {}

OutputFile::~OutputFile() { close(); }

void OutputFile::close() noexcept {
  if (fd_ >= 0) ::close(fd_);
  fd_ = -1;
}

Error OutputFile::failed(int errno_value, const char* what) const { return system_error(errno_value, what, path_, ""); }

Result<void> OutputFile::open(const std::string& path) {
  if (fd_ >= 0) return {};
  path_ = path;
  // Non-blocking for the sake of a pipe without a reader, which is refused below.
  fd_ = ::open(path.c_str(), O_RDWR | O_APPEND | O_CREAT | O_CLOEXEC | O_NOCTTY | O_NONBLOCK, 0644);
  if (fd_ < 0) {
    const int reason = errno;
    Error error = failed(reason, "cannot open the file");
    if (reason == ENOENT) error.advice = "make its directory first";
    if (reason == EACCES || reason == EPERM || reason == EROFS)
      error.advice = "choose a place where this user may write";
    if (reason == EISDIR)
      error = {Errc::bad_argument, "cannot open the file", path, "it is a directory", "give the name of a file in it"};
    return error;
  }
  struct stat about {};
  Result<void> result;
  if (::fstat(fd_, &about) != 0) {
    result = failed(errno, "cannot look at the file");
  } else if (!S_ISREG(about.st_mode)) {
    result = Error{Errc::bad_argument, "cannot record into", path, "it is no regular file", "give the path of a file"};
  } else if (::flock(fd_, LOCK_EX | LOCK_NB) != 0) {
    const int reason = errno;
    result = reason == EWOULDBLOCK ? Error{Errc::busy, "cannot record into", path, lock_holder(about) + " writes it",
                                           "stop that one, or choose another path"}
                                   : failed(reason, "cannot lock the file");
  }
  if (!result) close();
  size_at_open_ = about.st_size;
  passed_ = done_ = 0;
  has_begun_ = false;
  return result;
}

Result<void> OutputFile::repair(Codec& codec, std::string& what) {
  what.clear();
  if (size_at_open_ == 0) return {};
  if (is_by_lines(codec)) {
    std::byte last{};
    if (::pread(fd_, &last, 1, size_at_open_ - 1) != 1) return failed(errno, "cannot read the file's end");
    if (last == std::byte{'\n'}) return {};
    constexpr std::byte line_end{'\n'};
    std::size_t written = 0;
    what = "the file ended in half a line, which was completed with a line end";
    return append(&line_end, 1, written);
  }
  std::vector<std::byte> tail;  // from the last event's start on
  for (off_t at = 0;;) {
    const std::size_t kept = tail.size();
    tail.resize(kept + window_bytes);
    const ssize_t got = ::pread(fd_, tail.data() + kept, window_bytes, at);
    if (got < 0) return failed(errno, "cannot read the file");
    tail.resize(kept + static_cast<std::size_t>(got));
    if (got == 0) break;
    at += got;
    std::size_t used = 0;
    while (const std::size_t size = codec.first_event(std::span(tail).subspan(used))) used += size;
    tail.erase(tail.begin(), tail.begin() + static_cast<std::ptrdiff_t>(used));
    if (tail.size() > 2 * window_bytes) break;
  }
  if (tail.empty()) return {};
  std::vector<std::byte> whole = tail;
  whole.resize(tail.size() + window_bytes);
  for (const char end : {'\n', '"', '\n'})
    whole.push_back(static_cast<std::byte>(end));  // of a row, and of an open quote
  if (tail.size() > 2 * window_bytes || codec.first_event(whole) == 0) {
    return Error{Errc::damaged, "cannot append to", path_, "what it holds is no " + std::string(codec.name()),
                 "check `format`, or choose another path"};
  }
  what = "the file ended in half an event, whose " + std::to_string(tail.size()) + " bytes were moved to " + path_ +
         ".half";
  return move_aside(tail);
}

Result<void> OutputFile::move_aside(std::span<const std::byte> tail) {
  OutputFile aside;
  aside.path_ = path_ + ".half";
  aside.fd_ = ::open(aside.path_.c_str(), O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC | O_NOCTTY, 0644);
  if (aside.fd_ < 0) return aside.failed(errno, "cannot move half an event aside");
  for (std::size_t written = 0; written < tail.size();) {
    if (auto done = aside.append(tail.data() + written, tail.size() - written, written); !done) return done;
  }
  size_at_open_ -= static_cast<off_t>(tail.size());
  if (::ftruncate(fd_, size_at_open_) != 0) return failed(errno, "cannot cut half an event off");
  return {};
}

Result<void> OutputFile::begin(const std::string& header) {
  header_ = header;
  writes_header_ = size_at_open_ == 0 && !header.empty();
  has_begun_ = true;
  if (size_at_open_ == 0 || header.empty()) return {};
  return compare_header(fd_, path_, header);
}

Result<void> OutputFile::check_header(const std::string& path, const std::string& header) {
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOCTTY | O_NONBLOCK);
  if (fd < 0) return {};  // it is not there, or what else is wrong is told elsewhere
  struct stat about {};
  const bool has_content = ::fstat(fd, &about) == 0 && S_ISREG(about.st_mode) && about.st_size > 0;
  Result<void> same = has_content ? compare_header(fd, path, header) : Result<void>{};
  ::close(fd);
  return same;
}

void OutputFile::begin_batch() {
  buffer.clear();
  passed_ = 0;
  if (!writes_header_) return;
  const auto* from = reinterpret_cast<const std::byte*>(header_.data());
  buffer.insert(buffer.end(), from, from + header_.size());
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
  while (at < buffer.size()) {
    const std::size_t before = at;
    if (auto done = append(buffer.data() + at, buffer.size() - at, at); !done) return done;
    done_ += at - before;
  }
  passed_ += buffer.size();
  buffer.clear();
  return {};
}

void OutputFile::end_batch() noexcept {
  if (passed_ > 0) writes_header_ = false;
  passed_ = done_ = 0;
}

Result<void> OutputFile::sync() {
  if (fd_ >= 0 && ::fdatasync(fd_) != 0) return failed(errno, "cannot force the file onto the disk");
  return {};
}

OutputFile::Gone OutputFile::close_if_gone() {
  struct stat about {};
  if (fd_ < 0 || ::fstat(fd_, &about) != 0) return Gone::no;
  struct stat there {};
  const bool is_there = ::stat(path_.c_str(), &there) == 0 && there.st_dev == about.st_dev &&
                        there.st_ino == about.st_ino;
  if (about.st_nlink > 0 && is_there) return Gone::no;
  close();
  return about.st_nlink == 0 ? Gone::deleted : Gone::moved;
}

}  // namespace rtdata::detail
