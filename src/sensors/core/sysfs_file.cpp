#include "sensors/core/sysfs_file.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/vfs.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <iterator>
#include <memory>
#include <utility>

namespace rtdata::detail {
namespace {

/// Local file systems, by their magic numbers (man 2 statfs): an open file shows new content at once, unlike on network
/// and overlay file systems.
constexpr unsigned long sysfs = 0x62656572;
constexpr unsigned long local_file_systems[] = {0x01021994, 0x858458f6, 0xef53, 0x58465342, 0x9123683e, 0xf2f52010};

ssize_t read_at_start(int fd, char* to, std::size_t room) noexcept {
  const ssize_t got = ::pread(fd, to, room, 0);
  return got < 0 && errno == ESPIPE ? ::read(fd, to, room) : got;
}

}  // namespace

void SysfsFile::close() noexcept {
  if (fd_ >= 0) ::close(fd_);
  fd_ = -1;
  keeps_ = Keeps::never;
}

void SysfsFile::open() noexcept {
  fd_ = ::open(path_.c_str(), O_RDONLY | O_CLOEXEC | O_NOCTTY);
  if (fd_ < 0) {
    error_number_ = errno;
    return;
  }
  struct statfs where {};
  if (::fstatfs(fd_, &where) != 0) return;
  const auto type = static_cast<unsigned long>(where.f_type) & 0xffffffff;
  if (type == sysfs) keeps_ = Keeps::always;
  struct stat status {};
  if (std::find(std::begin(local_file_systems), std::end(local_file_systems), type) == std::end(local_file_systems) ||
      ::fstat(fd_, &status) != 0 || !S_ISREG(status.st_mode))
    return;
  keeps_ = Keeps::while_it_is_there;
  device_ = status.st_dev;
  inode_ = status.st_ino;
}

bool SysfsFile::is_replaced() const noexcept {
  if (keeps_ != Keeps::while_it_is_there) return false;
  struct stat status {};
  return ::stat(path_.c_str(), &status) != 0 || status.st_dev != device_ || status.st_ino != inode_;
}

void SysfsFile::read() noexcept {
  error_number_ = 0;
  size_ = 0;
  if (fd_ >= 0 && is_replaced()) close();
  if (fd_ < 0) open();
  if (fd_ < 0) return;
  ssize_t got = 0;
  do {
    got = read_at_start(fd_, buffer_.data(), buffer_.size());
  } while (got < 0 && errno == EINTR);
  if (got < 0) {
    error_number_ = errno;
  } else {
    size_ = static_cast<std::size_t>(got);
  }
  if (got < 0 || keeps_ == Keeps::never) close();
}

void FindFile::transact() noexcept try {
  path_ = find_();
  if (!path_) return;
  if (auto readable = check_readable(*path_, what_, advice_); !readable) path_ = std::move(readable).error();
} catch (...) {  // so short that it needs no memory
  path_ = Error{Errc::io_failed, "no memory", "", "", ""};
}

Result<void> check_readable(const std::string& path, const char* what, const std::string& advice) {
  struct stat status {};
  if (::stat(path.c_str(), &status) != 0) return system_error(errno, what, path, advice);
  if (S_ISDIR(status.st_mode)) return system_error(EISDIR, what, path, advice);
  if (::faccessat(AT_FDCWD, path.c_str(), R_OK, AT_EACCESS) != 0) {
    return system_error(errno, what, path, "run as a user that may read it (`ls -l` shows which), or add a udev rule");
  }
  return {};
}

std::string physical_device_of(const std::string& path) {
  const std::unique_ptr<char, decltype(&std::free)> real(::realpath(path.c_str(), nullptr), &std::free);
  const std::string resolved = real != nullptr ? real.get() : path;
  if (!resolved.starts_with("/sys/")) return resolved;
  return resolved.substr(0, resolved.rfind('/'));
}

}  // namespace rtdata::detail
