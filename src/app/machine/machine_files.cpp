#include "app/machine/machine_files.hpp"

#include <fcntl.h>
#include <grp.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include "io/enabling.hpp"

namespace rtdata::app {
namespace {

bool is_digit(char c) noexcept { return std::isdigit(static_cast<unsigned char>(c)) != 0; }

/// Runs of digits compare as numbers.
bool is_before(const std::string& a, const std::string& b) {
  std::size_t i = 0, k = 0;
  while (i < a.size() && k < b.size()) {
    if (is_digit(a[i]) && is_digit(b[k])) {
      const auto number = [](const std::string& text, std::size_t& at) {
        while (at + 1 < text.size() && text[at] == '0' && is_digit(text[at + 1])) ++at;
        const std::size_t begin = at;
        while (at < text.size() && is_digit(text[at])) ++at;
        return text.substr(begin, at - begin);
      };
      const std::string left = number(a, i), right = number(b, k);
      if (left != right) return left.size() != right.size() ? left.size() < right.size() : left < right;
    } else {
      if (a[i] != b[k]) return a[i] < b[k];
      ++i;
      ++k;
    }
  }
  return a.size() - i < b.size() - k;
}

std::string group_name(gid_t group) {
  std::array<char, 4096> buffer{};
  struct group entry {};
  struct group* found = nullptr;
  if (::getgrgid_r(group, &entry, buffer.data(), buffer.size(), &found) != 0 || found == nullptr) return "";
  return found->gr_name;
}

}  // namespace

MachineFiles::MachineFiles(std::string root) : root_(std::move(root)) {
  while (root_.ends_with('/')) root_.pop_back();
}

bool MachineFiles::exists(const std::string& file) const { return ::access(path(file).c_str(), F_OK) == 0; }

std::optional<std::string> MachineFiles::text(const std::string& file) const {
  // A device, or a pipe that somebody put here, could block.
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

std::vector<std::string> MachineFiles::names(const std::string& folder) const { return names(folder, ""); }

std::vector<std::string> MachineFiles::names(const std::string& folder, std::string_view prefix) const {
  std::vector<std::string> all;
  std::error_code failed;
  std::filesystem::directory_iterator entry(path(folder), failed);
  for (; !failed && entry != std::filesystem::directory_iterator(); entry.increment(failed)) {
    std::string name = entry->path().filename().string();
    if (name.starts_with(prefix)) all.push_back(std::move(name));
  }
  std::sort(all.begin(), all.end(), is_before);
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
                              : "its owner and mode let only root use it: add a udev rule that gives it to a group";
  }
  return access;
}

std::string holder_of(const std::string& file) {
  std::error_code failed;
  const std::filesystem::path wanted = std::filesystem::canonical(file, failed);
  if (failed) return "";
  for (std::filesystem::directory_iterator process("/proc", failed), end; !failed && process != end;
       process.increment(failed)) {
    const std::string pid = process->path().filename().string();
    if (pid.find_first_not_of("0123456789") != std::string::npos) continue;
    std::error_code hidden;
    for (std::filesystem::directory_iterator fd(process->path() / "fd", hidden); !hidden && fd != end;
         fd.increment(hidden)) {
      std::error_code gone;
      if (std::filesystem::read_symlink(fd->path(), gone) != wanted) continue;
      const std::string name = MachineFiles().text("/proc/" + pid + "/comm").value_or("a program");
      return name + " (pid " + pid + ")";
    }
  }
  return "";
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
