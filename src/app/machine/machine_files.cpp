#include "app/machine/machine_files.hpp"

#include <fcntl.h>
#include <grp.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "io/enabling.hpp"
#include "rtdata/detail/io/descriptor.hpp"

namespace rtdata::app {
namespace {

std::string group_name(gid_t group) {
  const struct group* const found = ::getgrgid(group);
  return found != nullptr ? found->gr_name : "";
}

}  // namespace

MachineFiles::MachineFiles(std::string root) : root_(std::move(root)) {
  while (root_.ends_with('/')) root_.pop_back();
}

bool MachineFiles::exists(const std::string& file) const { return ::access(path(file).c_str(), F_OK) == 0; }

std::optional<std::string> MachineFiles::text(const std::string& file) const {
  // Skips devices and pipes, which could block.
  struct stat status {};
  if (::stat(path(file).c_str(), &status) != 0 || !S_ISREG(status.st_mode)) return std::nullopt;
  std::ifstream stream(path(file), std::ios::binary);
  std::string all(64 * 1024, '\0');
  stream.read(all.data(), static_cast<std::streamsize>(all.size()));
  if (stream.bad() || (stream.gcount() == 0 && !stream.eof())) return std::nullopt;
  all.resize(static_cast<std::size_t>(stream.gcount()));
  constexpr const char* blanks = " \t\r\n";
  const std::size_t first = all.find_first_not_of(std::string(blanks) + '\0');
  if (first == std::string::npos) return "";
  return all.substr(first, all.find_last_not_of(std::string(blanks) + '\0') - first + 1);
}

std::vector<std::string> MachineFiles::names(const std::string& folder, std::string_view prefix) const {
  std::vector<std::string> all;
  std::error_code failed;
  std::filesystem::directory_iterator entry(path(folder), failed);
  for (; !failed && entry != std::filesystem::directory_iterator(); entry.increment(failed)) {
    std::string name = entry->path().filename().string();
    if (name.starts_with(prefix)) all.push_back(std::move(name));
  }
  std::sort(all.begin(), all.end(), [](auto& a, auto& b) { return ::strverscmp(a.c_str(), b.c_str()) < 0; });
  return all;
}

std::string MachineFiles::link_name(const std::string& link) const {
  std::error_code failed;
  const std::filesystem::path target = std::filesystem::read_symlink(path(link), failed);
  return failed ? "" : target.filename().string();
}

Access access_to(const MachineFiles& files, const std::string& file, int mode) {
  const std::string path = files.path(file);
  const int granted = ::faccessat(AT_FDCWD, path.c_str(), files.is_this_machine() ? mode : F_OK, AT_EACCESS);
  if (granted == 0) return {};
  const int error = errno;
  Access access{false, std::strerror(error), ""};
  struct stat status {};
  if (error == ENOENT) {
    access.advice = detail::how_to_enable(file);
    if (access.advice.empty()) access.advice = "plug it in; `rtdata scan` lists what there is";
  } else if ((error == EACCES || error == EPERM) && ::stat(path.c_str(), &status) == 0) {
    const std::string group = group_name(status.st_gid);
    const bool group_may = (status.st_mode & S_IRGRP) != 0 && group != "root" && !group.empty();
    access.advice = group_may ? "sudo usermod -aG " + group + " $USER, then log in again"
                              : "only root may use this file: add a udev rule that gives it to a group";
  }
  return access;
}

Result<std::vector<std::int64_t>> times_of_sync(const std::string& folder, Duration duration) {
  std::string path = folder + "/rtdata-write-XXXXXX";
  const detail::Descriptor file(::mkostemp(path.data(), O_CLOEXEC));
  const int fd = file.fd();
  if (fd < 0) return system_error(errno, "nothing can be written", folder);
  ::unlink(path.c_str());
  std::vector<std::int64_t> times;
  const std::string block(4096, 'x');
  constexpr int blocks = 256;  // blocks of the file, written repeatedly
  const auto end = std::chrono::steady_clock::now() + duration;
  for (auto began = end - duration; times.size() < 5 || began < end; began = std::chrono::steady_clock::now()) {
    const auto at = static_cast<off_t>(times.size() % blocks * block.size());
    errno = ENOSPC;  // of a write that is too short
    if (::pwrite(fd, block.data(), block.size(), at) != static_cast<ssize_t>(block.size()) || ::fdatasync(fd) != 0)
      return system_error(errno, "nothing can be written", folder);
    times.push_back((std::chrono::steady_clock::now() - began).count());
  }
  return times;
}

bool is_on_card(const std::string& folder, const std::string& root) {
  struct stat status {};
  if (::stat(folder.empty() ? "." : folder.c_str(), &status) != 0) return false;
  const std::string device = std::to_string(major(status.st_dev)) + ":" + std::to_string(minor(status.st_dev));
  std::error_code ignored;
  const auto found = std::filesystem::read_symlink(root + "/sys/dev/block/" + device, ignored);
  return found.filename().string().starts_with("mmcblk");
}

}  // namespace rtdata::app
