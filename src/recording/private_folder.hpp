// Where a program keeps small files in memory that survive its kill and that only its user can touch.
#pragma once

#include <string>
#include <vector>

#include "rtdata/data/error.hpp"

namespace rtdata::sqlite {

/// A folder that is open: what is done in it is not led elsewhere by renaming.
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

/// Where it may be, best first: $RUNTIME_DIRECTORY, which a service manager makes; $XDG_RUNTIME_DIR/rtdata of a user
/// who is logged in; /dev/shm/rtdata-UID.
std::vector<std::string> private_folders();

}  // namespace rtdata::sqlite
