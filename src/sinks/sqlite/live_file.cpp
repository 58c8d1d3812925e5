#include "sinks/sqlite/live_file.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <utility>

#include "sinks/lock_holder.hpp"

namespace rtdata::sqlite {

struct LiveFile::Content {
  char magic[8];
  std::int64_t pid;
  char uuid[48];
  LiveCounts slots[most_slots];
};

namespace {

constexpr char magic[8] = {'r', 't', 'd', 'a', 't', 'a', '1', '\0'};

std::string place_of(const std::string& recording, const struct stat& status) {
  char name[64];
  std::snprintf(name, sizeof name, "rtdata-%llx-%llx", static_cast<unsigned long long>(status.st_dev),
                static_cast<unsigned long long>(status.st_ino));
  if (::access("/dev/shm", W_OK | X_OK) == 0) return std::string("/dev/shm/") + name;
  const std::size_t slash = recording.rfind('/');
  return (slash == std::string::npos ? std::string() : recording.substr(0, slash + 1)) + "." + name;
}

}  // namespace

Result<LiveFile> LiveFile::open(const std::string& path) {
  struct stat status {};
  if (::stat(path.c_str(), &status) != 0) return system_error(errno, "cannot lock the recording", path);
  LiveFile made;
  made.path_ = place_of(path, status);
  for (;;) {
    made.fd_ = ::open(made.path_.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0644);
    if (made.fd_ < 0) {
      return system_error(errno, "cannot lock the recording", path, "another user may hold " + made.path_);
    }
    if (::flock(made.fd_, LOCK_EX | LOCK_NB) != 0) {
      struct stat held {};
      ::fstat(made.fd_, &held);
      return Error{Errc::busy, "cannot record into", path, detail::lock_holder(held) + " records into it",
                   "stop that one, or record into another file"};
    }
    struct stat locked {};
    struct stat there {};
    if (::fstat(made.fd_, &locked) == 0 && ::stat(made.path_.c_str(), &there) == 0 && locked.st_ino == there.st_ino)
      break;
    ::close(made.fd_);  // its holder has just removed it
  }
  struct stat size {};
  ::fstat(made.fd_, &size);
  if (size.st_size != sizeof(Content) && ::ftruncate(made.fd_, sizeof(Content)) != 0) {
    return system_error(errno, "cannot lock the recording", made.path_);
  }
  void* mapped = ::mmap(nullptr, sizeof(Content), PROT_READ | PROT_WRITE, MAP_SHARED, made.fd_, 0);
  if (mapped == MAP_FAILED) return system_error(errno, "cannot lock the recording", made.path_);
  made.content_ = static_cast<Content*>(mapped);
  return made;
}

LiveFile::LiveFile(LiveFile&& other) noexcept
    : path_(std::move(other.path_)),
      fd_(std::exchange(other.fd_, -1)),
      content_(std::exchange(other.content_, nullptr)) {}

LiveFile& LiveFile::operator=(LiveFile&& other) noexcept {
  if (this != &other) {
    unlock();
    path_ = std::move(other.path_);
    fd_ = std::exchange(other.fd_, -1);
    content_ = std::exchange(other.content_, nullptr);
  }
  return *this;
}

LiveFile::~LiveFile() { unlock(); }

void LiveFile::unlock() noexcept {
  if (content_ != nullptr) ::munmap(std::exchange(content_, nullptr), sizeof(Content));
  if (fd_ >= 0) ::close(std::exchange(fd_, -1));
}

bool LiveFile::belongs_to(const std::string& uuid) const noexcept {
  return std::memcmp(content_->magic, magic, sizeof magic) == 0 && uuid == content_->uuid;
}

void LiveFile::begin(const std::string& uuid) {
  // Cut and grown again, so that every count is zero and no page is kept.
  if (::ftruncate(fd_, 0) != 0 || ::ftruncate(fd_, sizeof(Content)) != 0) {
    throw SetupError(system_error(errno, "cannot count what is published", path_, "make room in /dev/shm"));
  }
  std::memcpy(content_->magic, magic, sizeof magic);
  content_->pid = ::getpid();
  std::snprintf(content_->uuid, sizeof content_->uuid, "%s", uuid.c_str());
}

void LiveFile::remove() noexcept {
  if (fd_ < 0) return;
  ::unlink(path_.c_str());
  ::close(std::exchange(fd_, -1));
}

LiveCounts& LiveFile::counts(std::uint32_t slot) noexcept { return content_->slots[slot]; }

}  // namespace rtdata::sqlite
