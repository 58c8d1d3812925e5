#include "io/kernel_file.hpp"

#include <dirent.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <memory>

#include "rtdata/detail/io/descriptor.hpp"

namespace rtdata::detail {
namespace {

constexpr const char* who_may = "run as a user that may use it (`ls -l` shows which), or add a udev rule (docs/iio.md)";

Error failure(int number, const char* what, const std::string& path) {
  if (number == ENODEV)
    return {Errc::disconnected, what, path, "the device has disappeared", "the program searches for it again"};
  return system_error(number, what, path, number == EACCES ? who_may : "");
}

}  // namespace

Result<std::string> read_kernel_file(const std::string& path, const char* what) {
  const Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOCTTY | O_NONBLOCK));
  if (file.fd() < 0) return failure(errno, what, path);
  std::array<char, 4096> text;
  ssize_t got = 0;
  do {
    got = ::read(file.fd(), text.data(), text.size());
  } while (got < 0 && errno == EINTR);
  if (got < 0) return failure(errno, what, path);
  // current_timestamp_clock ends with a zero byte, in kernels up to at least 6.1.
  const std::string_view all(text.data(), static_cast<std::size_t>(got));
  return std::string(trimmed(all.substr(0, all.find('\0'))));
}

Result<void> write_kernel_file(const std::string& path, std::string_view text, const char* what) {
  const Descriptor file(::open(path.c_str(), O_WRONLY | O_TRUNC | O_CLOEXEC | O_NOCTTY | O_NONBLOCK));
  if (file.fd() < 0) return failure(errno, what, path);
  const std::string line = std::string(text) + "\n";
  ssize_t put = 0;
  do {
    put = ::write(file.fd(), line.data(), line.size());
  } while (put < 0 && errno == EINTR);
  if (put < 0) return failure(errno, what, path);
  return {};
}

std::vector<std::string> names_in_folder(const std::string& folder) {
  std::vector<std::string> names;
  const std::unique_ptr<DIR, int (*)(DIR*)> open(::opendir(folder.c_str()), &::closedir);
  if (open == nullptr) return names;
  while (const dirent* entry = ::readdir(open.get())) {
    if (entry->d_name[0] != '.') names.emplace_back(entry->d_name);
  }
  return names;
}

std::string holder_of(const std::string& device) {
  struct stat wanted {};
  if (::stat(device.c_str(), &wanted) != 0) return {};
  const std::string own = std::to_string(::getpid());
  for (const std::string& process : names_in_folder("/proc")) {
    if (process.find_first_not_of("0123456789") != std::string::npos) continue;
    const std::string folder = "/proc/" + process + "/fd/";
    for (const std::string& fd : names_in_folder(folder)) {
      struct stat open {};
      if (::stat((folder + fd).c_str(), &open) != 0 || open.st_rdev != wanted.st_rdev || open.st_ino != wanted.st_ino ||
          open.st_dev != wanted.st_dev)
        continue;
      if (process == own) return std::string(this_program);
      const auto name = read_kernel_file("/proc/" + process + "/comm", "");
      return "process " + process + (name ? " (" + *name + ")" : "");
    }
  }
  return {};
}

}  // namespace rtdata::detail
