#include "recording/recording_lock.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <thread>
#include <utility>

#include "sinks/core/lock_holder.hpp"

namespace rtdata::sqlite {
namespace {

constexpr std::size_t longest_note = 4096;
constexpr int lock_flags = O_RDWR | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK | O_NOCTTY;

/// The permissions of a recording's lock file: whoever may write the recording may read and write it.
mode_t lock_mode(mode_t recording) noexcept {
  mode_t mode = 0600;
  if ((recording & S_IWGRP) != 0) mode |= 0060;
  if ((recording & S_IWOTH) != 0) mode |= 0006;
  return mode;
}

Error failed(int reason, const std::string& path) {
  Error error = system_error(reason, "cannot lock the recording", path, "");
  switch (reason) {
    case EACCES:
    case EPERM:
      error.advice =
          "it belongs to another user: record as that user, or remove it when no program records into the recording";
      break;
    case EROFS:
    case ENOENT:
    case ENOTDIR:
      error.advice = "record into a folder where this user may make files";
      break;
    case ELOOP:
      error.why = "it is a symbolic link";
      error.advice = "remove it";
      break;
    default:
      error.advice = "record into another file system";
      break;
  }
  return error;
}

Error no_lock_file(const std::string& path) {
  return {Errc::not_permitted, "cannot lock the recording", path, "it is not a regular file", "remove it"};
}

Error held(const std::string& recording, const std::string& holder, const char* advice) {
  return {Errc::busy, "cannot record into", recording, holder + " records into it", advice};
}

// A program that closes the file locks it for a moment.
constexpr int most_tries = 20;
constexpr std::chrono::milliseconds pause_between_tries{50};

constexpr const char* to_stop_other = "stop that one, or record into another file";

std::string first_line_of(int fd) {
  std::array<char, longest_note> text{};
  const ssize_t got = ::pread(fd, text.data(), text.size(), 0);
  const std::string_view all(text.data(), got > 0 ? static_cast<std::size_t>(got) : 0);
  const std::size_t end = all.find('\n');
  return end == std::string_view::npos ? std::string() : std::string(all.substr(0, end));
}

}  // namespace

Result<RecordingLock> RecordingLock::take(const std::string& recording) {
  struct stat about {};
  if (::stat(recording.c_str(), &about) != 0) return failed(errno, recording);
  const mode_t mode = lock_mode(about.st_mode);
  RecordingLock made;
  made.path_ = recording + "-lock";
  for (;;) {
    made.fd_.set(::open(made.path_.c_str(), lock_flags | O_CREAT, mode));
    if (made.fd_.fd() < 0) return failed(errno, made.path_);
    struct stat locked {};
    if (::fstat(made.fd_.fd(), &locked) != 0) return failed(errno, made.path_);
    if (!S_ISREG(locked.st_mode)) return no_lock_file(made.path_);
    if (::flock(made.fd_.fd(), LOCK_EX | LOCK_NB) != 0) {
      if (errno != EWOULDBLOCK) return failed(errno, made.path_);
      const std::string holder = detail::lock_holder(locked);
      const bool is_own = holder == "process " + std::to_string(::getpid());
      return held(
          recording, holder,
          is_own ? "this program itself has it open, or is still closing it; record into another file" : to_stop_other);
    }
    struct stat there {};
    if (::lstat(made.path_.c_str(), &there) == 0 && locked.st_ino == there.st_ino && locked.st_dev == there.st_dev) {
      // Less the umask when it was made; and the recording's permissions may have changed since.
      if (locked.st_uid == ::geteuid()) {
        if (locked.st_gid != about.st_gid) (void)!::fchown(made.fd_.fd(), static_cast<uid_t>(-1), about.st_gid);
        if ((locked.st_mode & 07777) != mode) (void)::fchmod(made.fd_.fd(), mode);
      }
      break;
    }
    made.fd_.set(-1);  // its holder has just removed it
  }
  made.noted_ = first_line_of(made.fd_.fd());
  return made;
}

bool RecordingLock::is_free(const std::string& recording) noexcept try {
  const std::string path = recording + "-lock";
  const detail::Descriptor lock(::open(path.c_str(), (lock_flags & ~O_ACCMODE) | O_RDONLY));
  if (lock.fd() < 0) return errno == ENOENT;
  const auto holder = detail::other_lock_holder(lock.fd(), path);
  return holder && holder->empty();
} catch (...) {  // no memory
  return false;
}

Result<void> RecordingLock::check_free(const std::string& recording) {
  const std::string path = recording + "-lock";
  const detail::Descriptor lock(::open(path.c_str(), lock_flags));
  struct stat about {};
  if (lock.fd() < 0 && errno != ENOENT) return failed(errno, path);
  if (lock.fd() < 0) {
    const std::string folder = recording.substr(0, recording.rfind('/') + 1);
    if (::faccessat(AT_FDCWD, folder.empty() ? "." : folder.c_str(), W_OK | X_OK, AT_EACCESS) != 0)
      return failed(errno, path);
    return {};
  }
  if (::fstat(lock.fd(), &about) == 0 && !S_ISREG(about.st_mode)) return no_lock_file(path);
  auto holder = detail::other_lock_holder(lock.fd(), path);
  if (!holder) return std::move(holder).error();
  if (holder->empty()) return {};
  return held(recording, *holder, to_stop_other);
}

Result<void> hold_file(const Database& database) {
  sqlite3_file* file = nullptr;
  if (sqlite3_file_control(database.raw(), "main", SQLITE_FCNTL_FILE_POINTER, &file) != SQLITE_OK || file == nullptr ||
      file->pMethods == nullptr)
    return {};
  int status = SQLITE_OK;
  for (int tries = 0; tries < most_tries; ++tries) {
    if (tries > 0) std::this_thread::sleep_for(pause_between_tries);
    status = file->pMethods->xLock(file, SQLITE_LOCK_SHARED);
    if (status == SQLITE_OK) status = file->pMethods->xLock(file, SQLITE_LOCK_RESERVED);
    if ((status & 0xff) != SQLITE_BUSY) break;
  }
  if (status == SQLITE_OK) return {};
  if ((status & 0xff) != SQLITE_BUSY)
    return Error{Errc::io_failed, "cannot lock the recording", database.path(), sqlite3_errstr(status), ""};
  return Error{Errc::busy, "cannot record into", database.path(),
               "another program writes into it, perhaps under another name (a file that is mounted twice)",
               to_stop_other};
}

void RecordingLock::note(std::string_view line) noexcept {
  if (fd_.fd() < 0 || line.size() >= longest_note || ::ftruncate(fd_.fd(), 0) != 0) return;
  std::array<char, longest_note> text{};
  const std::size_t size = line.copy(text.data(), line.size());
  text[size] = '\n';  // without it, half a line is not taken for one
  (void)!::pwrite(fd_.fd(), text.data(), size + 1, 0);
}

void RecordingLock::remove() noexcept {
  if (fd_.fd() < 0) return;
  ::unlink(path_.c_str());  // before it is unlocked: a process that waits for it then sees that the file is gone
  fd_.set(-1);
}

}  // namespace rtdata::sqlite
