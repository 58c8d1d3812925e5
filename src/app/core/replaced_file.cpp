#include "app/core/replaced_file.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <filesystem>

#include "rtdata/detail/io/descriptor.hpp"

namespace rtdata::app {

Result<void> replace_file(const std::string& file, const std::string& text) {
  std::error_code none;
  std::string target = std::filesystem::canonical(file, none).string();
  if (none) target = file;
  struct stat about {};
  const bool is_there = ::stat(target.c_str(), &about) == 0;
  std::string name = target + ".XXXXXX";
  const int fd = ::mkostemp(name.data(), O_CLOEXEC);
  if (fd < 0) return system_error(errno, "cannot write", target, "");
  int failed = 0;
  for (std::size_t done = 0; done < text.size() && failed == 0;) {
    const ssize_t written = ::write(fd, text.data() + done, text.size() - done);
    if (written >= 0) done += static_cast<std::size_t>(written);
    if (written < 0 && errno != EINTR) failed = errno;
  }
  const bool is_of_other = is_there && about.st_uid != ::geteuid();
  if (failed == 0 && is_of_other && ::fchown(fd, about.st_uid, about.st_gid) != 0) failed = errno;
  if (failed == 0 && ::fchmod(fd, is_there ? about.st_mode & 07777 : 0640) != 0) failed = errno;
  if (failed == 0 && ::fsync(fd) != 0) failed = errno;
  if (::close(fd) != 0 && failed == 0) failed = errno;
  if (failed == 0 && ::rename(name.c_str(), target.c_str()) != 0) failed = errno;
  if (failed != 0) {
    ::unlink(name.c_str());
    return system_error(failed, "cannot write", target, "");
  }
  const std::string folder = std::filesystem::path(target).parent_path().string();
  const detail::Descriptor held(::open(folder.empty() ? "." : folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (held.fd() >= 0) (void)::fsync(held.fd());
  return {};
}

}  // namespace rtdata::app
