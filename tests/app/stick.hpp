// A disk that can be taken away or hang: a small ext4 in a file, mounted.
#pragma once

#include <fcntl.h>
#include <linux/fs.h>
#include <sys/ioctl.h>
#include <sys/mount.h>
#include <unistd.h>

#include <cstdint>
#include <filesystem>
#include <string>

#include "app/process.hpp"

namespace rtdata::test {

inline constexpr const char*
    why_no_stick = "skipped: mounting a file system in a file needs root, mkfs.ext4 and a loop device";

/// `stick` in the folder.
class Stick {
 public:
  explicit Stick(const Folder& folder) : folder_(folder) {
    folder.write("image", "");
    std::filesystem::resize_file(folder.path() + "/image", 128 << 20);
    std::filesystem::create_directory(path());
    is_made_ = call("mkfs.ext4 -q -F image") && mount();
  }
  Stick(const Stick&) = delete;
  ~Stick() {
    if (!is_made_) return;
    thaw();
    ::umount2(path().c_str(), MNT_DETACH);
  }
  explicit operator bool() const { return is_made_; }
  std::string path() const { return folder_.path() + "/stick"; }
  bool mount() { return call("mount -o loop image stick"); }
  /// Pulled out: what was not written is lost, and whatever is asked of it from then on fails with EIO.
  bool pull() const {
    constexpr unsigned long shutdown = _IOR('X', 125, std::uint32_t);  // EXT4_IOC_SHUTDOWN
    std::uint32_t without_writing = 2;
    return control(shutdown, &without_writing);
  }
  /// Whoever writes to it hangs until it is thawed.
  bool freeze() const { return control(FIFREEZE, nullptr); }
  bool thaw() const { return control(FITHAW, nullptr); }
  /// As `umount -l`: gone from its folder; who has files open may go on with them.
  bool detach() const { return ::umount2(path().c_str(), MNT_DETACH) == 0; }

 private:
  bool control(unsigned long request, void* argument) const {
    const int fd = ::open(path().c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    const bool is_done = ::ioctl(fd, request, argument) == 0;
    ::close(fd);
    return is_done;
  }
  bool call(const std::string& command) const {
    Process process(folder_, "/bin/sh", {"-c", command + " 2>&1"});
    return process.end() == 0;
  }
  const Folder& folder_;
  bool is_made_ = false;
};

}  // namespace rtdata::test
