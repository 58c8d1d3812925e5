#include "sinks/sqlite/live_file.hpp"

#include <fcntl.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstddef>
#include <cstdio>
#include <cstring>
#include <thread>
#include <utility>

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

/// Who holds the lock: "process 4711". It writes its pid as soon as it has the lock, so that is waited for, at most 1 s.
std::string holder_of(int fd) {
  constexpr std::chrono::seconds most{1};
  constexpr std::chrono::milliseconds pause{5};
  for (const auto until = std::chrono::steady_clock::now() + most; std::chrono::steady_clock::now() < until;
       std::this_thread::sleep_for(pause)) {
    std::int64_t pid = 0;
    const bool is_read = ::pread(fd, &pid, sizeof pid, sizeof magic) == sizeof pid;
    // A pid of nobody is left from a run that was killed.
    if (is_read && pid > 0 && (::kill(static_cast<pid_t>(pid), 0) == 0 || errno != ESRCH))
      return "process " + std::to_string(pid);
  }
  return "another process";
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
      return Error{Errc::busy, "cannot record into", path, holder_of(made.fd_) + " records into it",
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
  made.content_->pid = ::getpid();
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
