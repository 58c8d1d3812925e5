#include "recording/private_folder.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <string_view>

namespace rtdata::sqlite {

Result<PrivateFolder> PrivateFolder::open(const std::string& path) {
  constexpr const char* doing = "cannot keep counts in";
  if (::mkdir(path.c_str(), 0700) != 0 && errno != EEXIST) return system_error(errno, doing, path, "");
  PrivateFolder made;
  made.path_ = path;
  made.fd_.set(::open(path.c_str(), O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC));
  if (made.fd() < 0) return system_error(errno, doing, path, "remove it, if it is not a folder of this user");
  struct stat about {};
  if (::fstat(made.fd(), &about) != 0) return system_error(errno, doing, path, "");
  if (about.st_uid != ::geteuid())
    return Error{Errc::not_permitted, doing, path, "it belongs to another user", "remove it"};
  if ((about.st_mode & 022) != 0)
    return Error{Errc::not_permitted, doing, path, "others may write into it", "chmod 0700 it"};
  return made;
}

std::vector<std::string> private_folders() {
  std::vector<std::string> all;
  if (const char* service = std::getenv("RUNTIME_DIRECTORY"); service != nullptr && service[0] == '/') {
    const std::string_view list = service;  // divided by colons
    all.emplace_back(list.substr(0, list.find(':')));
  }
  if (const char* user = std::getenv("XDG_RUNTIME_DIR"); user != nullptr && user[0] == '/')
    all.push_back(std::string(user) + "/rtdata");
  all.push_back("/dev/shm/rtdata-" + std::to_string(::geteuid()));
  return all;
}

}  // namespace rtdata::sqlite
