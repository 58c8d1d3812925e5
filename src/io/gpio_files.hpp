// The files of the kernel's GPIO chips.
#pragma once

#include <dirent.h>
#include <sys/stat.h>

#include <algorithm>
#include <string>
#include <vector>

namespace rtdata::detail {

/// "/dev/gpiochip0" and so on, by number, without links, which lead to chips that are listed.
inline std::vector<std::string> gpio_chip_files() {
  std::vector<std::string> files;
  DIR* const folder = ::opendir("/dev");
  if (folder == nullptr) return files;
  while (const dirent* entry = ::readdir(folder)) {
    std::string path = std::string("/dev/") + entry->d_name;
    struct stat status {};
    if (path.starts_with("/dev/gpiochip") && ::lstat(path.c_str(), &status) == 0 && S_ISCHR(status.st_mode))
      files.push_back(std::move(path));
  }
  ::closedir(folder);
  std::sort(files.begin(), files.end(), [](const std::string& a, const std::string& b) {
    return a.size() != b.size() ? a.size() < b.size() : a < b;
  });
  return files;
}

/// Detects that a chip's file was replaced, which happens when the chip is plugged in again.
class GpioChipFile {
 public:
  explicit GpioChipFile(std::string path) : path_(std::move(path)) { ::stat(path_.c_str(), &status_); }
  bool is_the_same() const noexcept {
    struct stat now {};
    return ::stat(path_.c_str(), &now) == 0 && now.st_ino == status_.st_ino && now.st_rdev == status_.st_rdev;
  }

 private:
  std::string path_;
  struct stat status_ {};
};

}  // namespace rtdata::detail
