// A folder for small files in memory that survive a kill and that only the user can access.
#pragma once

#include <string>
#include <vector>

#include "rtdata/data/error.hpp"
#include "rtdata/detail/io/descriptor.hpp"

namespace rtdata::sqlite {

/// An open folder: renaming it does not redirect operations in it.
class PrivateFolder {
 public:
  PrivateFolder() = default;
  /// Opens the folder; it is made with mode 0700 when it is not there. Errors: not-permitted when it belongs to another
  /// user, or others may write into it, or it is a symbolic link.
  static Result<PrivateFolder> open(const std::string& path);
  int fd() const noexcept { return fd_.fd(); }
  const std::string& path() const noexcept { return path_; }

 private:
  std::string path_;
  detail::Descriptor fd_;
};

/// The possible folders, best first: $RUNTIME_DIRECTORY from a service manager; $XDG_RUNTIME_DIR/rtdata of a logged-in
/// user; /dev/shm/rtdata-UID.
std::vector<std::string> private_folders();

}  // namespace rtdata::sqlite
