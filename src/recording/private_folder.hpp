// A folder for small files in memory that survive a kill and that only the user can access.
#pragma once

#include <string>
#include <vector>

#include "rtdata/data/error.hpp"

namespace rtdata::sqlite {

/// An open folder: renaming it does not redirect operations in it.
class PrivateFolder {
 public:
  PrivateFolder() = default;
  /// Opens the folder; it is made with mode 0700 when it is not there. Errors: not-permitted when it belongs to another
  /// user, or others may write into it, or it is a symbolic link.
  static Result<PrivateFolder> open(const std::string& path);
  PrivateFolder(PrivateFolder&& other) noexcept;
  PrivateFolder& operator=(PrivateFolder&& other) noexcept;
  ~PrivateFolder();
  int fd() const noexcept { return fd_; }
  const std::string& path() const noexcept { return path_; }

 private:
  std::string path_;
  int fd_ = -1;
};

/// The possible folders, best first: $RUNTIME_DIRECTORY from a service manager; $XDG_RUNTIME_DIR/rtdata of a logged-in
/// user; /dev/shm/rtdata-UID.
std::vector<std::string> private_folders();

}  // namespace rtdata::sqlite
