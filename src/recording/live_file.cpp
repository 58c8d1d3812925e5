#include "recording/live_file.hpp"

#include <dirent.h>
#include <fcntl.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <climits>
#include <cstdio>
#include <cstring>
#include <memory>
#include <utility>
#include <vector>

#include "recording/private_folder.hpp"

namespace rtdata::sqlite {

struct LiveFile::Header {
  // The same in all versions, up to the recording.
  char magic[8];
  std::uint64_t layout;  // files of another version of the program are not read
  char uuid[48];
  std::uint64_t device;              // of the recording's file
  std::atomic<std::uint64_t> inode;  // 0: it was not opened yet
  char recording[PATH_MAX];
  std::atomic<std::uint64_t> lacks_room;
  std::atomic<std::uint64_t> has_row;
  std::atomic<std::uint64_t> slots;
  char path[PATH_MAX];  // of the recording, as it was given
  char name[256];
  char boot_id[48];
  std::int64_t started;
  std::int64_t clock_offset;
  std::int64_t pid;
};

namespace {

constexpr char magic[8] = {'r', 't', 'd', 'a', 't', 'a', 'L', '\0'};
constexpr std::uint64_t layout = (std::uint64_t{7} << 32) | sizeof(LiveSlot);
constexpr std::size_t header_bytes = 12288;
constexpr std::size_t unit = 64 * 1024;  // a multiple of every page size
constexpr const char* suffix = ".live";

std::size_t rounded(std::size_t bytes) noexcept { return (bytes + unit - 1) / unit * unit; }

std::string folder_of(const std::string& path) {
  const std::size_t slash = path.rfind('/');
  return slash == std::string::npos ? "." : slash == 0 ? "/" : path.substr(0, slash);
}

Error failed(int reason, const std::string& path) {
  return system_error(reason, "cannot keep counts in", path, "make room there");
}

/// Allocates pages, so that none is missing when it is written.
int reserve_bytes(int fd, std::size_t from, std::size_t bytes) noexcept {
  for (;;) {
    const int reason = ::posix_fallocate(fd, static_cast<off_t>(from), static_cast<off_t>(bytes));
    if (reason != EINTR) return reason;
  }
}

/// True if the file named by this header was deleted; false if its disk was removed, because it may come back.
bool is_gone(const char* recording, std::uint64_t device, std::uint64_t inode) {
  struct stat about {};
  if (::stat(recording, &about) == 0) return about.st_ino != inode;
  struct stat folder {};
  return errno == ENOENT && ::stat(folder_of(recording).c_str(), &folder) == 0 && folder.st_dev == device;
}

}  // namespace

std::size_t LiveFile::bytes_of(std::uint32_t block) noexcept {
  const std::size_t slots = std::size_t{first_block} << block;
  return rounded((block == 0 ? header_bytes : 0) + slots * (sizeof(LiveCounts) + sizeof(LiveSlot)));
}

Result<void> LiveFile::map_block(std::uint32_t block) {
  std::size_t from = 0;
  for (std::uint32_t i = 0; i < block; ++i) from += bytes_of(i);
  void* mapped = ::mmap(nullptr, bytes_of(block), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, fd_,
                        static_cast<off_t>(from));
  if (mapped == MAP_FAILED) return failed(errno, path_);
  auto* at = static_cast<std::byte*>(mapped);
  if (block == 0) {
    static_assert(sizeof(Header) <= header_bytes);
    header_ = reinterpret_cast<Header*>(at);
    at += header_bytes;
  }
  const std::size_t slots = std::size_t{first_block} << block;
  blocks_[block].counts = reinterpret_cast<LiveCounts*>(at);
  blocks_[block].slots = reinterpret_cast<LiveSlot*>(at + slots * sizeof(LiveCounts));
  return {};
}

Result<LiveFile> LiveFile::make(const std::string& path, const RunInfo& run) {
  const std::string& uuid = run.uuid;
  std::optional<Error> first;
  for (const std::string& place : private_folders()) {
    auto folder = PrivateFolder::open(place);
    if (!folder) {
      if (!first) first = std::move(folder).error();
      continue;
    }
    LiveFile made;
    made.path_ = place + "/" + uuid + suffix;
    int reason = 0;
    for (;;) {
      made.fd_ = ::openat(folder->fd(), (uuid + suffix).c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW,
                          0600);
      if (made.fd_ < 0 || ::flock(made.fd_, LOCK_EX) != 0) {
        reason = errno;
        break;
      }
      struct stat opened {};
      if (::fstat(made.fd_, &opened) == 0 && opened.st_nlink > 0) break;
      ::close(std::exchange(made.fd_, -1));  // another process took it for an old one
    }
    if (reason == 0) reason = reserve_bytes(made.fd_, 0, bytes_of(0));
    if (reason == 0) {
      if (auto mapped = made.map_block(0); !mapped) {
        made.remove();
        if (!first) first = std::move(mapped).error();
        continue;
      }
      Header& header = *made.header_;
      header.layout = layout;
      std::snprintf(header.uuid, sizeof header.uuid, "%s", uuid.c_str());
      std::snprintf(header.path, sizeof header.path, "%s", path.c_str());
      std::snprintf(header.name, sizeof header.name, "%s", run.name.c_str());
      std::snprintf(header.boot_id, sizeof header.boot_id, "%s", run.boot_id.c_str());
      header.started = to_nanoseconds(run.started);
      header.clock_offset = run.clock_offset.count();
      header.pid = run.pid;
      std::memcpy(header.magic, magic, sizeof magic);
      return made;
    }
    if (made.fd_ >= 0) made.remove();
    if (!first) first = failed(reason, place);
  }
  return std::move(*first);
}

void LiveFile::set_recording(const std::string& recording) noexcept {
  struct stat about {};
  if (header_ == nullptr || ::stat(recording.c_str(), &about) != 0) return;
  header_->device = about.st_dev;
  std::snprintf(header_->recording, sizeof header_->recording, "%s", recording.c_str());
  header_->inode.store(about.st_ino, std::memory_order_release);
}

void LiveFile::set_has_row() noexcept {
  if (header_ != nullptr) header_->has_row.store(1, std::memory_order_release);
}

RunInfo LiveFile::run() const {
  RunInfo run;
  run.uuid = header_->uuid;
  run.name = header_->name;
  run.boot_id = header_->boot_id;
  run.started = from_nanoseconds(header_->started);
  run.clock_offset = Duration{header_->clock_offset};
  run.pid = header_->pid;
  return run;
}

bool LiveFile::is_readable() const noexcept {
  return header_ != nullptr && std::memcmp(header_->magic, magic, sizeof magic) == 0 && header_->layout == layout;
}

std::optional<LiveFile> LiveFile::open(const std::string& path, bool& is_held) {
  LiveFile found;
  found.path_ = path;
  found.fd_ = ::open(path.c_str(), O_RDWR | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK | O_NOCTTY);
  struct stat about {};
  if (found.fd_ < 0 || ::fstat(found.fd_, &about) != 0 || !S_ISREG(about.st_mode) || about.st_uid != ::geteuid() ||
      (about.st_mode & 077) != 0)
    return std::nullopt;
  is_held = ::flock(found.fd_, LOCK_EX | LOCK_NB) != 0;
  std::size_t bytes = 0;
  for (std::uint32_t block = 0; block < most_blocks; ++block) {
    bytes += bytes_of(block);
    if (static_cast<std::size_t>(about.st_size) < bytes || !found.map_block(block)) break;
  }
  return found;
}

Result<std::optional<LiveFile>> LiveFile::find(const std::string& recording, const std::string& uuid,
                                               const std::string& noted) {
  struct stat about {};
  if (::stat(recording.c_str(), &about) != 0) return failed(errno, recording);
  std::vector<std::string> places = private_folders();
  if (noted.ends_with("/" + uuid + suffix)) places.insert(places.begin(), folder_of(noted));
  for (const std::string& place : places) {
    bool is_held = false;
    auto found = open(place + "/" + uuid + suffix, is_held);
    if (!found || !found->is_readable() || uuid != found->header_->uuid || found->header_->inode != about.st_ino)
      continue;
    if (is_held) {
      return Error{Errc::busy, "cannot record into", recording, "a process records into it, but its lock was removed",
                   "stop that one, or record into another file"};
    }
    return Result<std::optional<LiveFile>>(std::move(found));
  }
  return std::optional<LiveFile>();
}

template <class Function>
void LiveFile::for_each_left(const std::vector<std::string>& places, Function&& function) {
  for (const std::string& place : places) {
    const std::unique_ptr<DIR, int (*)(DIR*)> folder(::opendir(place.c_str()), &::closedir);
    if (folder == nullptr) continue;
    while (const dirent* entry = ::readdir(folder.get())) {
      const std::string name = entry->d_name;
      if (!name.ends_with(suffix)) continue;
      bool is_held = false;
      auto found = open(place + "/" + name, is_held);
      if (found && !is_held && found->header_ != nullptr) function(*found);  // no header: another version's
    }
  }
}

std::vector<LiveFile> LiveFile::without_row(const std::string& recording, const std::string& noted) {
  std::vector<LiveFile> all;
  struct stat ours {};
  if (::stat(recording.c_str(), &ours) != 0) return all;
  std::vector<std::string> places = private_folders();
  if (noted.ends_with(suffix) && std::find(places.begin(), places.end(), folder_of(noted)) == places.end())
    places.push_back(folder_of(noted));
  for_each_left(places, [&](LiveFile& file) {
    if (!file.is_readable() || file.header_->has_row != 0) return;
    const Header& header = *file.header_;
    struct stat named {};  // what it was to record into
    if (header.inode == 0 && ::stat(header.path, &named) != 0) return;
    const bool is_ours = header.inode == 0 ? named.st_ino == ours.st_ino && named.st_dev == ours.st_dev
                                           : header.inode == ours.st_ino && header.device == ours.st_dev;
    if (is_ours) all.push_back(std::move(file));
  });
  return all;
}

void LiveFile::remove_left(const std::string& recording) {
  struct stat ours {};
  if (::stat(recording.c_str(), &ours) != 0) return;
  for_each_left(private_folders(), [&](LiveFile& file) {
    const Header& header = *file.header_;
    const bool is_half_made = std::memcmp(header.magic, magic, sizeof magic) != 0;
    const bool is_ours = header.inode == ours.st_ino && header.device == ours.st_dev;
    // What a kill left before its recording was opened waits for that one's next start.
    const bool has_gone = header.inode != 0 && is_gone(header.recording, header.device, header.inode);
    if (is_half_made || is_ours || has_gone) file.remove();
  });
}

LiveFile::LiveFile(LiveFile&& other) noexcept
    : path_(std::move(other.path_)),
      fd_(std::exchange(other.fd_, -1)),
      header_(std::exchange(other.header_, nullptr)),
      blocks_(std::exchange(other.blocks_, {})) {}

LiveFile& LiveFile::operator=(LiveFile&& other) noexcept {
  std::swap(path_, other.path_);
  std::swap(fd_, other.fd_);
  std::swap(header_, other.header_);
  std::swap(blocks_, other.blocks_);
  return *this;
}

LiveFile::~LiveFile() {
  for (std::uint32_t block = 0; block < most_blocks; ++block) {
    if (blocks_[block].counts == nullptr) continue;
    void* begin = block == 0 ? static_cast<void*>(header_) : static_cast<void*>(blocks_[block].counts);
    ::munmap(begin, bytes_of(block));
  }
  if (fd_ >= 0) ::close(fd_);
}

Result<void> LiveFile::reserve(std::uint32_t slot) {
  const std::uint32_t block = block_of(slot);
  Result<void> done;
  if (has(slot)) {
    // is set aside with those before it
  } else if (fd_ < 0 || lacks_room() || block >= most_blocks) {
    done = no_room();
  } else {
    std::size_t from = 0;
    for (std::uint32_t i = 0; i < block; ++i) from += bytes_of(i);
    const int reason = reserve_bytes(fd_, from, bytes_of(block));
    done = reason == 0 ? map_block(block) : failed(reason, path_);
  }
  if (header_ == nullptr) return done;
  if (done) {
    if (slot >= slots()) header_->slots.store(slot + 1, std::memory_order_release);
  } else {
    header_->lacks_room.store(1, std::memory_order_release);
  }
  return done;
}

Error LiveFile::no_room() const {
  return {Errc::storage_full, "cannot keep counts in", path_, "there is no room for all sensors", "make room there"};
}

std::uint32_t LiveFile::slots() const noexcept {
  return header_ == nullptr ? 0 : static_cast<std::uint32_t>(header_->slots.load(std::memory_order_acquire));
}

bool LiveFile::lacks_room() const noexcept {
  return header_ == nullptr || header_->lacks_room.load(std::memory_order_acquire) != 0;
}

void LiveFile::remove() noexcept {
  if (fd_ < 0) return;
  ::unlink(path_.c_str());
  ::close(std::exchange(fd_, -1));
}

}  // namespace rtdata::sqlite
